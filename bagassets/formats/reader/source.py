"""What the readers of all formats return: readings and scenes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bagassets.formats.reader.boxes import Box
from bagassets.geometry.se3 import SE3


@dataclass(frozen=True)
class Reading:
    """One image or cloud of a sample.

    Attributes:
        channel: its channel.
        modality: `camera`, `lidar` or `radar`.
        stamp_ns: its own time.
        path: its file.
        size_px: width and height of an image; zeros for others.
        ego_SE3_sensor: where the sensor sits.
        intrinsics: rows of the camera matrix; None for other sensors.
        find_pose: returns `global_SE3_ego` at its own time.
        frame: number of the frame that it is of a video; None for a file of its own.
    """

    channel: str
    modality: str
    stamp_ns: int
    path: Path
    size_px: tuple[int, int]
    ego_SE3_sensor: SE3
    intrinsics: Sequence[Sequence[float]] | None
    find_pose: Callable[[], SE3] = field(repr=False)
    frame: int | None = None


@dataclass(frozen=True)
class SceneRow:
    """A scene: its name, a description, and which samples of the dataset are its own."""

    name: str
    description: str
    samples: range


class ImagesOnly:
    """A source whose images are all samples, without boxes."""

    def before(self, index: int, channel: str, number: int) -> Sequence[Reading]:
        """Return nothing: every image is a sample."""
        del index, channel, number
        return ()

    def boxes(self, index: int) -> Sequence[Box]:
        """Return no boxes: the format has none."""
        del index
        return ()
