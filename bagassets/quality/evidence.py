"""What rules about one recording look at: its artifacts, each read when a rule asks for it."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bagassets.annotations.table import BoxTable
from bagassets.bags.inventory import Inventory
from bagassets.geometry.se3 import SE3
from bagassets.geometry.trajectory import Trajectory
from bagassets.nuscenes.lidar_file import read_lidar_file
from bagassets.nuscenes.schema import RECORDING_TABLES
from bagassets.quality.sweep_rules import Sweeps
from bagassets.recipe.model import LidarChannel, Recipe, Rig
from bagassets.recipe.model_base import Clock
from bagassets.recipe.model_checks import Checks
from bagassets.steps.ego_poses import load_trajectory
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store
from bagassets.timeline.keyframes import Stamps

__all__ = ["Evidence"]


class Evidence:
    """The artifacts of one recording, and what the recipe expects of them.

    Args:
        recipe: clock, limits, and the thresholds of checks.
        rig: the rig that made the recording.
        store: where artifacts are.
        current: asset -> its current artifact for this recording.
    """

    def __init__(self, recipe: Recipe, rig: Rig, store: Store, current: Callable[[str], Artifact]) -> None:
        self.recipe = recipe
        self.rig = rig
        self.store = store
        self._current = current

    @property
    def checks(self) -> Checks:
        """Thresholds."""
        return self.recipe.checks

    @property
    def max_lost(self) -> float:
        """Share of a channel's messages whose loss is no finding."""
        own = self.checks.channels_present.max_lost
        return self.recipe.limits.reported_losses if own is None else own

    def clock_of(self, channel: str) -> Clock:
        """Return which time of a channel's messages counts."""
        own = self.rig.channels.get(channel)
        return self.recipe.clock if own is None else self.recipe.clock_of(own)

    @cached_property
    def inventory(self) -> Inventory:
        """What is in the recording."""
        return Inventory.from_json(self._current("inventory").read_json("inventory.json"))

    @cached_property
    def calibration(self) -> dict[str, Any]:
        """Content of `calibration.json`."""
        content: dict[str, Any] = self._current("calibration").read_json("calibration.json")
        return content

    @cached_property
    def trajectory(self) -> Trajectory:
        """`global_SE3_ego`."""
        return load_trajectory(self._current("ego_poses"))

    @cached_property
    def boxes(self) -> tuple[dict[str, Any], BoxTable]:
        """Counts per source of boxes, and the boxes."""
        artifact = self._current("annotations")
        counts: dict[str, Any] = artifact.read_json("annotations.json")["counts"]
        return counts, BoxTable.from_arrow(artifact.read_table("annotations.parquet"))

    @cached_property
    def tables(self) -> dict[str, list[dict[str, Any]]]:
        """The recording's rows of the nuScenes tables."""
        artifact = self._current("nuscenes_tables")
        return {name: artifact.read_json(f"{name}.json") for name in RECORDING_TABLES}

    @cached_property
    def table_facts(self) -> dict[str, Any]:
        """Content of `facts.json` beside the tables."""
        facts: dict[str, Any] = self._current("nuscenes_tables").read_json("facts.json")
        return facts

    @cached_property
    def files(self) -> list[dict[str, str]]:
        """Content of `files.json`."""
        files: list[dict[str, str]] = self._current("nuscenes_tables").read_json("files.json")
        return files

    def channels(self, asset: str) -> dict[str, Any]:
        """Return the content of `channels.json` of `frames` or `sweeps`."""
        channels: dict[str, Any] = self._current(asset).read_json("channels.json")
        return channels

    def stamps_ns(self) -> dict[str, Stamps]:
        """Return channel -> stamps of its readings, over frames and sweeps."""
        entries = [item for asset in ("frames", "sweeps") for item in sorted(self.channels(asset).items())]
        return {name: self._stamps_ns(entry["artifact"]) for name, entry in entries}

    def stamps_of(self, channel: str) -> Stamps:
        """Return the stamps of a channel's readings."""
        entries = self.channels("frames") | self.channels("sweeps")
        return self._stamps_ns(entries[channel]["artifact"])

    def _stamps_ns(self, digest: str) -> Stamps:
        index = self.store.artifact(digest).read_table("index.parquet", ["stamp_ns"])
        stamps_ns: Stamps = index.column("stamp_ns").to_numpy().astype(np.int64)
        return stamps_ns

    def sweeps(self) -> dict[str, Sweeps]:
        """Return lidar -> its sweeps."""
        sweeps = {}
        for name, entry in sorted(self.channels("sweeps").items()):
            if isinstance(self.rig.channels.get(name), LidarChannel):
                pose = self.calibration["channels"][name]["ego_SE3_sensor"]
                ego_SE3_sensor = SE3.create(pose["rotation"], pose["translation"])
                sweeps[name] = _sweeps(self.store.artifact(entry["artifact"]), ego_SE3_sensor)
        return sweeps


def _sweeps(artifact: Artifact, ego_SE3_sensor: SE3) -> Sweeps:
    index = artifact.read_table("index.parquet", ["stamp_ns", "start_ns", "end_ns", "file"])
    files = index.column("file")
    times = [index.column(name).to_numpy().astype(np.int64) for name in ("stamp_ns", "start_ns", "end_ns")]

    def points(number: int) -> NDArray[np.float32] | None:
        try:
            return read_lidar_file(artifact.path(files[number].as_py()))
        except (OSError, ValueError):
            return None  # the check of files says what is wrong with it

    return Sweeps(times[0], np.stack(times[1:], axis=1), points, ego_SE3_sensor)
