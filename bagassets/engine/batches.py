"""Batches: several small recordings that one run brings up to date.

A run with a step for each asset costs a small recording more than its work does. In a batch each recording is still
recorded as its own partition, and the failure of one is its own (see `defs.graph.several`).
"""

from collections.abc import Collection, Mapping, Sequence
from heapq import heapify, heapreplace

DATASET = ""
"""Stands for the datasets among partition keys."""

SMALL_BYTES = 256 * 2**20
_LARGEST_BATCH_BYTES = 2**30
# The same two where runs wait in a queue: there may be many processors.
_IN_QUEUE_BYTES = 64 * 2**20, 256 * 2**20
WORTH_STEPS_BYTES = 4 * 2**30
"""Up to here a recording does without a step for each asset, where the choice is free.

Dagster's bookkeeping for steps, and a second run for the datasets, take a second: a tenth of what 2 GB take on two
processors, and little beside a larger recording.
"""
_AT_ALL_BYTES = 2**20  # a recording costs as much as these, whatever its size
MOST_RECORDINGS = 50
"""Or about that, in one run: its log can still be read."""
# Each run looks for all recordings: of 10,000, for as long as it takes to record a dozen of them. So thousands make longer
# runs, not more.
_ENOUGH_RUNS, _MOST_OF_THOUSANDS = 40, 500
# Where there are fewer, a run each, with steps, shows more. A run costs as much as recording two or three small recordings,
# and its worker makes the maps of all lenses anew, which takes as long as a tenth of a recording of 240 MB.
_FEWEST, _FEWEST_PER_JOB = 4, 2

Batch = Mapping[str, Sequence[str]]
"""Partition key -> the assets to materialize; `DATASET` -> the datasets."""


def batches(todo: Batch, sizes: Mapping[str, int], jobs: int, most_per_run: int | None = None) -> list[Batch]:
    """Deal recordings to runs: each large one gets a run of its own, small ones share.

    Args:
        todo: recordings and their assets.
        sizes: partition key -> size in bytes.
        jobs: runs at the same time; small recordings that are fewer than four, or two for each, get runs of their own.
        most_per_run: most recordings of a run, where runs wait in a queue and nobody knows how many of them will be at work
            at the same time; `jobs` does not count then.

    Returns:
        The runs, the longest first: begun last, it would keep one worker busy after all others are done.
    """
    small_bytes, batch_bytes = SMALL_BYTES, _LARGEST_BATCH_BYTES
    if most_per_run is not None:
        (small_bytes, batch_bytes), jobs = _IN_QUEUE_BYTES, 1
    small = sorted((key for key in todo if sizes[key] <= small_bytes), key=lambda key: (-sizes[key], key))
    most = most_per_run or max(MOST_RECORDINGS, min(len(small) // _ENOUGH_RUNS, _MOST_OF_THOUSANDS))
    if most == 1 or not _are_many(small, jobs, most_per_run):
        small = []
    total = sum(sizes[key] for key in small)
    rounds = max(1, -(-total // (jobs * batch_bytes)), -(-len(small) // (jobs * most)))
    needed = jobs * rounds  # so that no job is left with one more than the others
    dealt: list[tuple[int, int, list[str]]] = [(0, number, []) for number in range(needed)] if small else []
    heapify(dealt)
    for key in small:  # the largest first, each to the batch that is smallest so far
        size, number, keys = dealt[0]
        keys.append(key)
        heapreplace(dealt, (size + sizes[key] + _AT_ALL_BYTES, number, keys))
    shared = frozenset(small)
    groups = [keys for _, _, keys in dealt] + [[key] for key in todo if key not in shared]
    groups.sort(key=lambda keys: (-sum(sizes[key] for key in keys), keys))
    return [{key: todo[key] for key in keys} for keys in groups]


def without_steps(sizes: Mapping[str, int], jobs: int, most_per_run: int | None = None) -> frozenset[str]:
    """Return the recordings that do without a step for each asset, even if they have a run of their own.

    Where there are many, nobody looks at the steps of one.

    Args:
        sizes: partition key -> size in bytes, of all that need a run.
        jobs: as for `batches`.
        most_per_run: likewise.
    """
    found = frozenset(key for key, size in sizes.items() if size <= WORTH_STEPS_BYTES)
    return found if _are_many(found, jobs, most_per_run) else frozenset()


def _are_many(keys: Collection[str], jobs: int, most_per_run: int | None) -> bool:
    return len(keys) >= max(_FEWEST, _FEWEST_PER_JOB * jobs if most_per_run is None else 0)
