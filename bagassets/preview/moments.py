"""Choosing the moments of a recording that pictures show."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bagassets.timeline.keyframes import nearest

__all__ = ["best_moment", "evenly_spaced", "reading_at"]

Stamps = NDArray[np.int64]


def evenly_spaced(first_ns: int, last_ns: int, number: int) -> list[int]:
    """Return moments in the middle of `number` equal parts of a span."""
    span_ns = last_ns - first_ns
    return [first_ns + span_ns * (2 * part + 1) // (2 * number) for part in range(number)]


def reading_at(stamps_ns: Stamps, moment_ns: int, tolerance_ns: int) -> int | None:
    """Return the index of the reading nearest to a moment, or None if it is too far."""
    if not len(stamps_ns):
        return None
    index = int(nearest(stamps_ns, np.array([moment_ns], dtype=np.int64))[0])
    return index if abs(int(stamps_ns[index]) - moment_ns) <= tolerance_ns else None


def best_moment(
    stamps_ns: Stamps, others_ns: Sequence[Stamps], future_ns: int, tolerance_ns: int
) -> int | None:
    """Return the index of the reading in single pictures.

    It is the one nearest to the middle of the recording that leaves `future_ns` (or half of the recording)
    ahead, among those that the most of the `others_ns` have a reading for.

    Args:
        stamps_ns: (N,) readings to choose from.
        others_ns: stamps of other channels that the picture should show.
        future_ns: duration of the future trajectory.
        tolerance_ns: largest time to a reading of another channel.
    """
    if not len(stamps_ns):
        return None
    accompanied = np.zeros(len(stamps_ns), dtype=np.int64)
    for other in others_ns:
        if len(other):
            accompanied += np.abs(other[nearest(other, stamps_ns)] - stamps_ns) <= tolerance_ns
    candidates = np.flatnonzero(accompanied == accompanied.max())
    first, last = int(stamps_ns[0]), int(stamps_ns[-1])
    wanted = min((first + last) // 2, max(last - future_ns, first + (last - first) // 4))
    return int(candidates[np.argmin(np.abs(stamps_ns[candidates] - wanted))])
