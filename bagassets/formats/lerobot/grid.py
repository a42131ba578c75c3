"""The grid of times of an episode, and which of a feature's values each of its frames gets."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Stamps = NDArray[np.int64]
NS = 1_000_000_000


def grid_ns(start_ns: int, end_ns: int, fps: int) -> Stamps:
    """Return the times of an episode's frames, (N,): `start_ns` + i / fps, rounded to nanoseconds, up to `end_ns`."""
    number = max(0, (end_ns - start_ns) * fps // NS + 1)
    steps = np.arange(number, dtype=np.int64)
    return start_ns + (steps * NS + fps // 2) // fps


@dataclass(frozen=True)
class Picked:
    """The values that frames get of one source.

    Attributes:
        before: index of the value, or of the one before the frame if there is none or two are interpolated, (N,).
        after: index of the second value, (N,); the same as `before` if there is one only.
        weight: of the second value, (N,), in 0..1.
        has_value: False where no value is near enough, (N,).
    """

    before: NDArray[np.int64]
    after: NDArray[np.int64]
    weight: NDArray[np.float64]
    has_value: NDArray[np.bool_]

    @property
    def repeated(self) -> int:
        """Number of frames with the same value as the frame before."""
        same = (self.before[1:] == self.before[:-1]) & (self.weight[1:] == self.weight[:-1])
        return int(np.count_nonzero(same))

    def cut(self, frames: int) -> "Picked":
        """Return that of the first frames."""
        return Picked(*(one[:frames] for one in vars(self).values()))

    def held(self) -> "Picked":
        """Return it with the latest value before it for each frame that has none."""
        return Picked(self.before, self.before, np.where(self.has_value, self.weight, 0.0), self.before >= 0)


def pick(stamps_ns: Stamps, times_ns: Stamps, at: str, tolerance_ns: int) -> Picked:
    """Return which values frames get.

    Args:
        stamps_ns: stamps of the values, strictly increasing, (M,), at least one.
        times_ns: times of the frames, (N,).
        at: `latest`, `nearest`, `linear` or `hold`, see `lerobot.features` in the recipe.
        tolerance_ns: longest time between a frame and its value.
    """
    before = np.searchsorted(stamps_ns, times_ns, "right").astype(np.int64) - 1
    after = np.clip(np.searchsorted(stamps_ns, times_ns, "left"), None, len(stamps_ns) - 1).astype(np.int64)
    has_before, has_after = before >= 0, stamps_ns[after] >= times_ns
    age = times_ns - stamps_ns[np.maximum(before, 0)]
    ahead = stamps_ns[after] - times_ns
    none = np.zeros(len(times_ns))
    if at == "hold":
        return Picked(before, before, none, has_before)
    if at == "nearest":
        later = has_after & (~has_before | (ahead < age))
        near = np.where(later, ahead, age) <= tolerance_ns
        chosen = np.where(later & near, after, before)
        return Picked(chosen, chosen, none, near)
    if at == "linear":
        near = has_before & has_after & (age <= tolerance_ns) & (ahead <= tolerance_ns)
        span = np.maximum(age + ahead, 1)
        return Picked(before, after, np.where(near, age / span, 0.0), near)
    return Picked(before, before, none, has_before & (age <= tolerance_ns))


def values_at(values: NDArray[np.float64], picked: Picked) -> NDArray[np.float64]:
    """Return the values of frames, (N, D), of those of a source, (M, D); every frame has one."""
    low, high = values[picked.before], values[picked.after]
    # Step by step: no library decides whether to fuse them, and so how the last bit is rounded.
    weighted = (high - low) * picked.weight[:, None]
    return low + weighted
