"""The run launcher of bagassets: executes runs in workers of the fork server.

Set in `dagster.yaml`; all of `config` is optional, its paths absolute or relative to the folder
that Dagster is started in::

    run_launcher:
      module: bagassets.defs.launcher
      class: BagAssetsRunLauncher
      config:
        recipe: recipe.yaml       # of code locations whose .env names none; default: BAGASSETS_RECIPE, else recipe.yaml
        state_folder: .bagassets  # default: the recipe's, else the folder of the instance
        idle_timeout_s: 900       # the server ends after so long without work; default: BAGASSETS_SERVER_MINUTES, else 900
        grace_s: 30               # a cancelled worker is killed after that

Recommended with it: a queue that is polled every second and starts one run per recording at a time (workers of one
recording take turns anyway, but the second one would wait in memory), and run monitoring, which notices workers that
died with their machine or container::

    run_coordinator:
      module: dagster._core.run_coordinator
      class: QueuedRunCoordinator
      config:
        dequeue_interval_seconds: 1
        tag_concurrency_limits:
          - {key: dagster/partition, value: {applyLimitPerUniqueValue: true}, limit: 1}
    run_monitoring: {enabled: true, start_timeout_seconds: 86400}  # a run that waits its turn is "starting"
"""

import logging
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dagster as dg

from bagassets.base.errors import BagAssetsError
from bagassets.defs.dagster_private import (
    GRPC_INFO_TAG,
    CheckRunHealthResult,
    ConfigurableClassData,
    LaunchRunContext,
    ModuleCodePointer,
    T_DagsterInstance,
    WorkerStatus,
)
from bagassets.defs.launchers.run_worker import end_worker
from bagassets.defs.records.instances import pack_instance
from bagassets.defs.records.projects import recipe_of_location, recipes_of
from bagassets.defs.runs.execution import mark_canceling
from bagassets.defs.runs.launching import ConfiguredLauncher, LauncherSettings, last_words
from bagassets.defs.runs.worker_tag import WORKER_TAG, RunWorker
from bagassets.defs.ui.ports import ANY_HOST
from bagassets.forkserver.client import Client, ServerRefusedError
from bagassets.forkserver.process import ProcessId
from bagassets.forkserver.server_files import ServerFiles
from bagassets.forkserver.spec import ServerSpec
from bagassets.forkserver.tasks import DEFINITIONS, END_WORKER, connect, server_spec, submit_run
from bagassets.recipe import load_recipe

_LOG = logging.getLogger(__name__)
_LOCAL_HOSTS = ANY_HOST | {"localhost", "127.0.0.1", "::1"}


@dataclass(frozen=True, kw_only=True)
class Settings(LauncherSettings):
    """What `config` may say; see above.

    Attributes:
        state_folder: folder of the fork server.
        idle_timeout_s: the server ends after so long without work.
        grace_s: a cancelled worker is killed after that.
    """

    state_folder: str | None = None
    idle_timeout_s: int | None = None
    grace_s: int = 30


class BagAssetsRunLauncher(ConfiguredLauncher[T_DagsterInstance]):
    """Has runs executed by workers of the fork server; where that is not possible, by Dagster's own launcher.

    It keeps no record of its runs: a tag on each run names the worker, so that any process can cancel it or check
    whether it is alive. The server stays up as long as a launcher exists that launched something (that of the web
    server or the daemon).
    """

    executes_here = names_workers = True
    settings_type = Settings
    settings: Settings

    def __init__(self, inst_data: ConfigurableClassData | None = None, **config: Any) -> None:
        self._default = dg.DefaultRunLauncher()
        self._client: Client | None = None
        self._mutex = threading.Lock()  # the web server launches from several threads
        super().__init__(inst_data, **config)

    def register_instance(self, instance: T_DagsterInstance) -> None:
        """Set the instance whose runs are launched."""
        super().register_instance(instance)
        self._default.register_instance(instance)

    def dispose(self) -> None:
        """Disconnect from the server."""
        with self._mutex:
            self._drop_client()
        self._default.dispose()

    # --- launching -------------------------------------------------------------------

    def launch_run(self, context: LaunchRunContext) -> None:
        """Hand a run to the fork server, or to Dagster's own launcher, recording why."""
        run = context.dagster_run
        reason = _why_not_here(run)
        if reason is None:
            try:
                self._submit(run)
            except (BagAssetsError, OSError) as err:
                reason = str(err)
        if reason is None:
            return
        self._instance.report_engine_event(
            f"The run is left to Dagster's default launcher, which takes longer to start it: {reason}",
            dagster_run=run,
            cls=self.__class__,
        )
        if WORKER_TAG in run.tags:
            self._instance.add_run_tags(run.run_id, {WORKER_TAG: ""})
        self._default.launch_run(context)

    def _submit(self, run: dg.DagsterRun) -> None:
        spec = self._spec(run)
        with self._mutex:
            for is_last in (False, True):
                try:
                    client = self._client_for(spec)
                    # Before the worker exists, so that a launched run always names who is responsible for it.
                    self._instance.add_run_tags(run.run_id, RunWorker(run.run_id, client.process).tags())
                    submit_run(client, pack_instance(self._instance), run.run_id, detached=True)
                except ServerRefusedError:
                    self._drop_client()
                    # Its successor would take the run for an orphan of a dead server.
                    self._instance.add_run_tags(run.run_id, {WORKER_TAG: ""})
                    if is_last:
                        raise
                else:
                    return

    def _client_for(self, spec: ServerSpec) -> Client:
        if self._client is not None and self._client.files.stamp == spec.stamp():
            return self._client
        self._drop_client()
        self._client = connect(spec, pack_instance(self._instance))
        return self._client

    def _drop_client(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    def _spec(self, run: dg.DagsterRun) -> ServerSpec:
        recipe = recipe_of_location(self._instance, run) or self._recipe_file
        pointer = run.job_code_origin.repository_origin.code_pointer if run.job_code_origin else None
        modules: tuple[str, ...] = ()
        paths: tuple[str, ...] = ()
        if isinstance(pointer, ModuleCodePointer):
            modules = (pointer.module,)
            paths = (pointer.working_directory,) if pointer.working_directory else ()
        # A module of the user's may be made from several recipes, and each that changes makes its server outdated.
        read = [] if modules == (DEFINITIONS,) else recipes_of(self._instance)
        return server_spec(
            self._folder(recipe),
            recipe,
            modules=modules,
            paths=paths,
            idle_timeout_s=self.settings.idle_timeout_s,
            recipes=tuple(file for file in read if recipe is None or not file.samefile(recipe)),
        )

    def _folder(self, recipe: Path | None) -> Path:
        if self.settings.state_folder is not None:
            return Path(self.settings.state_folder)
        return load_recipe(recipe).state if recipe is not None else Path(self._instance.root_directory)

    # --- ending ----------------------------------------------------------------------

    def terminate(self, run_id: str) -> bool:
        """Cancel a run from any process of this machine; return False if that is not possible.

        The run is marked CANCELING, its worker gets SIGTERM, and SIGKILL if it has not stopped
        after `grace_s` seconds.
        """
        run = self._instance.get_run_by_id(run_id)
        if run is None or run.is_finished:
            return False
        worker = RunWorker.of(run)
        if worker is None and GRPC_INFO_TAG in run.tags:
            terminate: Callable[[str], bool] = self._default.terminate
            return terminate(run_id)
        if worker is None or not worker.is_on_this_host:
            return self._refuse_to_cancel(run, f"{worker or 'another program'} executes it")
        if not mark_canceling(self._instance, run) or self._cancel_job(run_id):
            return True
        if worker.process is None or not worker.process.send(signal.SIGTERM):
            self._instance.report_run_canceled(run, f"The worker ({worker}) of the run is gone.")
            return True
        self._end_later(run, worker.process)
        return True

    def _cancel_job(self, run_id: str) -> bool:
        """Have the server cancel the run; return False if no server that answers has it."""
        try:
            for client in Client.all_of(self._folder(self._recipe_file)):
                for job in client.status()["jobs"]:
                    if job["label"] == run_id and client.cancel(job["job"], grace_s=self.settings.grace_s):
                        return True
        except BagAssetsError as err:
            _LOG.warning("run %s: no fork server could be reached (%s)", run_id, err)
        return False

    def _end_later(self, run: dg.DagsterRun, process: ProcessId) -> None:
        """Make sure that a worker without a server ends."""
        args = {
            "instance": pack_instance(self._instance),
            "run_id": run.run_id,
            "process": process.as_json(),
            "grace_s": self.settings.grace_s,
        }
        try:
            with Client.ensure(self._spec(run)) as client:
                client.submit(END_WORKER, args, label=f"end-{run.run_id}", detached=True)
        except BagAssetsError as err:
            _LOG.warning("run %s: its worker is ended by this process (%s)", run.run_id, err)
            threading.Thread(target=end_worker, args=(args,), daemon=True).start()

    # --- health ----------------------------------------------------------------------

    def check_run_worker_health(self, run: dg.DagsterRun) -> CheckRunHealthResult:
        """Return whether the worker of a run is alive.

        A run without a worker of ours counts as running, since run monitoring fails every run with another status.
        """
        worker = RunWorker.of(run)
        if worker is None:
            return CheckRunHealthResult(
                WorkerStatus.RUNNING, "Executed by another program, which monitors it."
            )
        if not worker.is_on_this_host or worker.is_alive():
            return CheckRunHealthResult(WorkerStatus.RUNNING, str(worker), run_worker_id=str(worker))
        return CheckRunHealthResult(
            WorkerStatus.FAILED, f"The worker ({worker}) is gone.", run_worker_id=str(worker)
        )

    def get_run_worker_debug_info(
        self, run: dg.DagsterRun, include_container_logs: bool | None = True
    ) -> str | None:
        """Return the last lines that the worker of a run wrote, if it wrote any."""
        if RunWorker.of(run) is None or not include_container_logs:
            return None
        return last_words(ServerFiles(self._folder(self._recipe_file), "").job_log(run.run_id)) or None


def _why_not_here(run: dg.DagsterRun) -> str | None:
    """Return why a server of this Python environment cannot run the code of a run; None if it can."""
    if run.job_code_origin is None or run.remote_job_origin is None:
        return "it does not say where its code is."
    code = run.job_code_origin.repository_origin
    if code.container_image is not None:
        return f"its code lives in the container image {code.container_image}."
    if Path(code.executable_path).parent != Path(sys.executable).parent:
        return f"its code belongs to another Python environment ({code.executable_path})."
    host = getattr(run.remote_job_origin.repository_origin.code_location_origin, "host", None)
    if host not in {None, *_LOCAL_HOSTS}:
        return f"its code lives on {host}."
    return None
