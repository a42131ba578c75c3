"""Lidar readings become `.pcd.bin` files: one per cloud message, or one per revolution of packets (`packet_sweeps`).

The stamp of a file is the end (or, by the recipe, start or middle) of its revolution, which is derived

* for packets from the packets at both cuts (`bagassets.assets.revolutions`);
* for clouds with point times, and laser scans, from the first and the last time; what the times of a `PointCloud2` are
  is decided for all of a topic from its first clouds, which are held until then;
* for other clouds from the message's stamp and the median period of the topic, if the recipe says which moment of the
  revolution the stamp is (`header_stamp_is`). If it does not, or if a single message gives no period, the stamp stays
  as recorded, and the span in the index is that moment.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NoReturn

import numpy as np
from numpy.typing import NDArray

from bagassets.assets.asset import inlined, omitted
from bagassets.assets.lidar_file import lidar_bytes
from bagassets.assets.sweep_files import Motion, SensorSettings, SensorUse, SweepFiles
from bagassets.base.errors import DecodeError, RecipeError
from bagassets.decode.loading import keyed_decoder
from bagassets.decode.model import CloudReading
from bagassets.decode.point_times import (
    MOST_APART,
    Moment,
    PointClock,
    RecordedTimes,
    suffice,
    survey,
    time_of,
)
from bagassets.decode.pointcloud2 import POINT_CLOUDS, read_pointcloud2, with_times, without_zero_points
from bagassets.geometry.kernels.moving import KNOT_NS, move_points
from bagassets.geometry.se3 import SE3, Floats, quaternion_multiply, rotate
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import PointTimes
from bagassets.recordings.model import Message, RawMessage

Span = tuple[int, int]

_UNTIMED = "no usable time"
NO_STAMP = "its header has no stamp; set clock: log in the recipe"


@dataclass(frozen=True, kw_only=True)
class LidarSettings(SensorSettings):
    """Settings of a lidar in the recipe, whatever its message type.

    Attributes:
        stamp: which time of a revolution is its stamp.
        stamp_offset_s: added to all stamps.
        deskew: True if points are corrected for the motion of the sensor.
        min_range_m: nearer points are dropped.
        max_range_m: farther points are dropped; None for no limit.
        intensity_scale: recorded intensities are multiplied by it.
    """

    stamp: Moment
    stamp_offset_s: float
    deskew: bool
    min_range_m: float
    max_range_m: float | None
    intensity_scale: float = omitted(1.0)


@dataclass(frozen=True, kw_only=True)
class LidarUse(SensorUse):
    """Everything besides its messages that shapes the files of a lidar.

    Attributes:
        settings: its settings in the recipe.
    """

    modality: Literal["lidar"] = "lidar"
    settings: LidarSettings = inlined()


@dataclass(frozen=True, kw_only=True)
class CloudUse(LidarUse):
    """Everything besides its messages that shapes the files of a lidar with cloud messages.

    Attributes:
        header_stamp_is: which time of a revolution the recorded stamp is; None if the recipe does not say.
        period_ns: median time between two messages, if the recipe has `header_stamp_is`; None for a single message.
        zero_points: what becomes of points at exactly 0, 0, 0.
        point_times: what the times of the points of a `PointCloud2` are; None to take it from them.
    """

    header_stamp_is: Moment | None
    period_ns: int | None
    zero_points: Literal["drop", "keep"]
    point_times: PointTimes | Literal["ignore"] | None = omitted()


def revolution_span_ns(reading: CloudReading, period_ns: int | None, header_stamp_is: Moment | None) -> Span:
    """Return when the revolution of a cloud began and ended, on the clock of its stamp."""
    if reading.span_ns is not None:
        return reading.span_ns
    if reading.times_ns is not None:
        return int(reading.times_ns.min()), int(reading.times_ns.max())
    if header_stamp_is is None:
        return reading.stamp_ns, reading.stamp_ns
    duration = period_ns or 0
    start = reading.stamp_ns - time_of(header_stamp_is, 0, duration)
    return start, start + duration


class LidarWriter:
    """Applies range limits and deskewing to revolutions, and writes them.

    Args:
        use: everything that shapes the files.
        files: writes them.
        motion: what the sweeps are deskewed with; None if they are not.

    Attributes:
        times: what points without times have, for an error.
    """

    def __init__(self, use: LidarUse, files: SweepFiles, motion: Motion | None) -> None:
        self.files = files
        self.times = "no times"
        self._name = use.channel
        self._settings = use.settings
        self._offset_ns = round(use.settings.stamp_offset_s * 1e9)
        self._motion = motion

    def write(
        self,
        points: NDArray[np.float32],
        times_ns: NDArray[np.int64] | None,
        span_ns: Span,
        log_time_ns: int,
        *,
        parts: int = 1,
    ) -> None:
        """Write one revolution; all times are on the clock of the recipe, without the channel's own offset.

        Its points are deskewed and scaled in place.

        Raises:
            RecipeError: deskewing is on, but the points have no times.
        """
        points, times_ns = self._within_limits(points, times_ns)
        if not len(points):
            self.files.lose("no point in it", parts)
            return
        if self._offset_ns:
            span_ns = (span_ns[0] + self._offset_ns, span_ns[1] + self._offset_ns)
            times_ns = None if times_ns is None else times_ns + self._offset_ns
        stamp = time_of(self._settings.stamp, *span_ns)
        if self._motion is not None:
            if times_ns is None:
                raise RecipeError(
                    f"{self._name}: the points of {self._settings.topic} have {self.times}, so they cannot be "
                    "deskewed; set deskew: false."
                )
            if not deskew(points, times_ns, stamp, *self._motion):
                self.files.lose("no ego pose to deskew with", parts, len(points))
                return
        if self._settings.intensity_scale != 1.0:
            points[:, 3] *= np.float32(self._settings.intensity_scale)
        data = lidar_bytes(points)
        self.files.write(stamp, log_time_ns, data, len(points), parts=parts, span_ns=span_ns)

    def _within_limits(
        self, points: NDArray[np.float32], times_ns: NDArray[np.int64] | None
    ) -> tuple[NDArray[np.float32], NDArray[np.int64] | None]:
        least_m, most_m = self._settings.min_range_m, self._settings.max_range_m
        if least_m <= 0.0 and most_m is None:
            return points, times_ns
        x, y, z = (points[:, axis].astype(np.float64) for axis in range(3))
        distance = np.sqrt(x * x + y * y + z * z)
        near = distance < least_m
        far = distance > (np.inf if most_m is None else most_m)
        self.files.points.lose("nearer than min_range_m", int(near.sum()))
        self.files.points.lose("farther than max_range_m", int(far.sum()))
        keep = ~(near | far)
        return points[keep], None if times_ns is None else times_ns[keep]


class CloudSweeps:
    """One file per PointCloud2 or LaserScan message.

    Args:
        use: everything that shapes the files.
        writer: writes the revolutions.
        fail: called with the text of an error, and, twice, with how many messages it cost.
    """

    def __init__(self, use: CloudUse, writer: LidarWriter, fail: Callable[[str, int, int], None]) -> None:
        self._use = use
        self._writer = writer
        self._fail = fail
        self._decode = keyed_decoder("cloud", use.msgtype, use.decoder)
        self._by_plugin = use.decoder is not None
        self._by_log_time = use.settings.clock == "log"
        self._clock: PointClock | None = None
        self._held: list[tuple[CloudReading, RecordedTimes, int]] = []

    def add(self, message: Message, raw: RawMessage) -> str:
        """Take one cloud; return its frame.

        Raises:
            DecodeError: the message is not a usable cloud.
            RecipeError: see `LidarWriter.write`; or it is not sure what the times of the points are.
        """
        reading = self._reading(message)
        self._writer.files.counts.read += 1
        if reading.recorded is None or self._clock is not None or not len(reading.points):
            self._write(reading, raw.log_time_ns)
        else:
            self._held.append((reading, reading.recorded, raw.log_time_ns))
            if suffice([recorded for _, recorded, _ in self._held], self._use.point_times):
                self._write_held()
        return reading.frame_id

    def finish(self) -> None:
        """Write the clouds that are held.

        Raises:
            RecipeError: as `add`, or it turns out to be wrong what the times of the points were taken for.
        """
        self._write_held()
        points = self._writer.files.points
        share = points.lost.get(_UNTIMED, 0) / max(1, points.read)
        if share > MOST_APART and self._use.point_times is None:
            self._ask(f"{share:.0%} of them lie apart from the others of their clouds")

    def _write_held(self) -> None:
        if self._held:
            self._clock = survey([recorded for _, recorded, _ in self._held], self._use.point_times)
            if self._clock.doubt:
                self._ask(self._clock.doubt)
            if self._clock.problem and self._use.point_times not in {None, "ignore"}:
                raise RecipeError(
                    f"{self._use.channel}: point_times says what the times of the points of {self._use.settings.topic} are, but "
                    f"they cannot be used, as {self._clock.problem}; correct it, or write `point_times: ignore`."
                )
            if self._clock.problem:
                self._writer.times = f"times that cannot be used, as {self._clock.problem}"
        held, self._held = self._held, []
        for reading, _, log_time_ns in held:
            self._write(reading, log_time_ns)

    def _ask(self, doubt: str) -> NoReturn:
        raise RecipeError(
            f"{self._use.channel}: it is not sure what the times of the points of {self._use.settings.topic} are: {doubt}; "
            "say it in point_times of the channel."
        )

    def _write(self, reading: CloudReading, log_time_ns: int) -> None:
        if self._clock is not None:
            meant = (self._use.header_stamp_is, self._use.settings.stamp)
            try:
                reading = with_times(reading, self._clock, *meant)
            except DecodeError as err:
                self._fail(str(err), 1, 1)
                return
        counts = self._writer.files.points
        counts.read += len(reading.points) + reading.dropped + reading.untimed
        counts.lose("no measurement", reading.dropped)
        counts.lose(_UNTIMED, reading.untimed)
        # With log times, all times of the message shift by as much as its stamp.
        shift = log_time_ns - reading.stamp_ns if self._by_log_time else 0
        start, end = revolution_span_ns(reading, self._use.period_ns, self._use.header_stamp_is)
        times = reading.times_ns if reading.times_ns is None or not shift else reading.times_ns + shift
        points = reading.points.copy() if self._by_plugin else reading.points  # a plug-in may keep its own
        self._writer.write(points, times, (start + shift, end + shift), log_time_ns)

    def _reading(self, message: Message) -> CloudReading:
        reading: CloudReading
        if self._use.msgtype in POINT_CLOUDS and not self._by_plugin:
            reading = read_pointcloud2(message)
        else:
            reading = self._decode(message, self._use.header_stamp_is, self._use.settings.stamp)
        if self._by_plugin and not reading.stamp_ns and not self._by_log_time:
            raise DecodeError(NO_STAMP)
        return reading if self._use.zero_points == "keep" else without_zero_points(reading)


def deskew(
    points: NDArray[np.float32],
    times_ns: NDArray[np.int64],
    stamp_ns: int,
    trajectory: Trajectory,
    ego_SE3_sensor: SE3,
) -> bool:
    """Move points to where the sensor would see them from where it was at `stamp_ns`.

    That removes the distortion that the sensor's own motion puts into a revolution:

        p(stamp) = inverse(global_SE3_sensor(stamp)) * global_SE3_sensor(t) * p(t)

    The combined transform is computed at knots one millisecond apart and interpolated linearly,
    entry by entry, in between. That is exact for uniform motion; at 1 rad/s a point 100 m away is
    0.01 mm off, and where the trajectory has a kink (the velocity jumps by 1 m/s at a pose) at most
    0.3 mm.

    Args:
        points: (N, 5) float32, x, y, z in the sensor frame when each was measured; changed in place.
        times_ns: (N,) when each was measured.
        stamp_ns: time to move them to.
        trajectory: poses of the ego frame.
        ego_SE3_sensor: where the sensor is mounted.

    Returns:
        False, with the points as they were, if there is no ego pose at the stamp, or at a time in between.
    """
    if not len(points):
        return True
    first = min(int(times_ns.min()), stamp_ns)
    last = max(int(times_ns.max()), stamp_ns)
    knots_ns = np.arange((last - first) // KNOT_NS + 2, dtype=np.int64) * KNOT_NS + first
    knots_ns[-1] = last  # poses may end there
    transforms = _sensor_motion(knots_ns, stamp_ns, trajectory, ego_SE3_sensor)
    if transforms is None:
        return False
    move_points(points, times_ns, knots_ns, transforms)
    return True


def _sensor_motion(
    times_ns: NDArray[np.int64], stamp_ns: int, trajectory: Trajectory, ego_SE3_sensor: SE3
) -> Floats | None:
    """Return (M, 12) rows of the 3x4 matrices `sensor(stamp)_SE3_sensor(t)`, None without a pose."""
    positions, rotations, valid = trajectory.at(np.append(times_ns, np.int64(stamp_ns)))
    if not valid.all():
        return None
    # global_SE3_sensor = global_SE3_ego * ego_SE3_sensor, for all times
    translations = positions + rotate(rotations, np.array(ego_SE3_sensor.translation)[None, :])
    rotations = quaternion_multiply(rotations, np.array(ego_SE3_sensor.rotation)[None, :])
    back = rotations[-1] * np.array([1.0, -1.0, -1.0, -1.0])
    moved_m = rotate(back[None, :], translations[:-1] - translations[-1])
    w, x, y, z = np.moveaxis(quaternion_multiply(back[None, :], rotations[:-1]), -1, 0)
    return np.stack(
        [
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), moved_m[:, 0],
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), moved_m[:, 1],
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), moved_m[:, 2],
        ],
        axis=1,
    )  # fmt: skip
