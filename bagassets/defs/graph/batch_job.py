"""The job that brings a batch of recordings up to date, one after the other, and then the datasets if asked to.

Each recording is recorded as its own partition, as a run of its own would.
"""

import dagster as dg

from bagassets.defs.graph.several import failure_text, make_datasets, make_each, wait_for_runs
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.reporting import errors_explained
from bagassets.defs.records.run_step import RunStep
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.exclusive import RecordingLock
from bagassets.engine.batches import DATASET, Batch


def batch_job(names: Naming) -> dg.JobDefinition:
    """Return the job that makes assets of several recordings."""

    @dg.op(
        name=names.batch_op,
        required_resource_keys={names.workspace, names.lock},
        config_schema={
            "recordings": dg.Field(
                dict,
                description="Partition key: names of the assets to make; with an empty key, names of datasets.",
            ),
            "after": dg.Field(
                [str],
                default_value=[],
                description="Runs of other recordings that have to end before the datasets are made.",
            ),
        },
        out=dg.Out(dg.Nothing),
        description=__doc__,
    )
    def build_each(context: dg.OpExecutionContext) -> None:
        workspace = Workspace.of(context, names.workspace)
        lock: RecordingLock = getattr(context.resources, names.lock)
        batch: Batch = context.op_config["recordings"]
        recordings, step = {key: batch[key] for key in batch if key != DATASET}, RunStep.of(context)
        with errors_explained():
            ended = dict(make_each(step, workspace, lock, recordings))
        if DATASET in batch:
            wait_for_runs(step, context.op_config["after"])
            make_datasets(step, workspace, batch[DATASET], ended)
        if problem := failure_text(ended):
            raise dg.Failure(problem, allow_retries=False)

    @dg.job(
        name=names.batch_job,
        description="Brings recordings up to date, and the datasets made from them; `bagassets build` launches it.",
        executor_def=dg.in_process_executor,
    )
    def job() -> None:
        build_each()

    return job
