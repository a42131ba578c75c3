"""LeRobot datasets, version 3: every episode is a scene, every frame of it a sample with a channel for each camera."""

import json
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DatasetError
from bagassets.base.json_types import JsonObject
from bagassets.formats.reader.film import Film
from bagassets.formats.reader.source import ImagesOnly, Reading, SceneRow
from bagassets.formats.reader.table_folder import TableFolder
from bagassets.geometry.se3 import SE3

if TYPE_CHECKING:
    import pyarrow as pa

INFO = "meta/info.json"
_OWN = {"timestamp", "frame_index", "episode_index", "index", "task_index"}
_MOST_OPEN = 16  # files of data, or videos
T = TypeVar("T")


class LeRobotSource(ImagesOnly):
    """The content of a LeRobot dataset; it has no poses, no points and no boxes.

    Attributes:
        folder: the root of the dataset, `v3.0`.
    """

    def __init__(self, folder: TableFolder) -> None:
        self.folder = folder
        path = folder.path / INFO
        try:
            self._info: JsonObject = json.loads(path.read_text("utf-8"))
            version, self._fps = str(self._info["codebase_version"]), int(self._info["fps"])
            self._features: JsonObject = self._info["features"]
        except (OSError, ValueError, KeyError, TypeError) as err:
            raise folder.unreadable(path, err) from err
        if not version.startswith("v3."):
            raise DatasetError(
                f"{path}: this is version {version} of the format, and 3 can be read; lerobot converts older ones."
            )
        self._tables: OrderedDict[Path, Mapping[str, NDArray[Any]]] = OrderedDict()
        self._films: OrderedDict[Path, Film] = OrderedDict()

    def sample(self, index: int) -> tuple[str, int]:
        """Return name and time (ns) since the beginning of its episode of a frame, made now: there may be millions."""
        episode = self._episode_of(index)
        number = index - self._starts[episode]
        return f"episode_{episode:06d}/{number}", round(number * 1_000_000_000 / self._fps)

    @cached_property
    def scenes(self) -> Sequence[SceneRow]:
        """All episodes, each with its tasks."""
        ends = self._episodes["dataset_to_index"]
        stops = [*self._starts[1:], *map(int, ends[-1:])]
        return [
            SceneRow(f"episode_{number:06d}", "; ".join(tasks), range(start, stop))
            for number, (start, stop, tasks) in enumerate(
                zip(self._starts, stops, self._episodes["tasks"], strict=True)
            )
        ]

    @cached_property
    def modalities(self) -> Mapping[str, str]:
        """Feature -> modality, of those that are images."""
        return {name: "camera" for name, one in self._features.items() if one["dtype"] == "video"}

    @cached_property
    def splits(self) -> Mapping[str, Sequence[str]]:
        """Split -> names of its episodes."""
        names = [scene.name for scene in self.scenes]
        found = {}
        for split, numbers in self._info.get("splits", {}).items():
            begin, _, end = str(numbers).partition(":")
            found[split] = names[int(begin or 0) : int(end) if end else None]
        return found

    def readings(self, index: int) -> Mapping[str, Reading]:
        """Return the images of a frame, by the features that they are."""
        episode = self._episode_of(index)
        number = index - self._starts[episode]
        readings = {}
        for name in self.modalities:
            height, width = self._features[name]["shape"][:2]
            first = round(self._episodes[f"videos/{name}/from_timestamp"][episode] * self._fps)
            readings[name] = Reading(
                channel=name,
                modality="camera",
                stamp_ns=self.sample(index)[1],
                path=self._file(f"videos/{name}", episode, self._info["video_path"], video_key=name),
                size_px=(width, height),
                ego_SE3_sensor=SE3(),
                intrinsics=None,
                find_pose=self._no_pose,
                frame=first + number,
            )
        return readings

    def values(self, index: int) -> Mapping[str, NDArray[Any]]:
        """Return feature -> its value in a frame, of those that are no images.

        Raises:
            DatasetError: the file is missing or damaged.
        """
        path = self._file("data", self._episode_of(index), self._info["data_path"])
        columns = self._cached(self._tables, path, self._read_data)
        row = index - int(columns["index"].flat[0])
        return {name: columns[name][row] for name in self._features if name in columns and name not in _OWN}

    def image(self, reading: Reading) -> NDArray[np.uint8]:
        """Decode and return the image of a reading: (height, width, 3), RGB.

        Raises:
            DatasetError: the video is missing or damaged, or PyAV is not installed.
        """
        film = self._cached(self._films, reading.path, lambda path: Film(path, self._fps))
        return film.frame(reading.frame or 0)

    @cached_property
    def _episodes(self) -> Mapping[str, Sequence[Any]]:
        """Columns of the table of episodes, without their statistics."""
        tables = [
            self._read_table(path) for path in sorted(self.folder.path.glob("meta/episodes/*/*.parquet"))
        ]
        if not tables:
            raise self.folder.missing(self.folder.path / "meta/episodes/chunk-000/file-000.parquet")
        names = [name for name in tables[0].column_names if not name.startswith("stats/")]
        return {
            name: [value for table in tables for value in table.column(name).to_pylist()] for name in names
        }

    @cached_property
    def _starts(self) -> Sequence[int]:
        return [int(start) for start in self._episodes["dataset_from_index"]]

    def _episode_of(self, index: int) -> int:
        return bisect_right(self._starts, index) - 1

    def _file(self, what: str, episode: int, template: str, **more: str) -> Path:
        chunk, file = (int(self._episodes[f"{what}/{part}_index"][episode]) for part in ("chunk", "file"))
        return self.folder.path / template.format(chunk_index=chunk, file_index=file, **more)

    def _cached(self, cache: "OrderedDict[Path, T]", path: Path, make: Callable[[Path], T]) -> T:
        """Return what was made of a file, the same for as long as it is one of the last that were used.

        Files of one name differ from build to build, so the dataset must still be the one that was opened.
        """
        if path not in cache:
            if not self.folder.is_current():
                raise self.folder.outdated(path)
            if not path.is_file():
                raise self.folder.missing(path)
            cache[path] = make(path)
            if len(cache) > _MOST_OPEN:
                cache.popitem(last=False)
        cache.move_to_end(path)
        return cache[path]

    def _read_table(self, path: Path) -> "pa.Table":
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            return pq.read_table(path)
        except (OSError, pa.ArrowException) as err:
            raise self.folder.unreadable(path, err) from err

    def _read_data(self, path: Path) -> Mapping[str, NDArray[Any]]:
        import pyarrow as pa

        columns: dict[str, NDArray[Any]] = {}
        table = self._read_table(path).combine_chunks()
        for name in table.column_names:
            column = table.column(name).combine_chunks()
            shape, flat = self._features.get(name, {}).get("shape") or [1], column
            while pa.types.is_list(flat.type) or pa.types.is_fixed_size_list(flat.type):
                flat = flat.flatten()
            columns[name] = flat.to_numpy(zero_copy_only=False).reshape(len(column), *shape)
        return columns

    def _no_pose(self) -> NoReturn:
        raise DatasetError(f"{self.folder.path}: a LeRobot dataset has no poses.")
