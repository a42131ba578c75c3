"""Readings: the results of decoders, one class per kind of sensor data."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bagassets.decode.point_times import RecordedTimes
from bagassets.geometry.se3 import SE3


@dataclass(frozen=True, slots=True, eq=False)
class ImageReading:
    """One camera image.

    Attributes:
        stamp_ns: header stamp.
        frame_id: sensor frame, without leading slash.
        pixels: (H, W) or (H, W, 3) BGR, uint8 or uint16; (H, W) float32 is depth in metres; None if there is only `encoded`.
        encoded: the recorded bytes of a JPEG, PNG or RVL, possibly a view of the message; else None.
        encoding: the raw encoding as recorded; or `jpeg` or `png`, followed by `:rgb` if red and blue are swapped, or by a
            colon and the Bayer pattern of a compressed mosaic; or `png` or `rvl:`, of depth in metres by what its numbers mean.
    """

    stamp_ns: int
    frame_id: str
    pixels: NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32] | None
    encoded: bytes | memoryview | None
    encoding: str


@dataclass(frozen=True, slots=True, eq=False)
class CloudReading:
    """Points of one lidar message or revolution.

    Attributes:
        stamp_ns: time that the points are given for: the header stamp, or another moment of the revolution.
        frame_id: sensor frame, without leading slash.
        points: (N, 5) float32: x, y, z in metres in the sensor frame, intensity, ring.
        times_ns: (N,) int64 absolute time of each point, or None if not recorded.
        dropped: number of points dropped because they are no measurements: not finite, or at exactly 0, 0, 0.
        span_ns: time of the first and last measurement, whether or not it hit anything; None if unknown.
        untimed: number of points dropped because they alone have no time that can be used.
        recorded: times before it is known what they are; None for those that are what their message type says.
    """

    stamp_ns: int
    frame_id: str
    points: NDArray[np.float32]
    times_ns: NDArray[np.int64] | None
    dropped: int = 0
    span_ns: tuple[int, int] | None = None
    untimed: int = 0
    recorded: RecordedTimes | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RadarReading:
    """Targets of one radar message.

    Attributes:
        stamp_ns: header stamp.
        frame_id: sensor frame, without leading slash.
        targets: field of the nuScenes radar format -> (N,) array; always with x, y, z.
        dropped: number of targets dropped because they are not finite.
        radial: its velocities are only what was measured along the line of sight.
    """

    stamp_ns: int
    frame_id: str
    targets: dict[str, NDArray[np.float64]]
    dropped: int = 0
    radial: bool = False


@dataclass(frozen=True, slots=True)
class PoseReading:
    """`parent_SE3_child` at a time, such as that of one edge of a TF tree."""

    stamp_ns: int
    parent: str
    child: str
    parent_SE3_child: SE3


@dataclass(frozen=True, slots=True)
class BoxReading:
    """One 3-D box in its recorded frame.

    Attributes:
        stamp_ns: time of the box.
        frame_id: frame of the pose, without leading slash.
        frame_SE3_box: pose of the box centre; x forward, y left, z up.
        size_m: width (y), length (x), height (z), as in nuScenes.
        track_id: identifies an object over time within a recording.
        category: as recorded, before mapping.
        attributes: as recorded.
        score: confidence, 1.0 for ground truth.
        source: topic or file.
    """

    stamp_ns: int
    frame_id: str
    frame_SE3_box: SE3
    size_m: tuple[float, float, float]
    track_id: str
    category: str
    attributes: tuple[str, ...] = ()
    score: float = 1.0
    source: str = field(default="")
