"""Datasets to iterate over: scenes, samples, and what their sensors saw.

Nothing is decoded before it is asked for. Names that are not there raise KeyError with those that are.
"""

from abc import abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar, overload
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DatasetError
from bagassets.base.quantities import count_text
from bagassets.formats.nuscenes.schema import TABLES
from bagassets.formats.reader.ahead import Ahead, in_order
from bagassets.formats.reader.boxes import Boxes, View
from bagassets.formats.reader.lerobot import INFO, LeRobotSource
from bagassets.formats.reader.nuscenes import NuScenesSource
from bagassets.formats.reader.reading_files import Points, read_image, read_points
from bagassets.formats.reader.source import Reading, SceneRow
from bagassets.formats.reader.table_folder import LOCK, TableFolder
from bagassets.formats.reader.vision import VisionSource
from bagassets.geometry.se3 import Floats

T = TypeVar("T")
Source = NuScenesSource | VisionSource | LeRobotSource
"""The content of a dataset of one format, offered alike; tables are read when they are first needed."""

_ANNOTATIONS = "annotations"  # folder of a vision dataset that is swapped
_MOST_NAMES = 12


def open_dataset(path: str | Path, version: str | None = None) -> "Dataset":
    """Open a dataset that was built: vision, nuScenes or LeRobot, the latter two also from elsewhere.

    The scenes of a LeRobot dataset are its episodes, the samples its frames.

    What is opened stays as it is while the dataset is built again: readers see the old dataset or the new one. Only
    where the new one has lost a file of the old one, or made it again with other bytes, reading it fails, with a
    sentence that says so.

    Args:
        path: folder of the dataset, or its version folder.
        version: version folder of a nuScenes dataset; None if there is only one.

    Raises:
        DatasetError: there is no dataset, there are several, or a table is missing.
    """
    folder = _folder_of(Path(path).absolute(), version)
    return Dataset(_source(folder))


class _Samples(Sequence["Sample"]):
    """Samples of a dataset, as a sequence."""

    _source: Source

    @property
    @abstractmethod
    def _numbers(self) -> range:
        """Their numbers in the dataset."""

    def __len__(self) -> int:
        return len(self._numbers)

    @overload
    def __getitem__(self, index: int) -> "Sample": ...
    @overload
    def __getitem__(self, index: slice) -> "list[Sample]": ...
    def __getitem__(self, index: int | slice) -> "Sample | list[Sample]":
        if isinstance(index, slice):
            return [Sample(self._source, number) for number in self._numbers[index]]
        if not -len(self) <= index < len(self):
            raise IndexError(f"there is no sample {index} in {self!r}")
        return Sample(self._source, self._numbers[index])

    def __iter__(self) -> "Iterator[Sample]":
        return in_order(self._numbers, partial(Sample, self._source))


class Dataset(_Samples):
    """A dataset as a sequence of its samples, scene by scene.

    It can be sent to other processes, as a PyTorch `DataLoader` does with several workers: they open the same
    folder, and refuse it if it was built again meanwhile.

    Attributes:
        path: folder with its tables.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self.path = source.folder.path

    def __reduce__(self) -> tuple[object, ...]:
        return _reopened, (Dataset, *_ticket(self._source))

    def __repr__(self) -> str:
        numbers = f"{count_text(len(self.scenes), 'scene')}, {count_text(len(self), 'sample')}"
        return f"<Dataset {self.path}: {numbers}, {', '.join(self.channels) or 'no channels'}>"

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of all channels: cameras, then lidars, then radars."""
        names = sorted((_rank(modality), name) for name, modality in self._source.modalities.items())
        return tuple(name for _, name in names)

    @cached_property
    def scenes(self) -> "tuple[Scene, ...]":
        """All scenes, in the order of the dataset."""
        return tuple(Scene(self._source, row) for row in self._source.scenes)

    @cached_property
    def splits(self) -> Mapping[str, tuple[str, ...]]:
        """Split -> names of its scenes."""
        return {name: tuple(scenes) for name, scenes in self._source.splits.items()}

    def scene(self, name: str) -> "Scene":
        """Return a scene by its name.

        Raises:
            KeyError: there is none.
        """
        return _found(self._scenes_by_name, name, "scene", "the dataset")

    def sample(self, token: str) -> "Sample":
        """Return a sample by its token.

        Raises:
            KeyError: there is none.
        """
        if token not in self._by_token:
            raise KeyError(f"no sample {token} in {self.path}")
        return self[self._by_token[token]]

    @cached_property
    def _numbers(self) -> range:
        return range(max((scene.samples.stop for scene in self._source.scenes), default=0))

    @cached_property
    def _scenes_by_name(self) -> "Mapping[str, Scene]":
        return {scene.name: scene for scene in self.scenes}

    @cached_property
    def _by_token(self) -> Mapping[str, int]:
        return {self._source.sample(number)[0]: number for number in self._numbers}


class Scene(_Samples):
    """A scene as a sequence of its samples.

    Attributes:
        name: its name.
        description: what the dataset says about it.
    """

    def __init__(self, source: Source, row: SceneRow) -> None:
        self._source = source
        self._row = row
        self.name = row.name
        self.description = row.description

    def __reduce__(self) -> tuple[object, ...]:
        return _reopened, (Scene, *_ticket(self._source), self._row)

    def __repr__(self) -> str:
        return f"<Scene {self.name}: {count_text(len(self), 'sample')}>"

    @property
    def _numbers(self) -> range:
        return self._row.samples


class Sample:
    """One moment: a keyframe of each sensor, and the boxes at that time.

    Every reading has a time of its own, near that of the sample; poses are those at the time of the reading.

    Attributes:
        index: its number in the dataset.
        token: its token.
        stamp_ns: its time.
    """

    def __init__(self, source: Source, index: int, ahead: Ahead | None = None) -> None:
        self._source = source
        self.index = index
        self._ahead = ahead or Ahead()
        self.token, self.stamp_ns = self._source.sample(index)

    def __reduce__(self) -> tuple[object, ...]:
        return _reopened, (Sample, *_ticket(self._source), self.index)

    def __repr__(self) -> str:
        return f"<Sample {self.index} at {self.stamp_ns / 1e9:.3f} s: {', '.join(self.channels) or 'no readings'}>"

    @cached_property
    def readings(self) -> Mapping[str, Reading]:
        """Channel -> its reading: file, time, size."""
        readings = self._source.readings(self.index).values()
        ranked = sorted(readings, key=lambda reading: (_rank(reading.modality), reading.channel))
        return {reading.channel: reading for reading in ranked}

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that have a reading here."""
        return tuple(self.readings)

    @cached_property
    def values(self) -> Mapping[str, NDArray[Any]]:
        """Feature of a LeRobot dataset -> its numbers, such as `observation.state`; no other format has any.

        Raises:
            DatasetError: their file is missing or damaged.
        """
        return self._source.values(self.index) if isinstance(self._source, LeRobotSource) else {}

    @cached_property
    def boxes(self) -> Boxes:
        """The boxes at the time of the sample, in the global frame."""
        return Boxes(self._source.boxes(self.index), "global", partial(_view, self.readings))

    def image(self, channel: str) -> NDArray[Any]:
        """Decode and return the image of a camera: uint8 (height, width, 3), RGB; of 16 bits, as depth is, uint16 (height, width).

        Raises:
            KeyError: the sample has no image of this camera.
            DatasetError: the file is missing or damaged.
        """
        reading = _chosen(self.readings, channel, ("camera",))
        if isinstance(self._source, LeRobotSource):  # its videos are decoded in order
            return self._source.image(reading)
        return self._ahead.take(channel, Sample.image, partial(read_image, self._source.folder, reading))

    def points(self, channel: str) -> Points:
        """Read and return the points of a lidar or radar, float32 in the frame of the sensor, metres.

        Of a lidar, (N, 5): x, y, z, intensity, ring. Of a radar, (N, 18): the fields of nuScenes, named in
        `.fields`, of all targets, whatever their states (the devkit leaves some out by default).

        Raises:
            KeyError: the sample has no points of this channel.
            DatasetError: the file is missing or damaged.
        """
        reading = _chosen(self.readings, channel, ("lidar", "radar"))
        return self._ahead.take(channel, Sample.points, partial(read_points, self._source.folder, reading))

    def sweeps(self, channel: str, number: int) -> "list[Sweep]":
        """Return what a channel read before this sample, newest first: at most `number` readings of its scene.

        As the links `prev` of the devkit have it, those between two samples and those of earlier samples alike. Nothing is
        decoded yet. The first time a channel is asked for, its part of the tables is read. Only nuScenes datasets have any.

        Raises:
            KeyError: the sample has no reading of this channel.
        """
        _chosen(self.readings, channel)
        before = self._source.before(self.index, channel, number)
        return [Sweep(self._source, self.index, place, reading) for place, reading in enumerate(before)]

    def global_SE3_ego(self, channel: str) -> Floats:
        """Return the pose of the ego frame at the time of the reading of a channel, (4, 4).

        Raises:
            KeyError: the sample has no reading of this channel.
        """
        return _chosen(self.readings, channel).find_pose().matrix

    def ego_SE3_sensor(self, channel: str) -> Floats:
        """Return the pose of a sensor in the ego frame, (4, 4).

        Raises:
            KeyError: the sample has no reading of this channel.
            DatasetError: the format has no calibration.
        """
        return _placed(_chosen(self.readings, channel)).ego_SE3_sensor.matrix

    def intrinsics(self, channel: str) -> Floats:
        """Return the camera matrix of an image as written, (3, 3) in pixels; there is no distortion left.

        Raises:
            KeyError: the sample has no image of this camera.
            DatasetError: the format has no calibration, or the camera no intrinsics.
        """
        return _matrix(_chosen(self.readings, channel, ("camera",)))


class Sweep:
    """One reading of a channel before a sample.

    Attributes:
        reading: its file, time, size.
    """

    def __init__(self, source: Source, index: int, place: int, reading: Reading) -> None:
        self._source = source
        self._index, self._place = index, place
        self.reading = reading

    def __reduce__(self) -> tuple[object, ...]:
        return _reopened, (_sweep, *_ticket(self._source), self._index, self.channel, self._place)

    def __repr__(self) -> str:
        return f"<Sweep of {self.channel} at {self.stamp_ns / 1e9:.3f} s>"

    @property
    def channel(self) -> str:
        """Its channel."""
        return self.reading.channel

    @property
    def stamp_ns(self) -> int:
        """Its own time."""
        return self.reading.stamp_ns

    def image(self) -> NDArray[Any]:
        """Decode and return the image of a camera, as `Sample.image`.

        Raises:
            KeyError: it is no image.
            DatasetError: the file is missing or damaged.
        """
        return read_image(self._source.folder, self._of("camera"))

    def points(self) -> Points:
        """Read and return the points of a lidar or radar, as `Sample.points`.

        Raises:
            KeyError: it has no points.
            DatasetError: the file is missing or damaged.
        """
        return read_points(self._source.folder, self._of("lidar", "radar"))

    def global_SE3_ego(self) -> Floats:
        """Return the pose of the ego frame at its time, (4, 4)."""
        return self.reading.find_pose().matrix

    def ego_SE3_sensor(self) -> Floats:
        """Return the pose of its sensor in the ego frame, (4, 4)."""
        return self.reading.ego_SE3_sensor.matrix

    def intrinsics(self) -> Floats:
        """Return the camera matrix, as `Sample.intrinsics`.

        Raises:
            KeyError: it is no image.
            DatasetError: the camera has no intrinsics.
        """
        return _matrix(self._of("camera"))

    def _of(self, *modalities: str) -> Reading:
        return _chosen({self.channel: self.reading}, self.channel, modalities)


def _rank(modality: str) -> int:
    order = ("camera", "lidar", "radar")
    return order.index(modality) if modality in order else len(order)


def _chosen(readings: Mapping[str, Reading], channel: str, modalities: Collection[str] = ()) -> Reading:
    fitting = {name: one for name, one in readings.items() if not modalities or one.modality in modalities}
    return _found(fitting, channel, " or ".join(modalities) or "channel", "this sample")


def _matrix(camera: Reading) -> Floats:
    if not (rows := _placed(camera).intrinsics):
        why = "has no intrinsics in this dataset; record its CameraInfo, or give `intrinsics` in the recipe"
        raise DatasetError(f"{camera.path}: {camera.channel} {why}.")
    return np.array(rows, dtype=np.float64)


def _placed(reading: Reading) -> Reading:
    """Return a reading; frames of a LeRobot dataset have no calibration."""
    if reading.frame is not None:
        raise DatasetError(f"{reading.path}: a LeRobot dataset has no calibration and no poses.")
    return reading


def _view(readings: Mapping[str, Reading], channel: str) -> View:
    reading = _chosen(readings, channel, ("camera",))
    cam_SE3_global = (reading.find_pose() @ reading.ego_SE3_sensor).inverse()
    return View(cam_SE3_global, partial(_matrix, reading), reading.size_px)


def _found(things: Mapping[str, T], name: str, what: str, where: str) -> T:
    """Return a thing by its name; raise KeyError with the names that are there."""
    if name in things:
        return things[name]
    names = [*list(things)[:_MOST_NAMES], *(["…"] if len(things) > _MOST_NAMES else [])]
    raise KeyError(f"{name}: {where} has no such {what}; there is {', '.join(names) or 'none'}")


# --- opening, here and in other processes ----------------------------------------------------

# What is open in this process: a sample that comes from another one belongs to it.
_open: "WeakValueDictionary[tuple[Path, str], Source]" = WeakValueDictionary()


def _source(folder: TableFolder) -> Source:
    source: Source
    if (folder.path / INFO).is_file():
        source = LeRobotSource(folder)
    else:
        source = VisionSource(folder) if folder.path.name == _ANNOTATIONS else NuScenesSource(folder)
    _open[folder.path, folder.identity] = source
    return source


def _ticket(source: Source) -> tuple[Path, str]:
    """Return what other processes need to open the same dataset."""
    return source.folder.path, source.folder.identity


def _reopened(make: Callable[..., object], path: Path, identity: str, *args: object) -> object:
    """Return what `make` makes of a dataset that another process opened, or this one.

    Raises:
        DatasetError: it was built again since.
    """
    source = _open.get((path, identity))
    if source is None:
        folder = TableFolder(path)
        if folder.identity != identity:
            raise DatasetError(f"{path}: this dataset was built again since it was opened; open it again.")
        source = _source(folder)
    return make(source, *args)


def _sweep(source: Source, index: int, channel: str, place: int) -> Sweep:
    return Sample(source, index).sweeps(channel, place + 1)[place]


def _folder_of(path: Path, version: str | None) -> TableFolder:
    """Return the swapped folder of a dataset."""
    if path.is_file():
        raise DatasetError(f"{path}: expected the folder of a dataset, found a file{_below(path.parent)}.")
    if not path.is_dir():
        raise DatasetError(
            f"{path}: there is no such folder; `bagassets build` makes the dataset that a recipe asks for."
        )
    if version is not None:
        if not _is_swapped(path / version):
            raise DatasetError(f"{path}: there is no version {version}; {_offer(path)}")
        return TableFolder(path / version)
    if _is_swapped(path):
        return TableFolder(path)
    below = _versions(path)
    if len(below) != 1:
        expected = "`version` to name one" if below else "a dataset with one version"
        raise DatasetError(f"{path}: expected {expected}; {_offer(path)}")
    return TableFolder(path / below[0])


def _offer(path: Path) -> str:
    names = _versions(path)
    return f"there is {', '.join(names) or f'none{_below(path)}'}."


def _below(path: Path) -> str:
    """Return a clause with the datasets of a project; "" if there is none."""
    found = sorted(one.parents[1] for at in ("*/*", "dataset/*/*") for one in path.glob(f"{at}/{LOCK}"))
    return f"; name {' or '.join(map(str, found))}" if found else ""


def _versions(path: Path) -> list[str]:
    # What a killed build left is no version.
    return sorted(one.name for one in path.iterdir() if ".tmp-" not in one.name and _is_swapped(one))


def _is_swapped(path: Path) -> bool:
    """Tell whether a folder holds the tables of a dataset, although some may be missing."""
    if path.name == _ANNOTATIONS:
        return (path / LOCK).is_file()
    return any((path / f"{name}.json").is_file() for name in TABLES) or (path / INFO).is_file()
