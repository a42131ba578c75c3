"""Several recordings in one run: one after the other, or side by side in processes that the fork server forks for the run.

The run is of the job that `bagassets build` launches and the sensor requests, or of a backfill's range. Each recording is
recorded as its own partition, as by a run of its own. The processes are those of the run, which waits for them; if it is
cancelled or killed, the server ends them, and what they have not recorded is lost.
"""

import logging
import os
import signal
import traceback
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import partial

import dagster as dg

from bagassets.base.alike import names_text
from bagassets.base.errors import BagAssetsError, RunEndedError, StoreError
from bagassets.base.json_types import JsonObject
from bagassets.base.quantities import count_text
from bagassets.base.trace import name_process
from bagassets.base.unexpected import disk_errors_explained
from bagassets.defs.graph.checks import check_recording, run_dataset_checks
from bagassets.defs.graph.dataset import dataset_is_current, make_dataset, record_inputs
from bagassets.defs.graph.making import make_recording
from bagassets.defs.records.databases import database_errors_explained
from bagassets.defs.records.fence import run_has_ended
from bagassets.defs.records.instance_plan import plan_instance, workspace_fingerprint
from bagassets.defs.records.instances import open_instance, pack_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import range_policy
from bagassets.defs.records.recorder import Recorder
from bagassets.defs.records.reporting import errors_explained
from bagassets.defs.records.run_step import RunStep
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.exclusive import RecordingLock
from bagassets.defs.runs.run_progress import note_begun, note_ended
from bagassets.engine.batches import DATASET, Batch, batches
from bagassets.engine.unsettled import Unsettled
from bagassets.forkserver.client import Client, ServerRefusedError
from bagassets.forkserver.worker import note
from bagassets.formats.checking import KeptVerdicts
from bagassets.formats.dataset_build import dataset_code_versions, select_inputs
from bagassets.recordings.discover import Discovery
from bagassets.store.lease import HOLDERS, in_use

_MOST_NAMED = 3
_PART = f"{__name__}:make_part"
_POLL_S = 0.5

Ended = dict[str, str | None]
"""Partition key -> why the recording, or the datasets (`DATASET`), failed; None if it did not."""


def batch_job(names: Naming) -> dg.JobDefinition:
    """Return the job that makes assets of several recordings, and then the datasets if asked to."""

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
        description=(
            "The job that brings a batch of recordings up to date, one after the other, and then the datasets if asked to.\n\n"
            "Each recording is recorded as its own partition, as a run of its own would."
        ),
    )
    def build_each(context: dg.OpExecutionContext) -> None:
        workspace = Workspace.of(context, names.workspace)
        lock: RecordingLock = getattr(context.resources, names.lock)
        with errors_explained():
            make_batch(RunStep.of(context), workspace, lock, context.op_config["recordings"])

    @dg.job(
        name=names.batch_job,
        description="Brings recordings up to date, and the datasets made from them; `bagassets build` launches it.",
        executor_def=dg.in_process_executor,
    )
    def job() -> None:
        build_each()

    return job


def make_batch(
    step: RunStep, workspace: Workspace, lock: RecordingLock, batch: Batch, *, side_by_side: bool = False
) -> None:
    """Make recordings, and then the datasets if `batch` has them.

    Args:
        step: of the run that makes them.
        workspace: recipe and store.
        lock: keeps runs of a recording apart.
        batch: partition key -> assets.
        side_by_side: as many at the same time as there are processors, if the run has a fork server; else one after the other.

    Raises:
        dagster.Failure: some could not be made; raised after all others were.
        RunEndedError: the run was given up meanwhile.
    """
    recordings = {key: assets for key, assets in batch.items() if key != DATASET}
    found, ended = workspace.discover(), Ended()
    with suppress(ServerRefusedError):  # the recipe changed, say, so that it takes no more jobs
        for client in Client.all_of(workspace.recipe.state) if side_by_side and len(recordings) > 1 else ():
            if client.process.pid == os.getppid():
                _make_parts(client, step, workspace, lock, recordings, ended)
    left = {key: assets for key, assets in recordings.items() if key not in ended}
    ended |= _make_each(step, workspace, lock, left, found)
    if DATASET in batch:
        _make_datasets(step, workspace, batch, found, ended)
    if range_policy():  # Dagster's command says of all later steps that they are skipped
        for key, failed in ended.items():
            what = key or names_text(batch[DATASET])
            step.log(f"{what}: {'failed' if failed else 'is recorded'}")
    if problem := failure_text(ended):
        raise dg.Failure(problem, allow_retries=False)


def _make_each(
    step: RunStep, workspace: Workspace, lock: RecordingLock, batch: Batch, discovery: Discovery
) -> Iterator[tuple[str, str | None]]:
    """Make recordings one after the other, and yield how each ends (see `Ended`); one that fails does not stop the others.

    Args:
        step: of the run that makes them.
        workspace: recipe and store.
        lock: keeps runs of a recording apart.
        batch: partition key -> assets.
        discovery: the recordings on disk.

    Raises:
        RunEndedError: the run was given up meanwhile.
    """
    found = discovery.recordings
    with ExitStack() as stack:
        with suppress(StoreError):  # each recording reports it
            stack.enter_context(in_use(workspace.store.root))  # one lease for all of them
        unsettled = Unsettled(workspace.recipe.state)
        kept = KeptVerdicts(workspace.recipe, workspace_fingerprint(workspace))
        stack.callback(kept.write)
        for key, assets in batch.items():
            recorder, ended = Recorder(workspace, key, step, assets), Ended()
            # Not before it is held: a worker whose run was given up meanwhile has nothing to do with what its successor made.
            with noted(recorder, ended), lock.hold(step, key):
                unsettled.add(key)
                # Asked for once more, a recording that is gone says what to do.
                recording = found[key] if key in found else workspace.recording(key)
                for made in make_recording(recorder, recording, assets):
                    recorder.record(made)
                recorder.record_checks(check_recording(recorder, recording, recorder.made, kept))
                unsettled.discard(key)
            yield key, ended[key]


def _make_parts(
    client: Client, step: RunStep, workspace: Workspace, lock: RecordingLock, batch: Batch, ended: Ended
) -> None:
    """Have processes make parts of a batch, and note in `ended` how each recording ends.

    Runs that share the processors leave each other room, and each has one process at least.
    """
    processors, found = os.cpu_count() or 1, workspace.discover().recordings
    sizes = {key: found[key].size if key in found else 0 for key in batch}
    waiting, at_work = batches(batch, sizes, processors)[::-1], dict[str, Batch]()
    args = {
        "instance": pack_instance(step.instance),
        "step": [step.run_id, step.job_name, step.step, step.is_planned],
        "recipe": workspace.recipe_file,
        "prefix": workspace.key_prefix,
        "locks": lock.folder,
    }
    while waiting or at_work:
        while waiting and (not at_work or _parts_at_work(client) < processors):
            part, label = waiting.pop(), f"{step.run_id}-{len(waiting)}"
            job = client.submit(_PART, {**args, "batch": dict(part)}, label=label)
            at_work[job] = part
        event = client.wait(_POLL_S if waiting else None)
        if event is None:
            continue
        if event["event"] == "note":
            ended |= event["note"]
            continue
        error = event.get("error") or {}
        if error.get("type") == RunEndedError.__name__:
            raise RunEndedError(error["message"])
        why = event.get("reason") or error.get("message")
        for key, assets in at_work.pop(event["job"]).items():
            if key not in ended:
                with noted(Recorder(workspace, key, step, assets), ended):
                    raise BagAssetsError(f"{key}: the process that made it is gone: {why}")


def _parts_at_work(client: Client) -> int:
    return sum(job["function"] == _PART for job in client.status()["jobs"])


def make_part(args: JsonObject) -> None:
    """Make some recordings of a run in a process beside its worker; see `_make_parts` for the arguments."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that what is half made is removed
    run_id, *of_step = args["step"]
    name_process(f"worker: {count_text(len(args['batch']), 'recording')} of run {run_id[:8]}")
    with open_instance(args["instance"]) as instance:
        HOLDERS.name, HOLDERS.has_ended = run_id, partial(run_has_ended, instance)
        workspace = Workspace(recipe_file=args["recipe"], key_prefix=args["prefix"]).on(instance)
        step = RunStep(instance, run_id, *of_step)
        lock, found = RecordingLock(folder=args["locks"]), workspace.discover()
        for key, problem in _make_each(step, workspace, lock, args["batch"], found):
            note({key: problem})


@contextmanager
def noted(recorder: Recorder, ended: Ended) -> Iterator[None]:
    """Note in the log of the run that a recording, or the datasets, is begun and ended; one that fails does not stop the others.

    Args:
        recorder: records what is made in this block.
        ended: gets how it ended.

    Raises:
        RunEndedError: the run was given up while this worker was at work.
    """
    step, key = recorder.step, recorder.key
    note_begun(step, key)
    ended[key] = None
    try:
        with (
            recorder.giving_up(recorder.wanted),
            disk_errors_explained(key or "the dataset"),
            database_errors_explained(step.instance.root_directory),
        ):
            yield
    except RunEndedError:
        raise
    except BagAssetsError as err:
        ended[key] = str(err)
    except Exception as err:  # noqa: BLE001  (one recording does not stop the others)
        ended[key] = f"{type(err).__name__}: {err}"
        step.log(f"{key or 'the datasets'}: an unexpected error\n\n{traceback.format_exc()}", logging.ERROR)
    note_ended(step, key, ended[key], has_made=recorder.has_made)


def _make_datasets(step: RunStep, workspace: Workspace, batch: Batch, found: Discovery, ended: Ended) -> None:
    """Make the datasets of a batch, of all that is recorded, unless they are current; note in `ended` how that ends.

    What has come, changed or gone since recordings were `found` is left to whoever looks next.
    """
    problems, wanted = list[str](), batch[DATASET]
    plan = plan_instance(workspace, found, batch.keys())
    inputs = select_inputs(plan)
    record_inputs(workspace, inputs)
    if dataset_is_current(workspace, inputs):
        return
    recorder = Recorder(workspace, DATASET, step, wanted)
    with noted(recorder, ended):
        for asset in filter(wanted.__contains__, dataset_code_versions(workspace.recipe)):
            try:
                recorder.record(make_dataset(workspace, plan, inputs, asset, step.run_id))
                recorder.record_checks(run_dataset_checks(workspace, asset))
            except RunEndedError:
                raise
            except BagAssetsError as err:  # the others may well succeed
                problems.append(str(err))
        if problems:
            raise BagAssetsError(" ".join(problems))


def failure_text(ended: Mapping[str, str | None]) -> str:
    """Return what a run says in the end of recordings, and datasets, that failed; "" if none did."""
    failed = {key: problem for key, problem in ended.items() if problem is not None}
    recordings = [
        f"{key}: {problem.removeprefix(f'{key}: ')}" for key, problem in failed.items() if key != DATASET
    ]
    said, total = [], len(ended.keys() - {DATASET})
    if recordings and total > 1:
        others = "; the others are recorded" if len(recordings) < total else ""
        said.append(f"{len(recordings)} of {count_text(total, 'recording')} failed{others}.")
    said += recordings[:_MOST_NAMED]
    if len(recordings) > _MOST_NAMED:
        said.append(f"(and {len(recordings) - _MOST_NAMED} more)")
    if DATASET in failed:
        said.append(f"The datasets could not be made: {failed[DATASET]}")
    return " ".join(said)
