"""What a reader of a dataset format offers to `bagassets.reader.dataset`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from bagassets.geometry.se3 import SE3
from bagassets.reader.boxes import Box
from bagassets.reader.table_folder import TableFolder

__all__ = ["Reading", "SceneRow", "Source"]


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
    """

    channel: str
    modality: str
    stamp_ns: int
    path: Path
    size_px: tuple[int, int]
    ego_SE3_sensor: SE3
    intrinsics: Sequence[Sequence[float]] | None
    find_pose: Callable[[], SE3] = field(repr=False)


@dataclass(frozen=True)
class SceneRow:
    """A scene: its name, a description, and which samples of the dataset are its own."""

    name: str
    description: str
    samples: range


class Source(Protocol):
    """The content of a dataset; tables are read when they are first needed.

    Attributes:
        folder: its swapped folder.
        root: folder that its files are below.
    """

    folder: TableFolder
    root: Path

    @property
    def scenes(self) -> Sequence[SceneRow]:
        """All scenes, in the order of the dataset."""

    @property
    def samples(self) -> Sequence[tuple[str, int]]:
        """Token and time (ns) of all samples, scene by scene."""

    @property
    def modalities(self) -> Mapping[str, str]:
        """Channel -> modality, of all channels of the dataset."""

    @property
    def splits(self) -> Mapping[str, Sequence[str]]:
        """Split -> names of its scenes."""

    def readings(self, index: int) -> Mapping[str, Reading]:
        """Return channel -> reading of a sample."""

    def before(self, index: int, channel: str, number: int) -> Sequence[Reading]:
        """Return at most `number` readings of a channel before that of a sample, newest first."""

    def boxes(self, index: int) -> Sequence[Box]:
        """Return the boxes of a sample in the global frame."""
