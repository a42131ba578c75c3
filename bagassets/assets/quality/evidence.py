"""The evidence that the rules of checks get."""

from collections.abc import Callable
from functools import cache, partial
from typing import TypeVar, cast

import numpy as np

from bagassets.assets.contents import Contents
from bagassets.assets.frames import FRAMES
from bagassets.assets.sweeps import SWEEPS
from bagassets.assets.timeline.keyframes import Stamps
from bagassets.base.columns import numbers
from bagassets.base.json_types import JsonObject
from bagassets.recipe.model import Recipe, Rig
from bagassets.recipe.model_base import Clock
from bagassets.recipe.model_checks import Checks
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store

T = TypeVar("T")


class Evidence(Contents):
    """The artifacts of one recording, read when a rule asks for them, and the recipe.

    Args:
        recipe: clock, limits, and the thresholds of checks.
        rig: the rig that made the recording.
        store: has the artifacts.
        current: asset -> current artifact of this recording.
    """

    recipe: Recipe
    rig: Rig
    store: Store

    def __init__(self, recipe: Recipe, rig: Rig, store: Store, current: Callable[[str], Artifact]) -> None:
        self.recipe = recipe
        self.rig = rig
        self.store = store
        self._current = cache(current)
        self._stamps_ns = cache(partial(_read_stamps_ns, store))  # no cycle with it, in which it would stay
        self._read: dict[Callable[[Evidence], object], object] = {}

    def artifact(self, asset: str) -> Artifact:
        """Return the current artifact of an asset."""
        return self._current(asset)

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
        """Return the clock of a channel or signal; of any other name, that of the rig."""
        return self.recipe.clock_of(self.rig, self.rig.channels.get(channel) or self.rig.signals.get(channel))

    def channels(self, asset: str) -> JsonObject:
        """Return the content of `channels.json` of an asset of channels."""
        channels: JsonObject = self.artifact(asset).read_json("channels.json")
        return channels

    def parts(self, asset: str) -> dict[str, Artifact]:
        """Return channel -> its artifact, of an asset of channels."""
        return {name: self.store.artifact(entry["artifact"]) for name, entry in self.channels(asset).items()}

    def stamps_ns(self) -> dict[str, Stamps]:
        """Return channel -> stamps of its readings, over frames and sweeps."""
        entries = [item for asset in (FRAMES, SWEEPS) for item in sorted(self.channels(asset.name).items())]
        return {name: self._stamps_ns(entry["artifact"]) for name, entry in entries}

    def stamps_of(self, channel: str) -> Stamps:
        """Return the stamps of a channel's readings."""
        entries = self.channels(FRAMES.name) | self.channels(SWEEPS.name)
        return self._stamps_ns(entries[channel]["artifact"])


def _read_stamps_ns(store: Store, digest: str) -> Stamps:
    index = store.artifact(digest).read_table("index.parquet", ["stamp_ns"])
    stamps_ns: Stamps = numbers(index.column("stamp_ns")).astype(np.int64)
    return stamps_ns
