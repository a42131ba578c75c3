"""LaserScan: rays become points in the plane of the sensor."""

import math

import numpy as np
import pytest

from bagassets.base.errors import DecodeError
from bagassets.decode.laserscan import decode_laserscan
from bagassets_tests.small_drive import STORE2
from bagassets_tests.sweep_data import Scan, header

STAMP = 1_600_000_000_000_000_000


def scan(ranges, intensities=(), **fields):
    return Scan(header(STAMP), np.array(ranges, np.float32), np.array(intensities, np.float32), **fields)


def test_rays_lie_at_their_angles():
    reading = decode_laserscan(scan([2.0, 3.0, 4.0], [1, 2, 3], angle_min=-0.5, angle_increment=0.25))
    expected = [
        [r * math.cos(a), r * math.sin(a), 0.0, i, 0.0]
        for r, a, i in ((2, -0.5, 1), (3, -0.25, 2), (4, 0.0, 3))
    ]
    assert np.allclose(reading.points, expected, atol=1e-6)
    assert reading.times_ns is None
    assert reading.span_ns is None


def test_what_is_no_measurement_is_dropped_and_counted():
    reading = decode_laserscan(scan([np.nan, np.inf, -np.inf, 0.05, 31.0, 0.1, 30.0], range_min=0.1))
    assert reading.dropped == 5
    assert len(reading.points) == 2


@pytest.mark.filterwarnings("error")
def test_a_ray_straight_ahead_that_hits_nothing_makes_no_noise():
    reading = decode_laserscan(scan([1.0, np.inf], angle_min=-0.5, angle_increment=0.5))
    assert (len(reading.points), reading.dropped) == (1, 1)


@pytest.mark.parametrize(("meaning", "first"), [("start", 0), ("middle", -1_000_000), ("end", -2_000_000)])
def test_each_ray_has_its_time(meaning, first):
    reading = decode_laserscan(scan([1, np.nan, 3], time_increment=0.001), meaning)
    assert (reading.times_ns - STAMP).tolist() == [first, first + 2_000_000]
    # Rays that hit nothing belong to the revolution too.
    assert reading.span_ns == (STAMP + first, STAMP + first + 2_000_000)


def test_by_definition_the_header_is_the_time_of_the_first_ray():
    assert (decode_laserscan(scan([1, 2, 3], time_increment=0.001)).times_ns - STAMP).tolist() == [
        0,
        10**6,
        2 * 10**6,
    ]
    backwards = scan([1, 2, 3], time_increment=-0.001)
    assert (decode_laserscan(backwards).times_ns - STAMP).tolist() == [0, -(10**6), -2 * 10**6]
    for meaning, first in (("start", 2), ("middle", 1), ("end", 0)):
        times = decode_laserscan(backwards, meaning).times_ns - STAMP
        assert times.tolist() == [first * 10**6, (first - 1) * 10**6, (first - 2) * 10**6]


@pytest.mark.parametrize(
    ("increment_s", "scan_s", "known"),
    [
        (0.05, 0.1, True),  # two steps of 50 ms
        (0.05, 0.0667, True),  # drivers measure scan_time, or set it
        (0.05, 0.0, True),  # many leave it out
        (0.1, 0.1, False),  # the rays take twice as long as there is from scan to scan
        (50.0, 0.1, False),  # milliseconds, written as seconds
        (1.5, 0.0, False),  # three seconds are no scan
        (0.0, 0.1, False),  # made from a depth image
    ],
)
def test_ray_times_count_if_the_time_from_scan_to_scan_allows_them(increment_s, scan_s, known):
    reading = decode_laserscan(scan([1, 2, 3], time_increment=increment_s, scan_time=scan_s))
    assert (reading.times_ns is not None) == known
    assert (reading.span_ns is not None) == known


def test_the_span_counts_rays_that_hit_nothing():
    reading = decode_laserscan(scan([np.nan, 2, np.nan], time_increment=0.001))
    assert reading.span_ns == (STAMP, STAMP + 2_000_000)
    assert reading.times_ns.tolist() == [STAMP + 1_000_000]


def test_intensities_that_do_not_fit_are_refused():
    with pytest.raises(DecodeError, match="intensities"):
        decode_laserscan(scan([1, 2], [1]))


def test_angles_that_are_no_numbers_are_refused():
    with pytest.raises(DecodeError, match="angles"):
        decode_laserscan(scan([1, 2], angle_increment=float("nan")))


def test_an_empty_scan_has_no_points():
    reading = decode_laserscan(scan([], time_increment=0.001))
    assert len(reading.points) == 0
    assert reading.dropped == 0


def multi_echo(ranges, intensities=()):
    """A scan of real types, as read from bytes; each ray has its echoes."""
    types, kind = STORE2.types, "sensor_msgs/msg/MultiEchoLaserScan"

    def rays(lists):
        return [types["sensor_msgs/msg/LaserEcho"](np.array(one, np.float32)) for one in lists]

    stamp = types["builtin_interfaces/msg/Time"](*divmod(STAMP, 10**9))
    head = types["std_msgs/msg/Header"](stamp, "laser")
    limits = {"range_min": 0.1, "range_max": 30.0, "angle_min": 0.0, "angle_max": 1.0}
    message = types[kind](
        header=head, **limits, angle_increment=0.5, time_increment=0.001, scan_time=0.1,
        ranges=rays(ranges), intensities=rays(intensities),
    )  # fmt: skip
    return STORE2.deserialize_cdr(STORE2.serialize_cdr(message, kind), kind)


def test_each_echo_of_a_ray_is_a_point():
    reading = decode_laserscan(multi_echo([[2.0, 5.0], [], [3.0, np.inf, 31.0]], [[1, 2], [], [3, 4, 5]]))
    expected = [(2, 0.0, 1), (5, 0.0, 2), (3, 1.0, 3)]
    assert np.allclose(reading.points, [(r * math.cos(a), r * math.sin(a), 0, i, 0) for r, a, i in expected])
    assert (reading.times_ns - STAMP).tolist() == [0, 0, 2_000_000]
    assert reading.span_ns == (STAMP, STAMP + 2_000_000)
    assert reading.dropped == 3  # a ray without echo, and two echoes that are no measurements


def test_rays_without_any_echo_are_an_empty_cloud():
    reading = decode_laserscan(multi_echo([[], []]))
    assert (reading.points.shape, reading.dropped) == ((0, 5), 2)
    with pytest.raises(DecodeError, match="another number of intensities"):
        decode_laserscan(multi_echo([[1.0], [2.0]], [[1.0], []]))
