"""Datasets in the nuScenes format, ours and others."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple

from bagassets.base.errors import DatasetError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.formats.nuscenes.schema import SPLITS, TABLES
from bagassets.formats.reader.boxes import Box
from bagassets.formats.reader.source import Reading, SceneRow
from bagassets.formats.reader.table_folder import TableFolder
from bagassets.geometry.se3 import SE3

_OPTIONAL = {"map"}  # not read here


class _History(NamedTuple):
    """All readings of a channel, and their ego poses, by token."""

    rows: Mapping[str, JsonObject]
    poses: Mapping[str, JsonObject]


class NuScenesSource:
    """The content of a nuScenes dataset: keyframes and their boxes, and what was read between them.

    Attributes:
        folder: the version folder.
        root: the dataroot.

    Raises:
        DatasetError: a table is missing.
    """

    def __init__(self, folder: TableFolder) -> None:
        self.folder = folder
        self.root = folder.path.parent
        self._kept: dict[str, Mapping[str, JsonObject]] = {}
        self._histories: dict[str, _History] = {}
        missing = [name for name in TABLES if f"{name}.json" not in folder.names and name not in _OPTIONAL]
        if missing:
            raise folder.missing(folder.path / f"{missing[0]}.json")

    def sample(self, index: int) -> tuple[str, int]:
        """Return token and time (ns) of a sample; they are numbered scene by scene."""
        return self._order[0][index]

    @cached_property
    def scenes(self) -> Sequence[SceneRow]:
        """All scenes, in the order of the table."""
        return self._order[1]

    @cached_property
    def modalities(self) -> Mapping[str, str]:
        """Channel -> modality."""
        return {row["channel"]: row["modality"] for row in self._by_token("sensor").values()}

    @cached_property
    def splits(self) -> Mapping[str, Sequence[str]]:
        """Split -> names of its scenes; empty if the dataset does not say."""
        return self.folder.read(SPLITS) if SPLITS in self.folder.names else {}

    def readings(self, index: int) -> Mapping[str, Reading]:
        """Return channel -> keyframe of a sample."""
        readings = map(self._reading, self._data.get(self.sample(index)[0], ()))
        return {reading.channel: reading for reading in readings}

    def before(self, index: int, channel: str, number: int) -> Sequence[Reading]:
        """Return at most `number` readings of a channel before that of a sample, newest first: what `prev` links to."""
        rows = self._data.get(self.sample(index)[0], ())
        row = next((row for row in rows if self._sensor(self._mounting(row))["channel"] == channel), None)
        found: list[Reading] = []
        while row is not None and row["prev"] and len(found) < number:
            history = self._history(channel)
            row = self._lookup(history.rows, "sample_data", row["prev"])
            found.append(self._reading(row, history.poses))
        return found

    def boxes(self, index: int) -> Sequence[Box]:
        """Return the boxes of a sample in the global frame."""
        return [self._box(row) for row in self._annotations.get(self.sample(index)[0], ())]

    def _reading(self, row: JsonObject, poses: Mapping[str, JsonObject] | None = None) -> Reading:
        """Return a reading; `poses` are those to look its own up in, by default those of keyframes."""
        mounted = self._mounting(row)
        find_pose = partial(self._pose, row["ego_pose_token"], poses)
        return reading_in(row, mounted, self._sensor(mounted), self.root, find_pose)

    def _mounting(self, row: JsonObject) -> JsonObject:
        return self._row("calibrated_sensor", row["calibrated_sensor_token"])

    def _sensor(self, mounted: JsonObject) -> JsonObject:
        return self._row("sensor", mounted["sensor_token"])

    def _pose(self, token: str, poses: Mapping[str, JsonObject] | None) -> SE3:
        return pose_in(self._lookup(self._poses if poses is None else poses, "ego_pose", token))

    def _box(self, row: JsonObject) -> Box:
        instance = self._row("instance", row["instance_token"])
        visibility = row["visibility_token"]
        width, length, height = row["size"]
        return Box(
            token=row["token"],
            instance=row["instance_token"],
            category=self._row("category", instance["category_token"])["name"],
            attributes=tuple(self._row("attribute", token)["name"] for token in row["attribute_tokens"]),
            visibility=self._row("visibility", visibility)["level"] if visibility else "",
            pose=pose_in(row),
            size_m=(width, length, height),
            num_lidar_pts=row["num_lidar_pts"],
            num_radar_pts=row["num_radar_pts"],
        )

    # --- tables, read when they are first needed ---------------------------------------------

    @cached_property
    def _order(self) -> tuple[list[tuple[str, int]], list[SceneRow]]:
        by_scene: dict[str, list[tuple[int, str]]] = defaultdict(list)
        for row in self.folder.rows("sample.json"):
            by_scene[row["scene_token"]].append((1000 * row["timestamp"], row["token"]))
        samples: list[tuple[str, int]] = []
        scenes = []
        for row in self.folder.rows("scene.json"):
            own = sorted(by_scene[row["token"]])
            numbers = range(len(samples), len(samples) + len(own))
            scenes.append(SceneRow(row["name"], row["description"], numbers))
            samples += [(token, stamp_ns) for stamp_ns, token in own]
        return samples, scenes

    @cached_property
    def _data(self) -> Mapping[str, Sequence[JsonObject]]:
        """Sample -> rows of its keyframes."""
        return _by_sample(row for row in self.folder.rows("sample_data.json") if row["is_key_frame"])

    @cached_property
    def _annotations(self) -> Mapping[str, Sequence[JsonObject]]:
        """Sample -> rows of its annotations."""
        return _by_sample(self.folder.rows("sample_annotation.json"))

    @cached_property
    def _poses(self) -> Mapping[str, JsonObject]:
        """Token -> ego pose, of keyframes only: sweeps have many more."""
        return self._poses_of(row for rows in self._data.values() for row in rows)

    def _poses_of(self, readings: Iterable[JsonObject]) -> Mapping[str, JsonObject]:
        wanted = {row["ego_pose_token"] for row in readings}
        return {row["token"]: row for row in self.folder.rows("ego_pose.json") if row["token"] in wanted}

    def _history(self, channel: str) -> _History:
        """Return all readings of a channel; others are not kept, since a lidar alone has ten times its keyframes."""
        if channel not in self._histories:
            every = self._by_token("calibrated_sensor")
            mounted = {token for token, row in every.items() if self._sensor(row)["channel"] == channel}
            rows = {
                row["token"]: row
                for row in self.folder.rows("sample_data.json")
                if row["calibrated_sensor_token"] in mounted
            }
            self._histories[channel] = _History(rows, self._poses_of(rows.values()))
        return self._histories[channel]

    def _by_token(self, table: str) -> Mapping[str, JsonObject]:
        """Return token -> row of a table, which is kept."""
        if table not in self._kept:
            self._kept[table] = {row["token"]: row for row in self.folder.rows(f"{table}.json")}
        return self._kept[table]

    def _row(self, table: str, token: str) -> JsonObject:
        try:
            return self._kept[table][token]  # this is asked for every box, several times
        except KeyError:
            return self._lookup(self._by_token(table), table, token)

    def _lookup(self, rows: Mapping[str, JsonObject], table: str, token: str) -> JsonObject:
        try:
            return rows[token]
        except KeyError:
            raise DatasetError(
                f"{self.folder.path / table}.json: there is no row {token}, which another table names; {self.folder.remedy()}"
            ) from None


def pose_in(row: JsonMapping) -> SE3:
    """Return the pose in a row of a table."""
    return SE3.create(row["rotation"], row["translation"])


def reading_in(
    row: JsonMapping, mounted: JsonMapping, sensor: JsonMapping, root: Path, find_pose: Callable[[], SE3]
) -> Reading:
    """Return the reading in a row of sample_data, given the rows of its sensor and the dataroot."""
    return Reading(
        channel=sensor["channel"],
        modality=sensor["modality"],
        stamp_ns=1000 * row["timestamp"],
        path=root / row["filename"],
        size_px=(row["width"] or 0, row["height"] or 0),
        ego_SE3_sensor=pose_in(mounted),
        intrinsics=mounted["camera_intrinsic"] or None,
        find_pose=find_pose,
    )


def _by_sample(rows: Iterable[JsonObject]) -> Mapping[str, Sequence[JsonObject]]:
    found: dict[str, list[JsonObject]] = {}
    for row in rows:
        found.setdefault(row["sample_token"], []).append(row)
    return found
