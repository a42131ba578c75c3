"""The files in `meta/` of a LeRobot dataset, version 3.0."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.formats.lerobot.episode import Episode, File
from bagassets.formats.lerobot.settings import OWN_COLUMNS, LeRobot
from bagassets.formats.lerobot.statistics import STATISTICS, Statistics, of_images, of_runs

VERSION = "v3.0"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEOS = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
CHUNK_FILES = 1000


def write_table(path: Path, table: pa.Table) -> None:
    """Write a Parquet file, the same bytes for the same table."""
    pq.write_table(table, path, compression="zstd")


def info(
    settings: LeRobot,
    features: JsonMapping,
    robot: str | None,
    totals: tuple[int, int, int],
    splits: Mapping[str, str],
) -> JsonObject:
    """Return the content of `info.json`.

    Args:
        settings: the recipe's `lerobot`.
        features: feature -> type, shape and names.
        robot: type of the robot.
        totals: numbers of episodes, frames and tasks.
        splits: split -> its episodes, `first:after`.
    """
    own = {name: {"dtype": "int64", "shape": [1], "names": None} for name in OWN_COLUMNS}
    own["timestamp"] = own["timestamp"] | {"dtype": "float32"}
    described: JsonObject = {}
    for name, one in features.items():
        described[name] = one if one["dtype"] != "video" else {**one, "info": _video(settings, one)}
    return {
        "codebase_version": VERSION,
        "robot_type": robot,
        "total_episodes": totals[0],
        "total_frames": totals[1],
        "total_tasks": totals[2],
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": settings.fps,
        "splits": dict(splits),
        "data_path": DATA,
        "video_path": VIDEOS,
        "features": {**described, **own},
    }


def _video(settings: LeRobot, feature: JsonMapping) -> JsonObject:
    height, width, channels = feature["shape"]
    return {
        "video.height": height,
        "video.width": width,
        "video.codec": settings.video.codec,
        "video.pix_fmt": "yuv420p",
        "video.is_depth_map": False,
        "video.fps": settings.fps,
        "video.channels": channels,
        "has_audio": False,
    }


def tasks_table(tasks: Sequence[str]) -> pa.Table:
    """Return the content of `tasks.parquet`: readers find a row by its place, and its text in the index called `task`."""
    table = pa.table(
        {"task_index": pa.array(range(len(tasks)), pa.int64()), "task": pa.array(tasks, pa.string())}
    )
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
        for name, kind, numpy in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [
            {
                "name": None,
                "field_name": None,
                "pandas_type": "unicode",
                "numpy_type": "object",
                "metadata": {"encoding": "UTF-8"},
            }
        ],
        "columns": columns,
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.0.0",
    }
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


def episodes_table(
    episodes: Sequence[Episode],
    places: Mapping[str, Sequence[File]],
    features: JsonMapping,
    tasks: Sequence[str],
    fps: int,
) -> pa.Table:
    """Return the content of `episodes/`: a row for each episode.

    Args:
        episodes: all of them.
        places: `data`, or `videos/FEATURE` -> its files, each with its episodes.
        features: feature -> type, shape and names.
        tasks: texts, in the order of their numbers.
        fps: frames per second.
    """
    number = len(episodes)
    lengths = np.array([one.length for one in episodes], dtype=np.int64)
    first = np.array([one.first for one in episodes], dtype=np.int64)
    columns: dict[str, pa.Array] = {
        "episode_index": pa.array(np.arange(number, dtype=np.int64)),
        "tasks": pa.array([[tasks[one.task]] for one in episodes], pa.list_(pa.string())),
        "length": pa.array(lengths),
        "dataset_from_index": pa.array(first),
        "dataset_to_index": pa.array(first + lengths),
    }
    for name, files in places.items():
        where = np.array([file.place for file in files for _ in file.episodes], dtype=np.int64).reshape(-1, 2)
        columns[f"{name}/chunk_index"] = pa.array(where[:, 0])
        columns[f"{name}/file_index"] = pa.array(where[:, 1])
        if name == "data":
            continue
        # From whole numbers of frames: sums of floats drift.
        before = np.array([start for file in files for start in _starts(file)], dtype=np.int64)
        columns[f"{name}/from_timestamp"] = pa.array(before / fps)
        columns[f"{name}/to_timestamp"] = pa.array((before + lengths) / fps)
    for feature, one in sorted(features.items()):
        videos = one["dtype"] == "video"
        rows = [
            _of_film(episode.facts["videos"][feature]) if videos else episode.facts["statistics"][feature]
            for episode in episodes
        ]
        for what in STATISTICS:
            columns[f"stats/{feature}/{what}"] = pa.array([row[what] for row in rows])
    for feature, values in _own_statistics(episodes, lengths, first, fps).items():
        for what in STATISTICS:
            columns[f"stats/{feature}/{what}"] = pa.array([[value] for value in values[what].tolist()])
    zeros = pa.array(np.zeros(number, dtype=np.int64))
    return pa.table(columns | {"meta/episodes/chunk_index": zeros, "meta/episodes/file_index": zeros})


def _starts(file: File) -> list[int]:
    """Return the frame of a file at which each of its episodes begins."""
    starts, frames = [], 0
    for one in file.episodes:
        starts.append(frames)
        frames += one.length
    return starts


def _of_film(film: JsonMapping) -> JsonObject:
    found = of_images(np.asarray(film["levels"], dtype=np.int64), film["images"])
    return {name: value.tolist() for name, value in found.items()}


def _own_statistics(
    episodes: Sequence[Episode], lengths: NDArray[np.int64], first: NDArray[np.int64], fps: int
) -> dict[str, Statistics]:
    """Return the statistics of the columns that every dataset has, for all episodes at once."""
    index = np.arange(len(episodes), dtype=np.int64)
    frames = of_runs(np.zeros_like(lengths), lengths - 1)
    task = np.array([one.task for one in episodes], dtype=np.int64)
    constant = {"episode_index": index, "task_index": task}
    found = {name: of_runs(value, value) | {"count": lengths} for name, value in constant.items()}
    found["index"] = of_runs(first, first + lengths - 1)
    found["frame_index"] = frames
    found["timestamp"] = {name: value if name == "count" else value / fps for name, value in frames.items()}
    return {name: one | {"count": lengths} for name, one in found.items()}
