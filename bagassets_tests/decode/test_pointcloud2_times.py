"""Point times: what drivers write, in absolute nanoseconds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bagassets.decode.pointcloud2 import decode_pointcloud2
from bagassets_tests.sweep_data import cloud

HEADER_NS = 1_700_000_000_250_000_000
OFFSETS_NS = np.array([0, 100_000, 50_000_000, 99_999_000])


def times(name: str, values: np.ndarray, header_stamp_is="start", header_ns=HEADER_NS):
    count = len(values)
    columns = {axis: np.arange(1.0, count + 1, dtype=np.float32) for axis in "xyz"} | {name: values}
    return decode_pointcloud2(cloud(header_ns, columns), header_stamp_is).times_ns


@pytest.mark.parametrize(
    ("name", "values", "accuracy_ns"),
    [
        ("t", OFFSETS_NS.astype(np.uint32), 0),  # Ouster
        ("offset_time", OFFSETS_NS.astype(np.uint32), 0),  # Livox custom messages
        ("time_stamp", OFFSETS_NS.astype(np.uint32), 0),  # Nebula
        ("time_offset_us", (OFFSETS_NS // 1000).astype(np.int32), 0),
        ("time", (OFFSETS_NS * 1e-9).astype(np.float32), 5),  # velodyne_pointcloud
        ("time", (OFFSETS_NS * 1e-6).astype(np.float32), 5),  # milliseconds
        ("time", (OFFSETS_NS * 1e-3).astype(np.float32), 5),  # microseconds
        ("time", OFFSETS_NS.astype(np.float32), 5),  # nanoseconds in single precision
        ("timestamp", (HEADER_NS + OFFSETS_NS) * 1e-9, 250),  # Hesai, RoboSense
        ("timestamp", (HEADER_NS + OFFSETS_NS).astype(np.float64), 130),  # livox_ros_driver2
        ("timestamp", (HEADER_NS + OFFSETS_NS).astype(np.uint64), 0),
        ("timestamp", ((HEADER_NS + OFFSETS_NS) // 1000).astype(np.uint64), 1000),
    ],
)
def test_each_convention_gives_the_same_times(name, values, accuracy_ns):
    found = times(name, values)
    assert found.dtype == np.int64
    assert np.abs(found - (HEADER_NS + OFFSETS_NS)).max() <= accuracy_ns


def test_negative_offsets_count_back_from_a_header_that_means_the_end():
    seconds = ((OFFSETS_NS - OFFSETS_NS.max()) * 1e-9).astype(np.float32)
    for meaning in ("start", "end"):
        found = times("time", seconds, meaning)
        assert np.abs(found - (HEADER_NS + OFFSETS_NS - OFFSETS_NS.max())).max() <= 5


@pytest.mark.parametrize(("meaning", "moved_ns"), [("start", 0), ("middle", 49_999_500), ("end", 99_999_000)])
def test_offsets_from_the_start_are_moved_if_the_header_means_another_moment(meaning, moved_ns):
    found = times("t", OFFSETS_NS.astype(np.uint32), meaning)
    assert np.array_equal(found, HEADER_NS + OFFSETS_NS - moved_ns)


def test_absolute_times_ignore_what_the_header_means():
    values = (HEADER_NS + OFFSETS_NS).astype(np.uint64)
    assert np.array_equal(times("timestamp", values, "end"), HEADER_NS + OFFSETS_NS)


@pytest.mark.parametrize("start_s", [1234.5, 1_500_000_000.0])
def test_times_of_another_clock_keep_only_their_differences(start_s):
    values = start_s + OFFSETS_NS * 1e-9
    assert np.abs(times("timestamp", values, "start") - (HEADER_NS + OFFSETS_NS)).max() <= 250
    moved = HEADER_NS + OFFSETS_NS - OFFSETS_NS.max()
    assert np.abs(times("timestamp", values, "end") - moved).max() <= 250


@pytest.mark.parametrize(
    ("stamp_is", "moved_ns"), [("start", 0), ("middle", 49_999_500), ("end", 99_999_000)]
)
def test_a_header_that_nobody_explains_stays_the_stamp_of_times_of_another_clock(stamp_is, moved_ns):
    columns = {axis: np.arange(1.0, 5, dtype=np.float32) for axis in "xyz"}
    columns["timestamp"] = 1234.5 + OFFSETS_NS * 1e-9
    found = decode_pointcloud2(cloud(HEADER_NS, columns), None, stamp_is).times_ns
    assert np.abs(found - (HEADER_NS + OFFSETS_NS - moved_ns)).max() <= 250


def test_relative_times_count_from_a_header_that_nobody_explains():
    assert np.array_equal(times("t", OFFSETS_NS.astype(np.uint32), None), HEADER_NS + OFFSETS_NS)


@pytest.mark.parametrize(
    "values",
    [
        np.zeros(4, np.uint32),
        np.full(4, 0.05, np.float32),
        np.array([0, 1, 2, 3e9], np.float64) * 10,
        np.array([0, 2_500_000_000, 1, 2], np.uint32),
        np.array([1.7e9, 1.7e9 + 128, 1.7e9, 1.7e9], np.float32),
    ],
)
def test_implausible_times_count_as_not_recorded(values):
    assert times("time", values) is None


def test_times_of_dropped_points_are_dropped():
    columns = {axis: np.array([1, np.nan, 3], np.float32) for axis in "xyz"}
    columns["t"] = np.array([0, 1_000, 2_000], np.uint32)
    reading = decode_pointcloud2(cloud(HEADER_NS, columns))
    assert reading.dropped == 1
    assert reading.times_ns.tolist() == [HEADER_NS, HEADER_NS + 2_000]


def test_a_point_whose_time_is_not_finite_is_dropped_and_counted():
    columns = {axis: np.array([1.0, 2, 3], np.float32) for axis in "xyz"}
    columns["time"] = np.array([0.0, np.nan, 0.1], np.float32)
    reading = decode_pointcloud2(cloud(HEADER_NS, columns))
    assert reading.untimed == 1
    assert reading.points[:, 0].tolist() == [1.0, 3.0]
    assert np.abs(reading.times_ns - HEADER_NS - [0, 100_000_000]).max() <= 5


@given(
    st.integers(1_500_000_000, 1_900_000_000),
    st.lists(st.integers(0, 100_000_000), max_size=20),
)
def test_absolute_seconds_are_as_exact_as_double_precision(second, offsets_ns):
    offsets = np.array([0, 100_000_000, *offsets_ns])
    values = second + offsets * 1e-9
    found = times("timestamp", values, header_ns=second * 10**9)
    assert np.abs(found - (second * 10**9 + offsets)).max() <= 240


NAMES = (
    "t time timestamp time_stamp offset_time time_offset point_time_offset timestamp_offset relative_timestamp stamp t_ns "
    "time_ns timestamp_ns time_offset_ns T Time_Stamp"
)
NAMES_US = "t_us time_us timestamp_us offset_time_us time_offset_us"


@pytest.mark.parametrize(
    ("name", "unit"), [*((n, 1) for n in NAMES.split()), *((n, 1000) for n in NAMES_US.split())]
)
def test_point_times_go_by_the_names_of_drivers(name, unit):
    found = times(name, (OFFSETS_NS // unit).astype(np.uint32))
    assert np.array_equal(found, HEADER_NS + OFFSETS_NS // unit * unit)
