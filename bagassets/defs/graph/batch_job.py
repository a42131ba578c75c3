"""The job that brings a batch of recordings up to date, one after the other, and then the datasets if asked to.

Each recording is recorded as its own partition, as a run of its own would.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import dagster as dg

from bagassets.base.errors import BagAssetsError, RunEndedError
from bagassets.base.quantities import count_text
from bagassets.defs.graph.checks import check_recording, run_dataset_checks
from bagassets.defs.graph.dataset import dataset_is_current, make_dataset, record_inputs
from bagassets.defs.graph.making import make_recording
from bagassets.defs.records.instance_plan import plan_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.recorder import Recorder
from bagassets.defs.records.reporting import errors_explained
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.exclusive import RecordingLock
from bagassets.defs.runs.run_progress import note_begun, note_ended
from bagassets.engine.batches import DATASET, Batch
from bagassets.engine.plan import Plan
from bagassets.engine.unsettled import Unsettled
from bagassets.formats.dataset_build import DatasetInputs, dataset_code_versions, select_inputs
from bagassets.recordings.model import RecordingFiles

_MOST_NAMED = 3


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
        instance, workspace = context.instance, Workspace.of(context, names.workspace)
        lock: RecordingLock = getattr(context.resources, names.lock)
        batch: Batch = context.op_config["recordings"]
        failed: dict[str, str] = {}
        with errors_explained():
            found = workspace.discover().recordings
        for key, assets in batch.items():
            if key != DATASET:
                recorder = Recorder(instance, workspace, key, context, assets)
                with _noted(context, recorder, failed):
                    _make_recording(context, recorder, lock, found.get(key))
        if DATASET in batch:
            plan = plan_instance(instance, workspace)
            inputs = select_inputs(plan)
            record_inputs(instance, workspace, inputs)
            if not dataset_is_current(instance, workspace, inputs):
                recorder = Recorder(instance, workspace, DATASET, context, batch[DATASET])
                with _noted(context, recorder, failed):
                    _make_datasets(recorder, plan, inputs)
        if failed:
            raise dg.Failure(_describe(failed, len(batch.keys() - {DATASET})), allow_retries=False)

    @dg.job(
        name=names.batch_job,
        description="Brings recordings up to date, and the datasets made from them; `bagassets build` launches it.",
        executor_def=dg.in_process_executor,
    )
    def job() -> None:
        build_each()

    return job


@contextmanager
def _noted(context: dg.OpExecutionContext, recorder: Recorder, failed: dict[str, str]) -> Iterator[None]:
    """Note in the log of the run that a recording, or the datasets, is begun and ended; one that fails does not stop the others.

    Args:
        context: of the step.
        recorder: records what is made in this block.
        failed: gets why something failed, by partition key.

    Raises:
        RunEndedError: the run was given up while this worker was at work.
    """
    key, log = recorder.key, (context.instance, context.run_id, context.job_name, recorder.key)
    note_begun(*log)
    try:
        with recorder.giving_up(recorder.wanted):
            yield
    except RunEndedError:
        raise
    except BagAssetsError as err:
        failed[key] = str(err)
    except Exception as err:
        failed[key] = f"{type(err).__name__}: {err}"
        context.log.exception("%s: an unexpected error", key or "the datasets")
    note_ended(*log, failed.get(key))


def _make_recording(
    context: dg.OpExecutionContext, recorder: Recorder, lock: RecordingLock, recording: RecordingFiles | None
) -> None:
    workspace, key = recorder.workspace, recorder.key
    unsettled = Unsettled(workspace.recipe.state)
    # Not before it is held: a worker whose run was given up meanwhile has nothing to do with what its successor made.
    with lock.hold(context, key):
        unsettled.add(key)
        # Asked for once more, a recording that is gone says what to do.
        recording = recording or workspace.recording(key)
        for made in make_recording(recorder, recording, recorder.wanted):
            recorder.record(made)
        recorder.record_checks(check_recording(recorder, recording, recorder.made))
        unsettled.discard(key)


def _make_datasets(recorder: Recorder, plan: Plan, inputs: DatasetInputs) -> None:
    instance, workspace, problems = recorder.instance, recorder.workspace, []
    for asset in dataset_code_versions(workspace.recipe):
        if asset not in recorder.wanted:
            continue
        try:
            recorder.record(make_dataset(instance, workspace, plan, inputs, asset, recorder.run_id))
            recorder.record_checks(run_dataset_checks(workspace, asset))
        except RunEndedError:
            raise
        except BagAssetsError as err:  # the others may well succeed
            problems.append(str(err))
    if problems:
        raise BagAssetsError(" ".join(problems))


def _describe(failed: Mapping[str, str], total: int) -> str:
    recordings = [f"{key}: {problem}" for key, problem in failed.items() if key != DATASET]
    said = []
    if recordings and total > 1:
        said.append(f"{len(recordings)} of {count_text(total, 'recording')} failed; the others are recorded.")
    said += recordings[:_MOST_NAMED]
    if len(recordings) > _MOST_NAMED:
        said.append(f"(and {len(recordings) - _MOST_NAMED} more)")
    if DATASET in failed:
        said.append(f"The datasets could not be made: {failed[DATASET]}")
    return " ".join(said)
