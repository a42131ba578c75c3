"""Where log times go back in the order in which a recording was written, as when a simulation is reset or a clock set back.

Messages are read in order of log time: what was recorded before and after it is mixed.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Queues and threads of recorders change the order of messages by less.
_LEAST_NS = 1_000_000_000
# So many messages of a topic among those that were written earlier are no slip of a recorder.
_LEAST_MIXED = 3
_MOST_CUTS = 100


@dataclass(frozen=True, slots=True)
class Rewind:
    """The first place in a recording where log times go back, and how many there are.

    Attributes:
        from_ns: log time of the message before it.
        to_ns: log time of the message after it.
        times: number of such places.
    """

    from_ns: int
    to_ns: int
    times: int


def join_in_order(files: Iterable[Mapping[str, NDArray[np.int64]]]) -> dict[str, NDArray[np.int64]]:
    """Return topic -> log times of files that were written one after the other."""
    joined: dict[str, list[NDArray[np.int64]]] = defaultdict(list)
    for times in files:
        for topic, some_ns in times.items():
            joined[topic].append(some_ns)
    return {topic: np.concatenate(some) for topic, some in joined.items()}


def find_rewind(times_ns: Mapping[str, NDArray[np.int64]]) -> Rewind | None:
    """Return where log times go back into a time that was recorded before.

    Topics that were written one after the other, or pieces of a drive in any order, are not mixed. Neither is a recording
    of which only some topics are, as if it was merged with another.

    Args:
        times_ns: topic -> (N,) log times, of all or of some of its messages, in the order in which they were written.
    """
    found = {topic: rewind for topic, times in times_ns.items() if (rewind := _of_topic(times)) is not None}
    mixed = sum(len(times_ns[topic]) for topic in found)
    if not mixed or 2 * mixed < sum(map(len, times_ns.values())):
        return None
    return found[max(found, key=lambda topic: len(times_ns[topic]))]


def _of_topic(times_ns: NDArray[np.int64]) -> Rewind | None:
    cuts = np.flatnonzero(np.diff(times_ns) < -_LEAST_NS)[:_MOST_CUTS] + 1
    pieces = np.split(times_ns, cuts)
    mixed = [
        cut
        for number, cut in enumerate(cuts.tolist(), 1)
        if any(
            np.count_nonzero((piece.min() <= pieces[number]) & (pieces[number] <= piece.max()))
            >= _LEAST_MIXED
            for piece in pieces[:number]
        )
    ]
    if not mixed:
        return None
    return Rewind(int(times_ns[mixed[0] - 1]), int(times_ns[mixed[0]]), len(mixed))
