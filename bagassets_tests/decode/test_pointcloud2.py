"""PointCloud2: every layout gives the points that were put in."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.base.errors import DecodeError
from bagassets.decode.pointcloud2 import NO_INTENSITY, NO_RING, decode_pointcloud2, point_fields
from bagassets_tests.small_drive import STORE1
from bagassets_tests.sweep_data import CODES, Cloud, Field, cloud, header

STRUCT = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
NUMBERS = {"f4": [0.0, 1.5, -2.25, 1e4, float("nan"), float("inf"), -float("inf"), 3e38],
           "f8": [0.0, -1.5, 1e5, 0.125, float("nan"), 1e300, float("inf")]}  # fmt: skip


def number(kind: str) -> st.SearchStrategy:
    if kind in NUMBERS:
        return st.sampled_from(NUMBERS[kind])
    info = np.iinfo(kind)
    return st.integers(int(info.min), int(info.max))


@st.composite
def layouts(draw):
    """A cloud of random layout, and its values by field as plain lists."""
    names = ["x", "y", "z", *draw(st.permutations(["intensity", "ring", "noise", "rgb"]))]
    names = draw(st.permutations(names[: draw(st.integers(3, 7))]))
    kinds = {name: draw(st.sampled_from(["f4", "f8"] if name in "xyz" else sorted(STRUCT))) for name in names}
    offset, fields = 0, []
    for name in names:
        offset += draw(st.integers(0, 5))
        count = draw(st.integers(0, 2)) if name == "noise" else 1
        fields.append(Field(name, offset, CODES[kinds[name]], count))
        offset += np.dtype(kinds[name]).itemsize * max(1, count)
    step = offset + draw(st.integers(0, 7))
    height, width = draw(st.integers(1, 3)), draw(st.integers(0, 5))
    row_step = width * step + draw(st.integers(0, 9))
    big = draw(st.booleans())
    data = bytearray(draw(st.binary(min_size=row_step * height, max_size=row_step * height)))
    rows = []
    for row in range(height):
        for column in range(width):
            point = {name: draw(number(kinds[name])) for name in names}
            for spec in fields:
                where = row * row_step + column * step + spec.offset
                struct.pack_into(
                    (">" if big else "<") + STRUCT[kinds[spec.name]], data, where, point[spec.name]
                )
            rows.append(point)
    message = Cloud(header(10**18), height, width, fields, big, step, row_step, np.frombuffer(data, np.uint8))
    return message, rows


@settings(max_examples=150, deadline=None)
@given(layouts())
def test_any_layout_gives_the_points_that_were_put_in(layout):
    message, rows = layout
    with np.errstate(over="ignore"):
        expected = [
            [
                np.float32(p["x"]),
                np.float32(p["y"]),
                np.float32(p["z"]),
                np.float32(p.get("intensity", NO_INTENSITY)),
                np.float32(p.get("ring", NO_RING)),
            ]
            for p in rows
            if np.isfinite(np.array([p["x"], p["y"], p["z"]]).astype(np.float32)).all()
        ]
    reading = decode_pointcloud2(message)
    assert reading.points.dtype == np.float32
    assert reading.points.shape == (len(expected), 5)
    assert reading.dropped == len(rows) - len(expected)
    wanted = np.array(expected, np.float32).reshape(-1, 5)
    wanted[~np.isfinite(wanted[:, 3]), 3] = NO_INTENSITY
    wanted[~np.isfinite(wanted[:, 4]), 4] = NO_RING
    assert np.array_equal(reading.points, wanted)


def test_stamp_and_frame_come_from_the_header_without_leading_slash():
    reading = decode_pointcloud2(cloud(1_600_000_000_123_456_789, xyz(2), frame_id="/velodyne"))
    assert reading.stamp_ns == 1_600_000_000_123_456_789
    assert reading.frame_id == "velodyne"
    assert reading.times_ns is None


def xyz(count: int) -> dict[str, np.ndarray]:
    return {axis: np.arange(1, count + 1, dtype=np.float32) * (k + 1) for k, axis in enumerate("xyz")}


@pytest.mark.parametrize(
    "name",
    ["intensity", "Intensity", "intensities", "i", "reflectivity", "reflectance", "remission", "signal"],
)
def test_intensity_goes_by_several_names_and_keeps_its_scale(name):
    reading = decode_pointcloud2(cloud(0, xyz(3) | {name: np.array([0, 300, 65535], np.uint16)}))
    assert reading.points[:, 3].tolist() == [0, 300, 65535]


@pytest.mark.parametrize(
    "name", ["ring", "Ring", "channel", "laser_id", "laserid", "line", "beam", "beam_id", "ring_id", "row"]
)
def test_ring_goes_by_several_names(name):
    reading = decode_pointcloud2(cloud(0, xyz(3) | {name: np.array([5, 0, 127], np.uint16)}))
    assert reading.points[:, 4].tolist() == [5, 0, 127]


def test_intensity_wins_over_reflectivity():
    fields = xyz(1) | {"reflectivity": np.array([9], np.uint16), "intensity": np.array([4], np.float32)}
    assert decode_pointcloud2(cloud(0, fields)).points[0, 3] == 4


@pytest.mark.parametrize("height", [1, 2, 3])
@pytest.mark.parametrize("row_step", [0, 1, 2, 6, 12, 35, 37, 2**32 - 1])
def test_row_step_does_not_count_if_the_data_are_as_long_as_rows_without_gaps(height, row_step):
    """Drivers leave it zero, give it in points, or that of the whole cloud."""
    message = cloud(0, xyz(6))
    message.height, message.width, message.row_step = height, 6 // height, row_step
    assert np.array_equal(decode_pointcloud2(message).points[:, 2], 3 * np.arange(1.0, 7))


def test_rows_with_gaps_need_their_row_step():
    """Its data have the size of no other layout that is known."""
    message = cloud(0, xyz(6))
    message.height, message.width, message.row_step = 2, 2, 36
    assert decode_pointcloud2(message).points[:, 0].tolist() == [1, 2, 4, 5]
    message.row_step = 24
    with pytest.raises(DecodeError, match="size"):
        decode_pointcloud2(message)


@pytest.mark.parametrize(
    "change",
    [
        {"width": 4},
        {"width": 2},
        {"height": 2},
        {"point_step": 13},
        {"data": np.zeros(35, np.uint8)},
        {"data": np.zeros(0, np.uint8)},
    ],
)
def test_sizes_that_contradict_each_other_are_refused(change):
    message = replace(cloud(0, xyz(3)), **change)
    if change == {"width": 2}:  # a row with padding is legal
        assert len(decode_pointcloud2(message).points) == 2
        return
    with pytest.raises(DecodeError, match="size"):
        decode_pointcloud2(message)


def test_a_field_outside_its_point_is_refused():
    message = cloud(0, xyz(3))
    message.fields[2].offset = 9
    with pytest.raises(DecodeError, match="field z"):
        decode_pointcloud2(message)


def test_an_unknown_datatype_is_refused():
    message = cloud(0, xyz(3))
    message.fields[1].datatype = 77
    with pytest.raises(DecodeError, match="field y"):
        decode_pointcloud2(message)


def test_a_cloud_without_z_is_refused():
    columns = xyz(2)
    del columns["z"]
    with pytest.raises(DecodeError, match="no field z"):
        decode_pointcloud2(cloud(0, columns))


def test_an_empty_cloud_has_no_points():
    reading = decode_pointcloud2(cloud(0, xyz(0)))
    assert reading.points.shape == (0, 5)
    assert reading.dropped == 0


def test_views_copy_nothing():
    message = cloud(0, xyz(3))
    assert all(view.base is not None for view in point_fields(message).values())


def listed(points, **channels):
    """A `PointCloud`, the forerunner of PointCloud2, as read from bytes."""
    types, kind = STORE1.types, "sensor_msgs/msg/PointCloud"
    stamp = types["builtin_interfaces/msg/Time"](1_600_000_000, 5)
    message = types[kind](
        types["std_msgs/msg/Header"](7, stamp, "/laser"),
        [types["geometry_msgs/msg/Point32"](*point) for point in points],
        [
            types["sensor_msgs/msg/ChannelFloat32"](name, np.array(values, np.float32))
            for name, values in channels.items()
        ],
    )
    return STORE1.deserialize_ros1(STORE1.serialize_ros1(message, kind), kind)


def test_a_list_of_points_with_channels():
    reading = decode_pointcloud2(
        listed(
            [(1, 2, 3), (4, np.nan, 6), (-7, 8, 9.5)], Intensities=[10, 20, 30], ring=[1, 2, 3], rgb=[0, 0, 0]
        )
    )
    assert (reading.stamp_ns, reading.frame_id) == (1_600_000_000_000_000_005, "laser")
    assert reading.points.tolist() == [[1, 2, 3, 10, 1], [-7, 8, 9.5, 30, 3]]
    assert (reading.points.dtype, reading.dropped, reading.times_ns) == (np.float32, 1, None)


def test_a_list_of_points_without_channels_or_points():
    assert decode_pointcloud2(listed([(1, 2, 3)])).points.tolist() == [[1, 2, 3, NO_INTENSITY, NO_RING]]
    assert decode_pointcloud2(listed([])).points.shape == (0, 5)


def test_a_list_of_points_with_times_since_its_header():
    reading = decode_pointcloud2(listed([(1, 2, 3), (4, 5, 6)], time=[0.0, 0.0625]))
    assert np.diff(reading.times_ns).tolist() == [62_500_000]


def test_a_channel_has_a_number_for_each_point():
    with pytest.raises(DecodeError, match="its channel ring has another number of values than it has points"):
        decode_pointcloud2(listed([(1, 2, 3)], ring=[1, 2]))
