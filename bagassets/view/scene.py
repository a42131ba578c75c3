"""One scene of a dataset on disk, read from its tables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import partial
from pathlib import Path

from bagassets.base.errors import DatasetError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.formats.nuscenes.table_file import read_table
from bagassets.formats.reader.nuscenes import pose_in, reading_in
from bagassets.formats.reader.source import Reading

Row = JsonMapping


@dataclass(frozen=True)
class DatasetScene:
    """A scene.

    Attributes:
        name: its name in the table.
        recording: `logfile` of its log: the partition key of the recording.
        origin: place of the global frame on Earth, as in the log table; None if unknown.
        samples: stamps of its samples, in order.
        readings: readings of all channels in order of time.
        boxes: stamp of a sample -> its rows of sample_annotation, with `category` and `attributes` by name.
    """

    name: str
    recording: str
    origin: JsonMapping | None
    samples: Sequence[int]
    readings: Sequence[Reading]
    boxes: Mapping[int, Sequence[Row]] = field(default_factory=dict)


def scene_names(dataroot: Path, version: str) -> list[str]:
    """Return the names of all scenes of a dataset, in its order.

    Raises:
        DatasetError: there is no such dataset.
    """
    return [row["name"] for row in _table(dataroot, version, "scene")]


def load_scene(dataroot: Path, version: str, name: str) -> DatasetScene:
    """Return a scene of a dataset.

    Args:
        dataroot: dataroot of the dataset.
        version: its version folder.
        name: name or token of the scene.

    Raises:
        DatasetError: there is no such dataset, or no such scene in it.
    """
    scene = _find(_table(dataroot, version, "scene"), name, dataroot / version)
    log = next(row for row in _table(dataroot, version, "log") if row["token"] == scene["log_token"])
    samples = {
        row["token"]: 1000 * row["timestamp"]
        for row in _table(dataroot, version, "sample")
        if row["scene_token"] == scene["token"]
    }
    return DatasetScene(
        name=scene["name"],
        recording=log["logfile"],
        origin=log.get("origin"),
        samples=sorted(samples.values()),
        readings=_readings(dataroot, version, samples),
        boxes=_boxes(dataroot, version, samples),
    )


def _table(dataroot: Path, version: str, name: str) -> list[JsonObject]:
    if not (dataroot / version).is_dir():
        raise DatasetError(f"{dataroot / version}: there is no dataset here; run `bagassets build` first.")
    return read_table(dataroot / version, name)


def _find(scenes: Sequence[Row], name: str, folder: Path) -> Row:
    matching = [row for row in scenes if name in (row["name"], row["token"])]
    if matching:
        return matching[0]
    names = [row["name"] for row in scenes]
    near = get_close_matches(name, names, n=3, cutoff=0.3) or names[:3]
    offer = f"did you mean {' or '.join(near)}?" if near else "the dataset has no scenes."
    raise DatasetError(f"{folder}: there is no scene {name}; {offer}")


def _readings(dataroot: Path, version: str, samples: Mapping[str, int]) -> list[Reading]:
    rows = [row for row in _table(dataroot, version, "sample_data") if row["sample_token"] in samples]
    wanted = {row["ego_pose_token"] for row in rows}
    poses = {row["token"]: row for row in _table(dataroot, version, "ego_pose") if row["token"] in wanted}
    calibrated = {row["token"]: row for row in _table(dataroot, version, "calibrated_sensor")}
    sensors = {row["token"]: row for row in _table(dataroot, version, "sensor")}
    readings = []
    for row in rows:
        mounted = calibrated[row["calibrated_sensor_token"]]
        find_pose = partial(pose_in, poses[row["ego_pose_token"]])
        readings.append(reading_in(row, mounted, sensors[mounted["sensor_token"]], dataroot, find_pose))
    return sorted(readings, key=lambda reading: (reading.stamp_ns, reading.channel))


def _boxes(dataroot: Path, version: str, samples: Mapping[str, int]) -> dict[int, list[Row]]:
    categories = {row["token"]: row["name"] for row in _table(dataroot, version, "category")}
    attributes = {row["token"]: row["name"] for row in _table(dataroot, version, "attribute")}
    instances = {row["token"]: row["category_token"] for row in _table(dataroot, version, "instance")}
    boxes: dict[int, list[Row]] = {stamp_ns: [] for stamp_ns in samples.values()}
    for row in _table(dataroot, version, "sample_annotation"):
        if row["sample_token"] in samples:
            named = {
                "category": categories[instances[row["instance_token"]]],
                "attributes": [attributes[token] for token in row["attribute_tokens"]],
            }
            boxes[samples[row["sample_token"]]].append({**row, **named})
    return boxes
