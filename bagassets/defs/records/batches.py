"""Which recordings a run is about: one, those of a batch, or of a backfill's range.

A batch has its recordings in the config of its job. The range of a backfill is in tags: its first and its last partition, in
the order in which they were registered; Dagster makes it of exactly those that were asked for.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import dagster as dg

from bagassets.defs.records.naming import BATCH_JOB, BATCH_OP, Naming
from bagassets.engine.batches import Batch

PARTITION_TAG = "dagster/partition"
"""Tag of a run about one partition."""
_RANGE_TAGS = "dagster/asset_partition_range_start", "dagster/asset_partition_range_end"


def batch_config(batch: Batch, names: Naming) -> dict[str, Any]:
    """Return the run config of the job of batches."""
    recordings = {key: list(assets) for key, assets in batch.items()}
    return {"ops": {names.batch_op: {"config": {"recordings": recordings}}}}


def batch_of(run: dg.DagsterRun, names: Naming | None = None) -> tuple[str, ...]:
    """Return the partition keys of a run's batch; nothing if it is no such run of the project, or of any project."""
    if not run.job_name.endswith(BATCH_JOB) or (names is not None and run.job_name != names.batch_job):
        return ()
    try:
        run_config: Any = run.run_config
        operation = run.job_name.removesuffix(BATCH_JOB) + BATCH_OP
        return tuple(run_config["ops"][operation]["config"]["recordings"])
    except (KeyError, TypeError, AttributeError):  # somebody launched it with a config of their own
        return ()


def range_of(run: dg.DagsterRun) -> tuple[str, str] | None:
    """Return the first and the last partition of a run about a range of them; None if it is about something else."""
    first, last = (run.tags.get(tag) for tag in _RANGE_TAGS)
    return None if first is None or last is None else (first, last)


def recordings_of(instance: dg.DagsterInstance, names: Naming) -> Callable[[dg.DagsterRun], tuple[str, ...]]:
    """Return a function that returns the partition keys of a run; of one about datasets, `DATASET` if a batch makes them.

    It does not look at the assets of the run, which may be those of another project: see `Naming.is_about`.
    """
    registered = cache(lambda: list(instance.get_dynamic_partitions(names.partitions)))

    def found(run: dg.DagsterRun) -> tuple[str, ...]:
        if PARTITION_TAG in run.tags:
            return (run.tags[PARTITION_TAG],)
        ends = range_of(run)
        if ends is None:
            return batch_of(run, names)
        keys = registered()
        if not {*ends} <= {*keys}:  # one was removed since
            return ends
        return tuple(keys[keys.index(ends[0]) : keys.index(ends[1]) + 1])

    return found
