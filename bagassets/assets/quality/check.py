"""Checks of recordings' assets, and the evidence that their rules get.

A rule is a function of the content of artifacts. An asset lists its own checks (`bagassets.assets.asset.Asset.checks`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar, cast

import numpy as np

from bagassets.assets.quality.finding import Finding
from bagassets.assets.timeline.keyframes import Stamps
from bagassets.base.json_types import JsonObject
from bagassets.geometry.calibration import Calibration
from bagassets.recipe.model import Recipe, Rig
from bagassets.recipe.model_base import Clock
from bagassets.recipe.model_checks import Checks, Severity
from bagassets.recordings.inventory import Inventory
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store

__all__ = ["Evidence", "RecordingCheck", "severity_of"]

T = TypeVar("T")


class Evidence:
    """The artifacts of one recording, read when a rule asks for them, and the recipe.

    Args:
        recipe: clock, limits, and the thresholds of checks.
        rig: the rig that made the recording.
        store: has the artifacts.
        current: asset -> current artifact of this recording.
    """

    def __init__(self, recipe: Recipe, rig: Rig, store: Store, current: Callable[[str], Artifact]) -> None:
        self.recipe = recipe
        self.rig = rig
        self.store = store
        self.artifact = current
        self._read: dict[Callable[[Evidence], object], object] = {}

    def once(self, read: "Callable[[Evidence], T]") -> T:
        """Return `read(self)`, called only once however many rules ask for it."""
        if read not in self._read:
            self._read[read] = read(self)
        return cast("T", self._read[read])

    @property
    def checks(self) -> Checks:
        """Thresholds."""
        return self.recipe.checks

    @property
    def max_lost(self) -> float:
        """Share of a channel's messages that may be lost."""
        own = self.checks.channels_present.max_lost
        return self.recipe.limits.reported_losses if own is None else own

    def clock_of(self, channel: str) -> Clock:
        """Return the clock of a channel."""
        return self.recipe.clock_of(self.rig, self.rig.channels.get(channel))

    @cached_property
    def inventory(self) -> Inventory:
        """The inventory of the recording."""
        return Inventory.from_json(self.artifact("inventory").read_json("inventory.json"))

    @cached_property
    def calibration(self) -> Calibration:
        """Content of `calibration.json`."""
        return Calibration.from_json(self.artifact("calibration").read_json("calibration.json"))

    def channels(self, asset: str) -> JsonObject:
        """Return the content of `channels.json` of `frames` or `sweeps`."""
        channels: JsonObject = self.artifact(asset).read_json("channels.json")
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


@dataclass(frozen=True)
class RecordingCheck:
    """A check of an asset of each recording.

    Attributes:
        name: unique name, shown in Dagster.
        section: field of `checks` in the recipe with its severity and thresholds.
        description: what is true if it passes.
        fails_if: when it fails, in Markdown, for docs/checks.md.
        rule: evidence -> finding.
        quick: it reads counts, and stamps only if there is a finding. It takes a moment for thousands of recordings, so
            every build reports its findings.
    """

    name: str
    section: str
    description: str
    fails_if: str
    rule: Callable[[Evidence], Finding]
    quick: bool = False


def severity_of(checks: Checks, section: str) -> Severity:
    """Return the severity of a section's findings; `skip` if checks are disabled."""
    severity: Severity = getattr(checks, section).severity if checks.enabled else "skip"
    return severity
