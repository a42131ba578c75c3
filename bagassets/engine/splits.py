"""Splits: which part of a dataset each recording belongs to, a function of the set of recordings alone."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil, floor

from blake3 import blake3

from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.recipe.model_splits import Splits
from bagassets.store.canonical import canonical_json

_POSITIONS = 2**64
# Chance decides as long as no boundary between splits is off by more than this share of the recordings.
_LEEWAY = Fraction(1, 20)
# Shares that differ more than this from the recipe are reported.
_FAR = 0.1


@dataclass(frozen=True)
class Ties:
    """What ties recordings to a split besides their keys.

    Attributes:
        near: recording -> group; those of one group lie in one split.
        former: recording -> keys that its parts had, whose pins hold for it.
    """

    near: Mapping[str, str] = field(default_factory=dict)
    former: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def pinned(self, key: str, splits: Splits) -> str | None:
        """Return the split that the recipe gives a recording, if it does."""
        names = (key, *self.former.get(key, ()))
        return next((splits.pinned[name] for name in names if name in splits.pinned), None)

    def disputed(self, splits: Splits) -> dict[str, str]:
        """Return series -> a sentence, for those whose parts the recipe gives to several splits, and not the series itself."""
        found = {}
        for key, parts in self.former.items():
            pins = {part: splits.pinned[part] for part in parts if part in splits.pinned}
            if key not in splits.pinned and len(set(pins.values())) > 1:
                given = ", ".join(f"{part} to {split}" for part, split in pins.items())
                found[key] = (
                    f"{key}: splits.pinned gives its parts to several splits ({given}), but they are one recording now. Pin {key}; until "
                    f"then it is in {self.pinned(key, splits)}."
                )
        return found

    def of(self, keys: AbstractSet[str]) -> JsonObject:
        """Return what is about some recordings as JSON; empty for most."""
        near = {key: group for key, group in self.near.items() if key in keys}
        former = {key: list(names) for key, names in self.former.items() if key in keys}
        return {name: value for name, value in (("near", near), ("former", former)) if value}


def deal(keys: Iterable[str], splits: Splits, ties: Ties | None = None) -> dict[str, str]:
    """Return the split of each recording of a dataset.

    The recipe determines the split of a pinned recording. Every other one gets a position by a hash of seed and key,
    and the shares are laid end to end, in order of their names, over positions. With many recordings that is all: no
    recording influences another. With few, chance would leave splits empty or far too large; so each boundary is
    shifted along the row of recordings until no more than 5 % of all recordings (a quarter of the smallest share, if
    that is less) are on the wrong side of it, and each split with a share has a recording as long as there are enough.

    Adding or removing one recording moves each boundary past at most one other: with n splits, at most n - 1
    recordings change theirs, once there are as many recordings as splits.

    Args:
        keys: partition keys of the recordings, in any order.
        splits: the recipe's `splits`.
        ties: recordings that go together count as one; a pin of one of them holds for those that have none.
    """
    ties = ties or Ties()
    groups: dict[tuple[str, bool], list[str]] = {}
    for key in sorted(frozenset(keys)):
        groups.setdefault((ties.near.get(key, key), key in ties.near), []).append(key)
    dealt: dict[str, str] = {}
    ranked = []
    for group in groups.values():
        pins = {key: pin for key in group if (pin := ties.pinned(key, splits)) is not None}
        if pins:
            dealt |= {key: pins.get(key, next(iter(pins.values()))) for key in group}
        else:
            digest = blake3(canonical_json([splits.seed, group[0]])).digest(length=8)
            ranked.append((int.from_bytes(digest, "big"), group))
    ranked.sort()
    names = sorted(name for name, share in splits.shares.items() if share > 0)
    pinned = Counter(dealt.values())
    cuts = _cuts(
        [position for position, _ in ranked],
        [Fraction(repr(splits.shares[name])) for name in names],
        [pinned[name] for name in names],
    )
    for name, first, last in zip(names, cuts[:-1], cuts[1:], strict=True):
        dealt |= {key: name for _, group in ranked[first:last] for key in group}
    return dict(sorted(dealt.items()))


def _cuts(positions: Sequence[int], shares: Sequence[Fraction], pinned: Sequence[int]) -> list[int]:
    """Return where each split begins in the row of recordings, and where the last one ends.

    Args:
        positions: positions of the recordings that are not pinned, ascending.
        shares: shares of the splits, each > 0.
        pinned: number of pinned recordings in each split.
    """
    number = len(positions)
    total, leeway = number + sum(pinned), min(_LEEWAY, min(shares) / (4 * sum(shares)))
    cuts, bound, before = [0], Fraction(0), 0
    for share, has in zip(shares[:-1], pinned[:-1], strict=True):
        bound += share / sum(shares)
        before += has
        by_chance = bisect_left(positions, ceil(bound * _POSITIONS))
        least = floor(total * (bound - leeway) + Fraction(1, 2)) - before
        most = ceil(total * (bound + leeway) - Fraction(1, 2)) - before
        cuts.append(min(max(by_chance, least, 0), max(most, 0), number))
    cuts.append(number)
    needed = [int(not has) for has in pinned]
    if sum(needed) > number:
        needed = [0] * len(needed)
    for split in range(1, len(cuts) - 1):
        cuts[split] = max(cuts[split], cuts[split - 1] + needed[split - 1])
    for split in range(len(cuts) - 2, 0, -1):
        cuts[split] = min(cuts[split], cuts[split + 1] - needed[split])
    return cuts


def moves(before: Mapping[str, str], after: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return recording -> its old and its new split, for those in both that changed their split."""
    return {
        key: (split, after[key])
        for key, split in sorted(before.items())
        if key in after and after[key] != split
    }


@dataclass(frozen=True)
class SplitShare:
    """The share of a split, beside its share in the recipe.

    Attributes:
        name: the split.
        asked: its share in the recipe.
        recordings: number of its recordings.
        duration_s: their total duration.
        share: its part of the duration of all recordings; 0 if that is 0.
    """

    name: str
    asked: float
    recordings: int
    duration_s: float
    share: float

    @property
    def deviation(self) -> float:
        """Difference between its share and that in the recipe."""
        return self.share - self.asked

    @property
    def is_far(self) -> bool:
        """True if it is empty in spite of its share in the recipe, or its share is far from that."""
        return abs(self.deviation) > _FAR or (self.asked > 0 and not self.recordings)

    def as_json(self) -> JsonObject:
        """Return the numbers, rounded for people."""
        return {
            "asked": self.asked,
            "recordings": self.recordings,
            "duration_s": round(self.duration_s, 3),
            "share": round(self.share, 4),
            "deviation": round(self.deviation, 4),
        }

    @classmethod
    def from_json(cls, name: str, value: JsonMapping) -> "SplitShare":
        """Inverse of `as_json`, with rounded numbers."""
        return cls(name, value["asked"], value["recordings"], value["duration_s"], value["share"])


def shares_of(
    durations_s: Iterable[tuple[str, float]], splits: Splits, dealt: Mapping[str, str]
) -> list[SplitShare]:
    """Return the share of each split of the recipe, sorted by name.

    Args:
        durations_s: key and duration of each recording.
        splits: the recipe's `splits`.
        dealt: recording -> split, from `deal`; other recordings do not count.
    """
    numbers = dict.fromkeys(splits.shares, 0)
    seconds = dict.fromkeys(splits.shares, 0.0)
    for key, duration_s in durations_s:
        if key in dealt:
            numbers[dealt[key]] += 1
            seconds[dealt[key]] += duration_s
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
