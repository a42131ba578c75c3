"""Choosing keyframes, the readings that go with them, and the sample that each reading belongs to.

All stamps are int64 nanoseconds, sorted and distinct.
"""

import numpy as np
from numpy.typing import NDArray

Stamps = NDArray[np.int64]

__all__ = ["Stamps", "choose_keyframes", "match_readings", "nearest", "owning_keyframe"]


def choose_keyframes(readings_ns: Stamps, start_ns: int, end_ns: int, period_ns: int) -> NDArray[np.intp]:
    """Choose the readings of the reference channel that become keyframes.

    Targets lie on a grid: start, start + period, … Each takes the reading nearest to it among those
    less than half a period away and at least half a period after the keyframe before. A target
    without such a reading makes no keyframe: a gap costs the keyframes inside it and nothing else,
    and a reference that is slower than the grid gives all its readings.

    Args:
        readings_ns: (N,) stamps of the reference channel within the scene.
        start_ns: first target.
        end_ns: end of the scene, inclusive; no target lies after it.
        period_ns: time between targets, > 0.

    Returns:
        (K,) indices into `readings_ns`, strictly increasing.
    """
    half_ns = period_ns // 2
    chosen: list[int] = []
    number = max(0, (end_ns - start_ns) // period_ns + 1)
    targets = start_ns + period_ns * np.arange(number, dtype=np.int64)
    lows = np.searchsorted(readings_ns, targets - half_ns, side="left")
    highs = np.searchsorted(readings_ns, targets + half_ns, side="left")
    for target, low, high in zip(targets.tolist(), lows.tolist(), highs.tolist(), strict=True):
        first = low
        if chosen:
            earliest_ns = int(readings_ns[chosen[-1]]) + half_ns
            first = max(low, int(np.searchsorted(readings_ns, earliest_ns, side="left")), chosen[-1] + 1)
        if first < high:
            away = np.abs(readings_ns[first:high] - target)
            chosen.append(first + int(np.argmin(away)))
    return np.array(chosen, dtype=np.intp)


def match_readings(keyframes_ns: Stamps, readings_ns: Stamps, tolerance_ns: int) -> NDArray[np.intp]:
    """Give each keyframe the reading of a channel that is nearest in time.

    A reading that is nearest to several keyframes goes to the one it is nearest to.

    Args:
        keyframes_ns: (K,) stamps of the keyframes.
        readings_ns: (N,) stamps of the channel.
        tolerance_ns: a reading farther from its keyframe than this does not count.

    Returns:
        (K,) index of the reading of each keyframe, or -1 where the channel has none; no reading
        appears twice.
    """
    if not len(keyframes_ns) or not len(readings_ns):
        return np.full(len(keyframes_ns), -1, dtype=np.intp)
    reading = nearest(readings_ns, keyframes_ns)
    mutual = nearest(keyframes_ns, readings_ns[reading]) == np.arange(len(keyframes_ns))
    close = np.abs(readings_ns[reading] - keyframes_ns) <= tolerance_ns
    return np.where(mutual & close, reading, -1)


def owning_keyframe(keyframes_ns: Stamps, readings_ns: Stamps) -> NDArray[np.intp]:
    """Return the keyframe that each reading between keyframes belongs to.

    As in nuScenes it is the one that follows closest; after the last keyframe it is the last one.

    Args:
        keyframes_ns: (K,) stamps, K >= 1.
        readings_ns: (N,) stamps.

    Returns:
        (N,) indices of keyframes.
    """
    following = np.searchsorted(keyframes_ns, readings_ns, side="left")
    return np.minimum(following, len(keyframes_ns) - 1)


def nearest(stamps_ns: Stamps, times_ns: Stamps) -> NDArray[np.intp]:
    """Return for each of (M,) times the index of the nearest of (N,) stamps, N >= 1; ties go to the earlier."""
    right = np.clip(np.searchsorted(stamps_ns, times_ns, side="left"), 0, len(stamps_ns) - 1)
    left = np.maximum(right - 1, 0)
    return np.where(np.abs(times_ns - stamps_ns[left]) <= np.abs(stamps_ns[right] - times_ns), left, right)
