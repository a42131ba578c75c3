"""Which recordings a run is about: one, those of a batch, or of a backfill's range.

A batch has its recordings in the config of its job. The range of a backfill is in tags: its first and its last partition, in
the order in which they were registered; Dagster makes it of exactly those that were asked for.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import dagster as dg

from bagassets.defs.records.events import Records, all_assets
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


def recordings_of(records: Records, *, of_ours: bool = True) -> Callable[[dg.DagsterRun], tuple[str, ...]]:
    """Return a function that returns the partition keys of a run, with `DATASET` if it is a batch that makes datasets, too.

    With `of_ours` it returns none for a run of users' own assets alone, or of another project's.
    """
    names = records.names
    registered = cache(lambda: list(records.instance.get_dynamic_partitions(names.partitions)))
    ours = frozenset(all_assets())

    def found(run: dg.DagsterRun) -> tuple[str, ...]:
        first, last = (run.tags.get(tag, run.tags.get(PARTITION_TAG)) for tag in _RANGE_TAGS)
        if first is None or last is None:
            return batch_of(run, names)
        if of_ours and not names.is_about(run, ours):
            return ()
        if first == last:
            return (first,)
        keys = registered()
        if not {first, last} <= {*keys}:  # one was removed since
            return first, last
        return tuple(keys[keys.index(first) : keys.index(last) + 1])

    return found
