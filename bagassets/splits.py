"""Splits: which part of a dataset a recording belongs to, decided by a hash and never revised."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from blake3 import blake3

from bagassets.recipe.model_splits import Splits
from bagassets.store.canonical import canonical_json

__all__ = ["SplitShare", "shares_of", "split_of"]


def split_of(key: str, splits: Splits) -> str:
    """Return the split of a recording.

    A pinned recording is where the recipe says. Else a hash of seed and key is held against the
    shares, laid end to end in order of their names: other recordings have no say, so adding one
    never moves another.

    Args:
        key: partition key of the recording.
        splits: the recipe's `splits`.
    """
    if key in splits.pinned:
        return splits.pinned[key]
    digest = blake3(canonical_json([splits.seed, key])).digest(length=8)
    position = int.from_bytes(digest, "big") / 2.0**64
    bound = 0.0
    names = sorted(name for name, share in splits.shares.items() if share > 0)
    for name in names[:-1]:
        bound += splits.shares[name]
        if position < bound:
            return name
    return names[-1]


@dataclass(frozen=True)
class SplitShare:
    """What a split got, against what the recipe asks for.

    Attributes:
        name: the split.
        asked: its share in the recipe.
        recordings: how many it has.
        duration_s: their time together.
        share: its part of the time of all recordings; 0 if they have none.
    """

    name: str
    asked: float
    recordings: int
    duration_s: float
    share: float

    @property
    def deviation(self) -> float:
        """Share of the time that it has beyond (or short of) what the recipe asks for."""
        return self.share - self.asked

    def as_json(self) -> dict[str, Any]:
        """Return the numbers, rounded for people."""
        return {
            "asked": self.asked,
            "recordings": self.recordings,
            "duration_s": round(self.duration_s, 3),
            "share": round(self.share, 4),
            "deviation": round(self.deviation, 4),
        }


def shares_of(durations_s: Iterable[tuple[str, float]], splits: Splits) -> list[SplitShare]:
    """Return what each split of the recipe got, sorted by name.

    Args:
        durations_s: key and duration of each recording.
        splits: the recipe's `splits`.
    """
    numbers = dict.fromkeys(splits.shares, 0)
    seconds = dict.fromkeys(splits.shares, 0.0)
    for key, duration_s in durations_s:
        name = split_of(key, splits)
        numbers[name] += 1
        seconds[name] += duration_s
    total = sum(seconds[name] for name in sorted(seconds))
    return [
        SplitShare(
            name,
            splits.shares[name],
            numbers[name],
            seconds[name],
            seconds[name] / total if total > 0 else 0.0,
        )
        for name in sorted(splits.shares)
    ]
