"""`sensor_msgs/LaserScan`, `MultiEchoLaserScan` and `foxglove.LaserScan`: a flat cloud in the plane of the sensor."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import head, pose_of
from bagassets.decode.model import CloudReading
from bagassets.decode.point_times import LONGEST_REVOLUTION_NS, Moment, time_of
from bagassets.decode.pointcloud2 import NO_INTENSITY, place
from bagassets.geometry.portable import sin_cos
from bagassets.geometry.se3 import Floats
from bagassets.recordings.model import Message

# Rays may take slightly longer than `scan_time`, which some drivers measure and others set.
_LONGEST_IN_SCANS = 1.5


def decode_laserscan(
    message: Message, header_stamp_is: Moment | None = None, _stamp_is: Moment = "end"
) -> CloudReading:
    """Return the rays that hit something, as points with z = 0 and ring 0; each echo of a ray is one.

    Rays that are not finite, or outside `range_min` to `range_max`, are no measurements by the
    definition of the message; they are dropped and counted, as are rays without any echo. Ray i was measured
    `i * time_increment` after the first one, whose time the header stamp is by definition; `header_stamp_is` may
    say otherwise. Without an increment, as in scans made from depth images, all rays were measured at
    once; and so they count if the rays would take longer than `scan_time`, the time from scan to scan, allows.

    Raises:
        DecodeError: angles or intensities do not fit the ranges.
    """
    stamp, frame_id = head(message)
    ranges, rays = _echoes(message.ranges)
    intensities = _echoes(message.intensities)[0].astype(np.float32)
    number = len(message.ranges)
    if len(intensities) not in (0, len(ranges)):
        raise DecodeError("it has another number of intensities than of ranges")
    if hasattr(message, "start_angle"):  # Foxglove's has neither limits nor times
        angle_min = float(message.start_angle)
        angle_increment = (float(message.end_angle) - angle_min) / max(1, number - 1)
        range_min, range_max, times = np.nextafter(0.0, 1.0), np.inf, (0.0, 0.0)
    else:
        angle_min, angle_increment = float(message.angle_min), float(message.angle_increment)
        range_min, range_max = message.range_min, message.range_max
        times = float(message.time_increment), float(message.scan_time)
    without_echo = number - len(np.unique(rays))
    if not np.isfinite([angle_min, angle_increment]).all():
        raise DecodeError("its angles are not finite")
    with np.errstate(invalid="ignore"):
        hit = np.isfinite(ranges) & (ranges >= range_min) & (ranges <= range_max)
    sines, cosines = _directions(angle_min, angle_increment, number)
    rays = rays[hit]
    points = np.zeros((int(hit.sum()), 5), dtype=np.float32)
    points[:, 0] = ranges[hit] * cosines[rays]
    points[:, 1] = ranges[hit] * sines[rays]
    points[:, 3] = NO_INTENSITY
    if len(intensities):
        points[:, 3] = np.where(np.isfinite(intensities), intensities, np.float32(NO_INTENSITY))[hit]
    if hasattr(message, "pose"):
        place(points, pose_of(message.pose))
    offsets = _ray_offsets_ns(*times, number, header_stamp_is)
    times_ns = None if offsets is None else stamp + offsets
    return CloudReading(
        stamp_ns=stamp,
        frame_id=frame_id,
        points=points,
        times_ns=None if times_ns is None else times_ns[rays],
        dropped=len(ranges) - len(points) + without_echo,
        span_ns=None if times_ns is None else (int(times_ns.min()), int(times_ns.max())),
    )


def _echoes(rays: Sequence[Message]) -> tuple[Floats, NDArray[np.intp]]:
    """Return the numbers of all rays, of which a `MultiEchoLaserScan` has a list each, and the ray that each is of."""
    if not len(rays) or not hasattr(rays[0], "echoes"):
        return np.asarray(rays, np.float64), np.arange(len(rays))
    counts = [len(ray.echoes) for ray in rays]
    return np.concatenate([ray.echoes for ray in rays], dtype=np.float64), np.repeat(
        np.arange(len(rays)), counts
    )


def _ray_offsets_ns(
    increment_s: float, scan_s: float, number: int, header_stamp_is: Moment | None
) -> NDArray[np.int64] | None:
    """Return the time of each ray after the header stamp; None if the message does not say."""
    if not number or not np.isfinite(increment_s) or increment_s == 0.0:
        return None
    duration_s = abs(increment_s) * (number - 1)
    if duration_s * 1e9 > LONGEST_REVOLUTION_NS or 0.0 < scan_s * _LONGEST_IN_SCANS < duration_s:
        return None
    offsets = np.asarray(np.rint(np.arange(number, dtype=np.float64) * increment_s * 1e9).astype(np.int64))
    if header_stamp_is is None:
        return offsets
    # Rays may be listed backwards.
    return offsets - time_of(header_stamp_is, int(offsets.min()), int(offsets.max()))


@lru_cache(maxsize=8)
def _directions(angle_min: float, increment: float, number: int) -> tuple[Floats, Floats]:
    """Return sines and cosines of all rays, computed once per scanner."""
    return sin_cos(angle_min + np.arange(number, dtype=np.float64) * increment)
