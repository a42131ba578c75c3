"""Several recordings in one run: one after the other, or side by side in processes that the fork server forks for the run.

Each is recorded as its own partition, as a run of its own would. The processes are those of the run, which waits for them; if
it is cancelled or killed, the server ends them, and what they have not recorded is lost.
"""

import os
import signal
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from bagassets.base.errors import BagAssetsError, RunEndedError
from bagassets.base.json_types import JsonObject
from bagassets.base.quantities import count_text
from bagassets.base.trace import name_process
from bagassets.defs.graph.checks import check_recording
from bagassets.defs.graph.making import make_recording
from bagassets.defs.records.databases import database_errors_explained
from bagassets.defs.records.fence import run_has_ended
from bagassets.defs.records.instances import open_instance, pack_instance
from bagassets.defs.records.recorder import Recorder
from bagassets.defs.records.run_step import RunStep
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.exclusive import hold_recording
from bagassets.defs.runs.run_progress import note_begun, note_ended
from bagassets.engine.batches import DATASET, Batch, batches
from bagassets.engine.unsettled import Unsettled
from bagassets.forkserver.client import Client, ServerRefusedError
from bagassets.forkserver.worker import note
from bagassets.recordings.model import RecordingFiles
from bagassets.store.lease import HOLDERS

_MOST_NAMED = 3
_PART = f"{__name__}:make_part"
_GRACE_S = 5.0
_POLL_S = 0.5

Told = Callable[[str, str | None], object]
"""Is told of each recording that has ended, and why it failed (None if it did not)."""


def make_each(
    step: RunStep, workspace: Workspace, locks: Path, batch: Batch, told: Told | None = None
) -> dict[str, str]:
    """Make recordings one after the other; one that fails does not stop the others.

    Args:
        step: of the run that makes them.
        workspace: recipe and store.
        locks: folder of the locks of recordings.
        batch: partition key -> assets.
        told: called as soon as one has ended.

    Returns:
        Partition key -> why it failed.

    Raises:
        RunEndedError: the run was given up meanwhile.
    """
    failed: dict[str, str] = {}
    found = workspace.discover().recordings
    for key, assets in batch.items():
        recorder = Recorder(step.instance, workspace, key, step, assets)
        with noted(step, recorder, failed):
            _make_recording(step, recorder, locks, found.get(key))
        if told is not None:
            told(key, failed.get(key))
    return failed


def make_side_by_side(step: RunStep, workspace: Workspace, locks: Path, batch: Batch) -> dict[str, str]:
    """Make recordings as `make_each` does, but as many at the same time as there are processors, if the run has a fork server."""
    with _server_of(workspace) as client:
        if client is None or len(batch) == 1:
            return make_each(step, workspace, locks, batch)
        ended: dict[str, str | None] = {}
        with suppress(ServerRefusedError):  # the recipe changed, say, so that it takes no more jobs
            _make_parts(client, step, workspace, locks, batch, ended)
    left = {key: assets for key, assets in batch.items() if key not in ended}
    failed = {key: problem for key, problem in ended.items() if problem is not None}
    return failed | (make_each(step, workspace, locks, left) if left else {})


def _make_parts(
    client: Client,
    step: RunStep,
    workspace: Workspace,
    locks: Path,
    batch: Batch,
    ended: dict[str, str | None],
) -> None:
    """Have processes make parts of a batch, and note in `ended` how each recording ends.

    Runs that share the processors leave each other room, and each has one process at least.
    """
    processors, found = os.cpu_count() or 1, workspace.discover().recordings
    sizes = {key: found[key].size if key in found else 0 for key in batch}
    waiting = batches(batch, sizes, processors)[::-1]
    at_work: dict[str, Batch] = {}
    args = {
        "instance": pack_instance(step.instance),
        "step": [step.run_id, step.job_name, step.step, step.is_planned],
        "recipe": workspace.recipe_file,
        "prefix": workspace.key_prefix,
        "locks": str(locks),
    }
    while waiting or at_work:
        while waiting and (not at_work or _parts_at_work(client) < processors):
            part, label = waiting.pop(), f"{step.run_id}-{len(waiting)}"
            job = client.submit(_PART, {**args, "batch": dict(part)}, label=label, grace_s=_GRACE_S)
            at_work[job] = part
        event = client.wait(_POLL_S if waiting else None)
        if event is None:
            continue
        if event["event"] == "note":
            ended |= event["note"]
            continue
        part = at_work.pop(event["job"])
        error = event.get("error") or {}
        if error.get("type") == RunEndedError.__name__:
            raise RunEndedError(error["message"])
        why = event.get("reason") or error.get("message") or "it ended"
        _give_up(step, workspace, {key: part[key] for key in part if key not in ended}, why, ended)


def _give_up(
    step: RunStep, workspace: Workspace, batch: Batch, why: str, ended: dict[str, str | None]
) -> None:
    """Record that the process of some recordings is gone."""
    failed: dict[str, str] = {}
    for key, assets in batch.items():
        with noted(step, Recorder(step.instance, workspace, key, step, assets), failed):
            raise BagAssetsError(f"{key}: the process that made it is gone: {why}")
    ended |= failed


def _parts_at_work(client: Client) -> int:
    return sum(job["function"] == _PART for job in client.status()["jobs"])


@contextmanager
def _server_of(workspace: Workspace) -> Iterator[Client | None]:
    """Yield a client of the server that this worker was forked from; None if there is none, or it takes no more jobs."""
    for client in Client.all_of(workspace.recipe.state):
        if client.process.pid == os.getppid():
            yield client
            return
    yield None


def make_part(args: JsonObject) -> None:
    """Make some recordings of a run in a process beside its worker; see `_make_parts` for the arguments."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that what is half made is removed
    batch: Batch = args["batch"]
    run_id, job_name, name, is_planned = args["step"]
    name_process(f"worker: {count_text(len(batch), 'recording')} of run {run_id[:8]}")
    with database_errors_explained("this instance"), open_instance(args["instance"]) as instance:
        HOLDERS.name, HOLDERS.has_ended = run_id, partial(run_has_ended, instance)
        workspace = Workspace(recipe_file=args["recipe"], key_prefix=args["prefix"])
        step = RunStep(instance, run_id, job_name, name, is_planned)
        make_each(step, workspace, Path(args["locks"]), batch, lambda key, problem: note({key: problem}))


@contextmanager
def noted(step: RunStep, recorder: Recorder, failed: dict[str, str]) -> Iterator[None]:
    """Note in the log of the run that a recording, or the datasets, is begun and ended; one that fails does not stop the others.

    Args:
        step: of the run.
        recorder: records what is made in this block.
        failed: gets why something failed, by partition key.

    Raises:
        RunEndedError: the run was given up while this worker was at work.
    """
    key, log = recorder.key, (step.instance, step.run_id, step.job_name, recorder.key)
    note_begun(*log)
    try:
        with recorder.giving_up(recorder.wanted):
            yield
    except RunEndedError:
        raise
    except BagAssetsError as err:
        failed[key] = str(err)
    except Exception as err:  # noqa: BLE001  (one recording does not stop the others)
        failed[key] = f"{type(err).__name__}: {err}"
        step.log(f"{key or 'the datasets'}: an unexpected error\n\n{traceback.format_exc()}")
    note_ended(*log, failed.get(key))


def _make_recording(step: RunStep, recorder: Recorder, locks: Path, recording: RecordingFiles | None) -> None:
    workspace, key = recorder.workspace, recorder.key
    unsettled = Unsettled(workspace.recipe.state)
    # Not before it is held: a worker whose run was given up meanwhile has nothing to do with what its successor made.
    with hold_recording(locks, step, key):
        unsettled.add(key)
        # Asked for once more, a recording that is gone says what to do.
        recording = recording or workspace.recording(key)
        for made in make_recording(recorder, recording, recorder.wanted):
            recorder.record(made)
        recorder.record_checks(check_recording(recorder, recording, recorder.made))
        unsettled.discard(key)


def describe(failed: Mapping[str, str], total: int) -> str:
    """Return what a run says in the end of recordings, and datasets, that failed; `total` counts the recordings."""
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
