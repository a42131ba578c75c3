"""The job that brings a batch of recordings up to date, one after the other, and then the datasets if asked to.

Each recording is recorded as its own partition, as a run of its own would.
"""

import dagster as dg

from bagassets.base.errors import BagAssetsError, RunEndedError
from bagassets.defs.graph.checks import run_dataset_checks
from bagassets.defs.graph.dataset import dataset_is_current, make_dataset, record_inputs
from bagassets.defs.graph.several import failure_text, make_each, noted
from bagassets.defs.records.instance_plan import plan_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.recorder import Recorder
from bagassets.defs.records.reporting import errors_explained
from bagassets.defs.records.run_step import RunStep
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.exclusive import RecordingLock
from bagassets.engine.batches import DATASET, Batch
from bagassets.engine.plan import Plan
from bagassets.formats.dataset_build import DatasetInputs, dataset_code_versions, select_inputs


def batch_job(names: Naming) -> dg.JobDefinition:
    """Return the job that makes assets of several recordings."""

    @dg.op(
        name=names.batch_op,
        required_resource_keys={names.workspace, names.lock},
        config_schema={
            "recordings": dg.Field(
                dict,
                description="Partition key: names of the assets to make; with an empty key, names of datasets.",
            )
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
            plan = plan_instance(workspace)
            inputs = select_inputs(plan)
            record_inputs(workspace, inputs)
            if not dataset_is_current(workspace, inputs):
                recorder = Recorder(workspace, DATASET, step, batch[DATASET])
                with noted(recorder, ended):
                    _make_datasets(recorder, plan, inputs)
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


def _make_datasets(recorder: Recorder, plan: Plan, inputs: DatasetInputs) -> None:
    workspace, problems = recorder.workspace, []
    for asset in dataset_code_versions(workspace.recipe):
        if asset not in recorder.wanted:
            continue
        try:
            recorder.record(make_dataset(workspace, plan, inputs, asset, recorder.step.run_id))
            recorder.record_checks(run_dataset_checks(workspace, asset))
        except RunEndedError:
            raise
        except BagAssetsError as err:  # the others may well succeed
            problems.append(str(err))
    if problems:
        raise BagAssetsError(" ".join(problems))
