"""Choosing keyframes, the readings that go with them, and the sample that each reading belongs to.

All stamps are int64 nanoseconds, sorted and distinct.
"""

import numpy as np
from numpy.typing import NDArray

Stamps = NDArray[np.int64]


def choose_keyframes(
    readings_ns: Stamps, start_ns: int, end_ns: int, period_ns: int, partners: NDArray[np.intp] | None = None
) -> NDArray[np.intp]:
    """Choose the readings of the reference channel that become keyframes.

    Targets lie on a grid: start, start + period, … Each takes the nearest reading among those less
    than half a period away and at least half a period after the previous keyframe. A target without
    such a reading has no keyframe: a gap costs the keyframes inside it and no others, and of a
    reference that is slower than the grid all readings are keyframes.

    With `partners` only complete readings count: a keyframe moves to the nearest reading for which
    every channel has one, and is left out if there is no such reading.

    Args:
        readings_ns: (N,) stamps of the reference channel within the scene.
        start_ns: first target.
        end_ns: end of the scene, inclusive; no target lies after it.
        period_ns: time between targets, > 0.
        partners: (C, N) reading of each other channel that would go with each reading, or -1; no two
            keyframes share one.

    Returns:
        (T,) for each target the index into `readings_ns`, or -1; those >= 0 are strictly increasing.
    """
    half_ns = period_ns // 2
    number = max(0, (end_ns - start_ns) // period_ns + 1)
    targets = start_ns + period_ns * np.arange(number, dtype=np.int64)
    chosen = np.full(number, -1, dtype=np.intp)
    usable = np.arange(len(readings_ns), dtype=np.intp)
    if partners is not None:
        usable = np.flatnonzero((partners >= 0).all(axis=0))
        partners = partners[:, usable]
    stamps_ns = readings_ns[usable]
    lows = np.searchsorted(stamps_ns, targets - half_ns, side="left").tolist()
    highs = np.searchsorted(stamps_ns, targets + half_ns, side="left").tolist()
    last = -1
    for number, (target, low, high) in enumerate(zip(targets.tolist(), lows, highs, strict=True)):
        first = low
        if last >= 0:
            earliest_ns = int(stamps_ns[last]) + half_ns
            first = max(low, int(np.searchsorted(stamps_ns, earliest_ns, side="left")), last + 1)
        free = np.arange(first, high)
        if partners is not None and last >= 0:
            free = free[(partners[:, first:high] != partners[:, [last]]).all(axis=0)]
        if len(free):
            last = int(free[np.argmin(np.abs(stamps_ns[free] - target))])
            chosen[number] = usable[last]
    return chosen


def match_readings(keyframes_ns: Stamps, readings_ns: Stamps, tolerance_ns: int) -> NDArray[np.intp]:
    """Give each keyframe the reading of a channel that is nearest in time.

    A reading that is nearest to several keyframes goes to the closest of them, of equally close ones to the first.

    Args:
        keyframes_ns: (K,) stamps of the keyframes.
        readings_ns: (N,) stamps of the channel.
        tolerance_ns: readings farther than this from the keyframe do not count.

    Returns:
        (K,) index of the reading of each keyframe, or -1 if the channel has none; no reading
        appears twice.
    """
    matched = partner_readings(keyframes_ns, readings_ns, tolerance_ns)
    taken = np.flatnonzero(matched >= 0)
    away = np.abs(readings_ns[matched[taken]] - keyframes_ns[taken])
    # Keyframes that share a reading form a group, in which the nearest comes first and keeps it.
    order = taken[np.lexsort((taken, away, matched[taken]))]
    shared = np.zeros(len(order), dtype=np.bool_)
    shared[1:] = matched[order[1:]] == matched[order[:-1]]
    matched[order[shared]] = -1
    return matched


def partner_readings(stamps_ns: Stamps, readings_ns: Stamps, tolerance_ns: int) -> NDArray[np.intp]:
    """Return for each of (N,) stamps the nearest of (M,) readings, or -1 if it is farther than the tolerance.

    Several stamps may share a reading.
    """
    if not len(stamps_ns) or not len(readings_ns):
        return np.full(len(stamps_ns), -1, dtype=np.intp)
    reading = nearest(readings_ns, stamps_ns)
    return np.where(np.abs(readings_ns[reading] - stamps_ns) <= tolerance_ns, reading, -1)


def owning_keyframe(keyframes_ns: Stamps, readings_ns: Stamps) -> NDArray[np.intp]:
    """Return the keyframe to which each reading between keyframes belongs.

    As in nuScenes, that is the next keyframe; after the last keyframe it is the last one.

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
