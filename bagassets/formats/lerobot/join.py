"""Joining the episodes of all recordings into a LeRobot dataset, version 3.0.

Files of videos and rows are joined in groups of neighbours (`groups`), and those whose group is as in the dataset on disk are
linked from there: `meta/bagassets.json` says what each was joined from. Rows carry numbers of the whole dataset, so those after
an inserted episode are written again; packets of videos carry none.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from bagassets.base import files
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.engine.splits import SplitShare
from bagassets.formats.format import Joined, Kept, Member
from bagassets.formats.json_files import json_bytes, write_hashed
from bagassets.formats.lerobot import video
from bagassets.formats.lerobot.episode import Episode, File
from bagassets.formats.lerobot.groups import Limits, Unit, grouped
from bagassets.formats.lerobot.metadata import (
    CHUNK_FILES,
    DATA,
    VIDEOS,
    episodes_table,
    info,
    tasks_table,
    write_table,
)
from bagassets.formats.lerobot.recording_part import EPISODES, ROWS
from bagassets.formats.lerobot.settings import MOST_S, LeRobot
from bagassets.formats.lerobot.statistics import added, of_images, of_runs, of_values
from bagassets.store.canonical import digest_file, digest_json

SOURCES = "meta/bagassets.json"
_USUAL_S = 200  # of a video file
_USUAL_VIDEO, _MOST_VIDEO = 40_000_000, 200_000_000
_USUAL_DATA, _MOST_DATA = 20_000_000, 100_000_000
_JOIN_VERSION = 1
_ROW_BYTES = 40  # of the columns that every dataset has


class Join:
    """Joins one dataset.

    Args:
        members: recordings in the order of their keys, of equal features.
        settings: the recipe's `lerobot`.
        shares: each split's share, in order of their names.
        out: empty folder.
        kept: files of the dataset on disk.
    """

    def __init__(
        self,
        members: Sequence[Member],
        settings: LeRobot,
        shares: Sequence[SplitShare],
        out: Path,
        kept: Kept,
    ) -> None:
        self._settings, self._out, self._kept = settings, out, kept
        self._shares = [share.name for share in shares]
        self._order = sorted(members, key=lambda one: (self._shares.index(one.split), one.part.key))
        self.features: JsonObject = next(
            (dict(one.facts["features"]) for one in self._order if one.facts["episodes"]), {}
        )
        self.tasks: dict[str, int] = {}
        self.episodes = list(self._read())
        self._digests: dict[str, str] = {}
        self._keys: dict[str, str] = {}
        self._written: list[str] = []

    def _read(self) -> Iterator[Episode]:
        usual = self._settings.task if isinstance(self._settings.task, str) else ""
        index = first = 0
        for member in self._order:
            offset = 0
            for number, facts in enumerate(
                member.artifact.read_json(EPISODES) if member.facts["episodes"] else ()
            ):
                task = self.tasks.setdefault(facts["task"] or usual, len(self.tasks))
                yield Episode(index, first, member, number, offset, facts, task)
                index, first, offset = index + 1, first + facts["length"], offset + facts["length"]

    @cached_property
    def _before(self) -> JsonMapping:
        """What `meta/bagassets.json` of the dataset on disk says."""
        try:
            found = json.loads(self._kept.path(SOURCES).read_bytes()) if SOURCES in self._kept.digests else {}
        except (OSError, ValueError):
            found = {}
        return found if isinstance(found, dict) else {}

    @property
    def _filmed(self) -> list[str]:
        return [name for name, one in self.features.items() if one["dtype"] == "video"]

    def run(self) -> Joined:
        """Write all files; return their digests."""
        fps, number = self._settings.fps, len(self.episodes)
        data, columns = self._data()
        films = {name: self._films(name) for name in self._filmed}
        statistics = self._statistics(columns)
        places = {"data": data} | {f"videos/{name}": files for name, files in films.items()}
        splits, start = {}, 0
        for share in self._shares:
            stop = start + sum(one.member.split == share for one in self.episodes)
            if stop > start:
                splits[share] = f"{start}:{stop}"
            start = stop
        robots = {one.facts["rig"] for one in self._order}
        robot = self._settings.robot or (robots.pop() if len(robots) == 1 else None)
        total = sum(one.length for one in self.episodes)
        text = info(self._settings, self.features, robot, (number, total, len(self.tasks)), splits)
        self._write("meta/info.json", lambda path: write_hashed(path, json_bytes(text)))
        self._write("meta/stats.json", lambda path: write_hashed(path, json_bytes(statistics)))
        self._write("meta/tasks.parquet", lambda path: write_table(path, tasks_table(list(self.tasks))))
        rows = episodes_table(self.episodes, places, self.features, list(self.tasks), fps)
        self._write("meta/episodes/chunk-000/file-000.parquet", lambda path: write_table(path, rows))
        sources = {"files": self._keys, "episodes": [self._source(one) for one in self.episodes]}
        self._write(SOURCES, lambda path: write_hashed(path, json_bytes(sources)))
        facts: JsonObject = {
            "episodes": number,
            "frames": total,
            "joined_files": f"{len(self._written)} written, {len(self._keys) - len(self._written)} as before",
        }
        if renumbered := self._renumbered():
            facts["renumbered"] = renumbered
        return Joined(dict(sorted(self._digests.items())), facts)

    def _write(self, name: str, write: Callable[[Path], object]) -> None:
        path = self._out / name
        files.make_folder(path.parent)
        write(path)
        self._digests[name] = digest_file(path)

    def _shared(self, name: str, key: str, write: Callable[[Path], object]) -> bool:
        """Link a file of the dataset on disk that was joined from the same, or write it; return whether it was there."""
        self._keys[name] = key
        before: JsonMapping = self._before.get("files", {})
        same = next(
            (one for one, other in before.items() if other == key and one in self._kept.digests), None
        )
        if same is None:
            self._write(name, write)
            self._written.append(name)
            return False
        path = self._out / name
        files.make_folder(path.parent)
        files.link(self._kept.path(same), path)
        self._digests[name] = self._kept.digests[same]
        return True

    def _files(self, units: Sequence[Unit], limits: Limits, name: Callable[..., str]) -> list[File]:
        """Return the files in which episodes are, by what `units` say of each."""
        found = []
        for number, group in enumerate(grouped(units, limits)):
            chunk, file = place = divmod(number, CHUNK_FILES)
            own = [self.episodes[one] for one in group]
            found.append(File(name(chunk_index=chunk, file_index=file), place, own))
        return found

    def _films(self, feature: str) -> list[File]:
        """Join the videos of a camera; return the files."""
        fps = self._settings.fps
        limits = Limits(_USUAL_S * fps, _USUAL_VIDEO, MOST_S * fps - 1, _MOST_VIDEO)
        films = [one.facts["videos"][feature] for one in self.episodes]
        units = [
            Unit(one.name, one.length, film["size"], film["header"])
            for one, film in zip(self.episodes, films, strict=True)
        ]
        files = self._files(units, limits, partial(VIDEOS.format, video_key=feature))
        for file in files:
            parts = [(one, one.facts["videos"][feature]["file"]) for one in file.episodes]
            key = digest_json([_JOIN_VERSION, fps, [[one.member.part.artifact, name] for one, name in parts]])
            paths = [(one.member.artifact.path(name), one.length) for one, name in parts]
            self._shared(file.name, key, partial(video.join, paths, fps))
        return files

    def _data(self) -> tuple[list[File], dict[str, NDArray[np.float32]]]:
        """Write the rows of all episodes; return the files, and the features of signals in all frames, (N, D) each."""
        numeric = {name: one["shape"][0] for name, one in self.features.items() if one["dtype"] != "video"}
        row_bytes = 4 * sum(numeric.values()) + _ROW_BYTES
        most_frames = _MOST_DATA // row_bytes
        limits = Limits(_USUAL_DATA // row_bytes, _USUAL_DATA, most_frames, _MOST_DATA)
        units = [Unit(one.name, one.length, one.length * row_bytes) for one in self.episodes]
        files = self._files(units, limits, DATA.format)
        parts: dict[str, list[NDArray[np.float32]]] = {name: [] for name in numeric}
        for file in files:
            first = file.episodes[0]
            sources = [[one.member.part.artifact, one.number, one.task] for one in file.episodes]
            key = digest_json([_JOIN_VERSION, self._settings.fps, first.index, first.first, sources])
            tables: list[pa.Table] = []

            def write(path: Path, file: File = file, tables: list[pa.Table] = tables) -> None:
                tables.append(self._rows(file.episodes, list(numeric)))
                write_table(path, tables[0])

            if self._shared(file.name, key, write):
                tables.append(pq.read_table(self._out / file.name, columns=list(numeric), partitioning=None))
            for name, width in numeric.items():
                parts[name].append(_matrix(tables[0].column(name), width))
        return files, {name: np.concatenate(those) for name, those in parts.items() if those}

    def _rows(self, episodes: Sequence[Episode], features: Sequence[str]) -> pa.Table:
        """Return the rows of some episodes."""
        tables: dict[str, pa.Table] = {}
        for one in episodes:
            if one.member.part.artifact not in tables:
                tables[one.member.part.artifact] = one.member.artifact.read_table(ROWS, list(features))
        pieces = [tables[one.member.part.artifact].slice(one.offset, one.length) for one in episodes]
        table = pa.concat_tables(pieces).combine_chunks()
        columns = {name: table.column(name) for name in features}
        own = self._own_columns(episodes)
        return pa.table(columns | {name: pa.array(values) for name, values in own.items()})

    def _own_columns(self, episodes: Sequence[Episode]) -> dict[str, NDArray[np.int64] | NDArray[np.float32]]:
        """Return the columns that every dataset has, for neighbouring episodes, (N,) each."""
        lengths = np.array([one.length for one in episodes])
        frames = np.concatenate([np.arange(length, dtype=np.int64) for length in lengths])
        return {
            "timestamp": (frames / self._settings.fps).astype(np.float32),
            "frame_index": frames,
            "episode_index": np.repeat(np.array([one.index for one in episodes], dtype=np.int64), lengths),
            "index": np.arange(episodes[0].first, episodes[0].first + len(frames), dtype=np.int64),
            "task_index": np.repeat(np.array([one.task for one in episodes], dtype=np.int64), lengths),
        }

    def _statistics(self, columns: Mapping[str, NDArray[np.float32]]) -> JsonObject:
        """Return the statistics of all features over the whole dataset."""
        if not self.episodes:
            return {}
        found = {name: of_values(values) for name, values in columns.items()}
        for name in self._filmed:
            films = [one.facts["videos"][name] for one in self.episodes]
            count = sum(film["images"] for film in films)
            found[name] = of_images(added(film["levels"] for film in films), count)
        own = self._own_columns(self.episodes)
        index = own.pop("index").astype(np.int64)
        found |= {name: of_values(values[:, None]) for name, values in own.items()}
        found["index"] = of_runs(index[:1], index[-1:])
        return {
            name: {what: value.tolist() for what, value in one.items()} for name, one in sorted(found.items())
        }

    def _source(self, episode: Episode) -> JsonObject:
        """Return where an episode is from."""
        times = {name: episode.facts[name] for name in ("start_ns", "end_ns")}
        return {"recording": episode.member.part.key, "number": episode.number, **times}

    def _renumbered(self) -> dict[str, str]:
        """Return recording -> a clause, for those whose episodes have other numbers than in the dataset on disk."""
        spans = []
        for rows in (self._before.get("episodes", ()), [self._source(one) for one in self.episodes]):
            numbers: dict[str, list[int]] = {}
            for index, row in enumerate(rows):
                numbers.setdefault(row["recording"], []).append(index)
            spans.append({key: (those[0], those[-1]) for key, those in numbers.items()})
        before, now = spans
        return {
            key: "episodes {}..{} are {}..{} now".format(*before[key], *span)
            for key, span in now.items()
            if key in before and before[key] != span
        }


def _matrix(column: pa.ChunkedArray, width: int) -> NDArray[np.float32]:
    """Return a column of numbers, or of lists of equal length, as (N, D)."""
    flat = [chunk.flatten() if width > 1 else chunk for chunk in column.chunks]
    values = np.concatenate([one.to_numpy(zero_copy_only=False) for one in flat])
    return values.reshape(-1, width)
