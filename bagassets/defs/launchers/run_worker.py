"""The jobs that workers of the fork server do for Dagster: executing runs, and reporting those that were lost.

Every function takes and returns JSON, is named in a job as `bagassets.defs.launchers.run_worker:name`,
and opens the instance itself: no database connection may be opened before a fork.
"""

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from functools import partial
from importlib import import_module
from itertools import chain
from pathlib import Path

import dagster as dg

from bagassets.base.alike import names_text
from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonObject
from bagassets.base.trace import name_process, span
from bagassets.decode.loading import load_built_in
from bagassets.defs.builds.pending_work import rehearse
from bagassets.defs.dagster_private import RUN_MODULES, capture_interrupts, check_captured_interrupt
from bagassets.defs.graph.own_location import know_installed_modules
from bagassets.defs.records.batches import PARTITION_TAG, batch_of
from bagassets.defs.records.databases import read_settings
from bagassets.defs.records.fence import run_has_ended
from bagassets.defs.records.instances import dotenv_variables, open_instance
from bagassets.defs.runs.exclusive import ASKS_PER_LOOK, exclusive, holder_has_ended
from bagassets.defs.runs.execution import execute_run, preload_definitions
from bagassets.defs.runs.orphaned_runs import end_orphaned_runs, report_ended
from bagassets.defs.runs.worker_tag import RunWorker
from bagassets.forkserver.process import ProcessId
from bagassets.forkserver.worker import cancel_requested
from bagassets.geometry.kernels.machine_code import compile_all
from bagassets.recordings.layouts import compile_common_types
from bagassets.store.lease import HOLDERS

_POLL_S = 0.5
_UNTIL_IDLE = (True,)  # a step after which the server waits until no job is at work

# What opening a SQLite instance, executing a run and the steps import; it saves each worker 0.7 s.
_AHEAD = (
    "bagassets.defs.launcher",
    "bagassets.defs.builds.project_build",
    "bagassets.defs.sqlite_storage",
    *RUN_MODULES,
    "dateutil.relativedelta",
    "numpy.ma",
    "rosbags.serde.primitives",
    "sqlalchemy.dialects.sqlite",
    "upath.implementations.local",
)
_FOR_FEW = ("pyarrow.compute",)  # the checks of signals need it


def preload(modules: list[str]) -> Iterator[object]:
    """Import what workers share, before the server forks; opens no instance and starts no thread.

    Returns:
        Short steps that make workers still faster, and can wait until the server is idle.
    """
    _apply_dotenv()
    _stand_in_for_script()
    for module in _AHEAD:
        with suppress(ModuleNotFoundError):  # not all is required: dateutil comes with the web UI
            import_module(module)
    for module in modules:
        preload_definitions(module)
    load_built_in()
    # The first run after a start would wait for types that it may not need.
    later = compile_common_types(), map(import_module, _FOR_FEW), _UNTIL_IDLE, _rehearse()
    return chain(_look_ahead(), compile_all(), _UNTIL_IDLE, *later)


def _look_ahead() -> Iterator[None]:
    """Prepare in memory what every build would otherwise read first."""
    know_installed_modules()
    yield
    recipe = os.environ.get("BAGASSETS_RECIPE")
    if recipe is not None:
        with suppress(Exception):  # whoever opens the instance meets it again, and reports it
            read_settings(Path(recipe).parent)
    yield


def _rehearse() -> Iterator[None]:
    """Ask the project's database once what builds ask, so that workers find their statements compiled (a quarter of planning)."""
    recipe = os.environ.get("BAGASSETS_RECIPE")
    if recipe is not None:
        rehearse(Path(recipe))
    yield


def execute(args: JsonObject) -> str:
    """Execute the run `run_id` of `instance`; return how it ended.

    Runs of one partition take turns, by means of lock files in the folder `locks`. With `tags`, which are put on the run,
    the worker is one that SIGTERM does not interrupt: what sends it to all processes of a job is not about this run.
    """
    if "tags" in args:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    with capture_interrupts(), ExitStack() as stack:
        instance = _open(args, stack)
        run_id = str(args["run_id"])
        run = instance.get_run_by_id(run_id)
        if run is None:
            raise BagAssetsError(
                f"run {run_id}: not in the Dagster instance; it was deleted before it started."
            )
        HOLDERS.name, HOLDERS.has_ended = run_id, partial(run_has_ended, instance)
        instance.add_run_tags(run_id, RunWorker.here(run_id).tags() | args.get("tags", {}))

        partition_key, locks = run.tags.get(PARTITION_TAG), Path(args["locks"])
        name_process(f"worker: {partition_key or _describe(run)}")
        stack.enter_context(span("run", run_id=run_id))
        if partition_key is not None:

            def keep_waiting(asked: int) -> bool:
                if asked == 0:
                    message = f"Waiting for another run of {partition_key} to end."
                    instance.report_engine_event(message, dagster_run=run)
                if asked % ASKS_PER_LOOK == 0:
                    if holder_has_ended(instance, locks, partition_key):
                        return False
                    # The web UI cancels a starting run without a signal.
                    current = instance.get_run_by_id(run_id)
                    if current is None or current.is_finished:
                        return False
                return not (check_captured_interrupt() or cancel_requested())

            stack.enter_context(exclusive(locks, partition_key, keep_waiting=keep_waiting, holder=run_id))
        return execute_run(instance, run_id, cancel_requested=cancel_requested)


def report_lost(args: JsonObject) -> None:
    """Report the run of a worker that was killed or failed, unless it has ended."""
    with ExitStack() as stack:
        report_ended(_open(args["args"], stack), args["args"]["run_id"], args["reason"])


def recover(args: JsonObject) -> list[str]:
    """Report orphaned runs (see `orphaned_runs`), and return their ids.

    The job lasts as long as workers of former servers work, or runs wait for a worker: nobody else would notice if these
    ended.
    """
    reported: list[str] = []
    server = os.getppid()

    def has_server(_asked: int = 0) -> bool:
        return os.getppid() == server

    with ExitStack() as stack:
        if not stack.enter_context(exclusive(Path(args["locks"]), "/recover", keep_waiting=has_server)):
            return reported
        instance = _open(args, stack)
        while True:
            ended, unwatched = end_orphaned_runs(instance)
            reported += ended
            if not unwatched or not has_server():
                return reported
            time.sleep(_POLL_S)


def end_worker(args: JsonObject) -> bool:
    """End the worker of the run `run_id`, which is marked CANCELING; return True if it was killed.

    The worker has received SIGTERM already. After `grace_s` seconds it is killed, and the run reported
    unless its server does that.
    """
    process = ProcessId.from_json(args["process"])
    deadline = time.monotonic() + args["grace_s"]
    while process.is_alive() and time.monotonic() < deadline:
        time.sleep(_POLL_S)
    killed = process.send(signal.SIGKILL)
    with ExitStack() as stack:
        instance = _open(args, stack)
        run = instance.get_run_by_id(args["run_id"])
        worker = RunWorker.of(run) if run is not None else None
        if worker is not None and not worker.is_watched():
            what = "was killed, as it did not stop" if killed else "is gone"
            report_ended(instance, args["run_id"], f"The worker ({worker}) {what}.")
    return killed


def _open(args: JsonObject, stack: ExitStack) -> dg.DagsterInstance:
    _apply_dotenv()
    return stack.enter_context(open_instance(args["instance"]))


def _apply_dotenv() -> None:
    """Set the variables of the `.env` beside the recipe, as Dagster does for the folder it is started in."""
    recipe = os.environ.get("BAGASSETS_RECIPE")
    if recipe is not None:
        os.environ.update(dotenv_variables(Path(recipe).parent))


def _stand_in_for_script() -> None:
    """Put the folder of a script first on the module search path.

    Dagster takes the first entry for that, and hides it while it imports definitions: here, and in the processes that a
    multiprocess executor starts. It would be the first folder of PYTHONPATH.
    """
    scripts = str(Path(sys.executable).parent)
    if sys.path[:1] != [scripts]:
        sys.path.insert(0, scripts)


def _describe(run: dg.DagsterRun) -> str:
    """Return what a run about more than one partition is about: recordings, or assets."""
    recordings = [key for key in batch_of(run) if key]
    if recordings:
        return names_text(recordings, 1)
    return ", ".join(sorted(key.to_user_string() for key in run.asset_selection or ())) or run.job_name
