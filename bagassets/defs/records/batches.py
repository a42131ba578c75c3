"""Batches as Dagster has them: the config of their job, and the recordings of such a run.

Dagster's range runs would not do: all partitions of such a run have the same data version, and fail together.
"""

from typing import Any

import dagster as dg

from bagassets.defs.records.naming import BATCH_JOB, BATCH_OP, Naming
from bagassets.engine.batches import Batch


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
