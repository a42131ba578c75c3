"""Vision datasets: every sequence of a camera is a scene, every image of it a sample with one channel."""

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from math import cos, sin

from bagassets.base.errors import DatasetError
from bagassets.base.json_types import JsonObject
from bagassets.formats.reader.source import ImagesOnly, Reading, SceneRow
from bagassets.formats.reader.table_folder import LOCK, TableFolder
from bagassets.geometry.euler import of_half_angles
from bagassets.geometry.se3 import SE3

_MANIFEST = ".manifest.json"


class VisionSource(ImagesOnly):
    """The content of a vision dataset; it has no points and no boxes.

    The global frame of a sequence is the ego frame at its first image.

    Attributes:
        folder: the folder `annotations`.
        root: folder of the dataset.
    """

    def __init__(self, folder: TableFolder) -> None:
        self.folder = folder
        self.root = folder.path.parent

    def sample(self, index: int) -> tuple[str, int]:
        """Return name of the image below the dataset, and time (ns), of a sample; they are numbered sequence by sequence."""
        row, frame = self._frames[index]
        return f"{row['folder']}/{frame['file']}", frame["stamp_ns"]

    @cached_property
    def scenes(self) -> Sequence[SceneRow]:
        """All sequences: `recording/channel/number`."""
        scenes, start = [], 0
        for row in self._sequences:
            samples = range(start, start + len(row["frames"]))
            scenes.append(SceneRow(_name(row), f"{row['channel']} of {row['recording']}", samples))
            start = samples.stop
        return scenes

    @cached_property
    def modalities(self) -> Mapping[str, str]:
        """Channel -> modality: all are cameras."""
        return {row["channel"]: "camera" for row in self._sequences}

    @cached_property
    def splits(self) -> Mapping[str, Sequence[str]]:
        """Split -> names of its sequences."""
        splits: dict[str, list[str]] = {}
        for name in sorted(self.folder.names):
            if name.endswith(_MANIFEST):
                own = {bag["recording"] for bag in self.folder.read(name)["bags"]}
                splits[name.removesuffix(_MANIFEST)] = [
                    _name(row) for row in self._sequences if row["recording"] in own
                ]
        return splits

    def readings(self, index: int) -> Mapping[str, Reading]:
        """Return the one image of a sample, by its channel."""
        row, frame = self._frames[index]
        mounted = row["ego_SE3_sensor"]
        reading = Reading(
            channel=row["channel"],
            modality="camera",
            stamp_ns=frame["stamp_ns"],
            path=self.root / row["folder"] / frame["file"],
            size_px=(row["width"], row["height"]),
            ego_SE3_sensor=SE3.create(mounted["rotation"], mounted["translation"]),
            intrinsics=row["intrinsics"],
            find_pose=partial(self._pose, row, frame),
        )
        return {reading.channel: reading}

    def _pose(self, row: JsonObject, frame: JsonObject) -> SE3:
        """Return the transform of x, y, z and roll, pitch, yaw about fixed axes.

        Raises:
            DatasetError: the rig has no ego poses.
        """
        if frame["pose"] is None:
            raise DatasetError(
                f"{self.root / row['folder']}: these images have no poses, because the recipe gives the rig no ego_pose; "
                "add one and build again, or do without poses and transforms."
            )
        x, y, z, *angles = frame["pose"]
        sines, cosines = ([of(angle / 2) for angle in angles] for of in (sin, cos))
        return SE3.create(of_half_angles(sines, cosines), (x, y, z))

    @cached_property
    def _sequences(self) -> Sequence[JsonObject]:
        names = sorted(name for name in self.folder.names if name != LOCK and not name.endswith(_MANIFEST))
        return [row for name in names for row in self.folder.rows(name)]

    @cached_property
    def _frames(self) -> Sequence[tuple[JsonObject, JsonObject]]:
        return [(row, frame) for row in self._sequences for frame in row["frames"]]


def _name(row: JsonObject) -> str:
    return f"{row['recording']}/{row['channel']}/{row['sequence']}"
