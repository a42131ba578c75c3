"""The run launcher for Slurm: runs become part of jobs that execute several of them.

Set in `dagster.yaml`; all of `config` is optional::

    run_launcher:
      module: bagassets.defs.slurm.launcher
      class: SlurmRunLauncher
      config:
        partition: work
        account: robots
        cpus: 4                   # of a job, which has as many runs side by side
        memory: 16G
        time: "4:00:00"
        options: ["--qos=low"]    # more options of sbatch
        prefix: module load python &&   # shell text before the command
        rules:                    # later ones override earlier ones
          - {above_gb: 20, memory: 64G}
        recordings_per_run: 10    # small ones
        runs_per_job: 50          # a run of several recordings counts as so many
        minutes_per_job: 30
        folder: .bagassets/slurm  # logs and records of jobs, on a file system that all nodes share
"""

import logging
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import dagster as dg

from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonMapping
from bagassets.base.lock_files import RUN_LOCKS
from bagassets.defs.dagster_private import (
    CheckRunHealthResult,
    ConfigurableClassData,
    LaunchRunContext,
    ModuleCodePointer,
    T_DagsterInstance,
    WorkerStatus,
)
from bagassets.defs.launchers.slurm.commands import SlurmError
from bagassets.defs.launchers.slurm.keeper import Keeper, Packing
from bagassets.defs.launchers.slurm.node import versions_here
from bagassets.defs.launchers.slurm.options import (
    JOB_TAG,
    LOG_TAG,
    NODE_TAG,
    JobOptions,
    options_for,
)
from bagassets.defs.launchers.slurm.spool import JobSpec, Spool, SpooledRun
from bagassets.defs.records.batches import PARTITION_TAG, batch_of
from bagassets.defs.records.instances import pack_instance
from bagassets.defs.records.projects import recipe_of_assets, recipe_of_location
from bagassets.defs.runs.execution import mark_canceling
from bagassets.defs.runs.launching import ConfiguredLauncher, LauncherSettings, config_fields, last_words
from bagassets.defs.runs.orphaned_runs import UNFINISHED, UNTAKEN_S, report_ended
from bagassets.defs.runs.worker_tag import WHERE_TAG
from bagassets.engine.batches import DATASET
from bagassets.recipe import Recipe, load_recipe
from bagassets.recordings.discover import discover
from bagassets.recordings.model import RecordingFiles
from bagassets.store.identity import identify

_LOG = logging.getLogger(__name__)
_BUSY_S, _QUIET_S = 0.25, 2.0
_LOOK_S, _LOOK_LEAST_S = 60.0, 1.0
_BYTES_PER_GB = 1e9


@dataclass(frozen=True, kw_only=True)
class Settings(JobOptions, LauncherSettings):
    """What `config` may say, beside what jobs ask Slurm for; see above.

    Attributes:
        folder: logs and records of jobs.
        python: interpreter of the jobs; default: this one.
        rules: options for recordings larger than `above_gb`.
        recordings_per_run: most small recordings that share a run.
        runs_per_job: see `Packing`.
        minutes_per_job: likewise.
        gather_s: likewise.
        idle_s: how long a job waits for more runs when it has none left.
        seconds_per_run: what a recording is expected to take.
        seconds_per_gb: what each of its gigabytes adds.
        most_at_once: most runs that a build hands over before others have ended.
        give_up_minutes: how long to try to submit runs while Slurm does not answer.
        keep_days: how long logs and records of ended jobs are kept.
    """

    folder: str | None = None
    python: str | None = None
    rules: Sequence[JsonMapping] = field(
        default=(), metadata={"kind": [{"above_gb": dg.Field(float), **config_fields(JobOptions)}]}
    )
    recordings_per_run: int = 10
    runs_per_job: int = 50
    minutes_per_job: float = 30.0
    gather_s: float = 0.5
    idle_s: float = 5.0
    seconds_per_run: float = 2.0
    seconds_per_gb: float = 10.0
    most_at_once: int = 1000
    give_up_minutes: float = 10.0
    keep_days: float = 14.0


class SlurmRunLauncher(ConfiguredLauncher[T_DagsterInstance]):
    """Has runs executed by jobs of Slurm.

    A thread cares for them as long as there are any, in each process that launched one or was asked about one.
    """

    settings_type = Settings
    settings: Settings

    def __init__(self, inst_data: ConfigurableClassData | None = None, **config: Any) -> None:
        self._keeper_made: Keeper | None = None
        self._mutex = threading.RLock()  # the web server launches from several threads
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()
        self._recipes: dict[Path, tuple[int, Recipe]] = {}
        self._found: dict[Path, tuple[float, dict[str, RecordingFiles]]] = {}
        super().__init__(inst_data, **config)
        self.most_at_once = self.settings.most_at_once
        self.recordings_per_run = self.settings.recordings_per_run

    def dispose(self) -> None:
        """Submit what waits, and leave the rest to other processes, or to the next one."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join()
            try:
                self._keeper.tend(flush=True)
            except Exception:  # noqa: BLE001  (the next process carries on)
                _LOG.exception("Slurm: the care for runs met an error at the end")

    # --- launching -------------------------------------------------------------------

    def launch_run(self, context: LaunchRunContext) -> None:
        """Have a run wait for a job.

        Raises:
            BagAssetsError: no job can execute it.
        """
        run = context.dagster_run
        named = recipe_of_location(self._instance, run) or recipe_of_assets(self._instance, run)
        recipe_file, keys = named or self._recipe_file, _recordings_of(run)
        recordings = self._recordings(recipe_file, keys)
        spec = self._spec(run, recipe_file, recordings)
        stale = {name: "" for name in (JOB_TAG, NODE_TAG, LOG_TAG, WHERE_TAG) if name in run.tags}
        if stale:  # copied from the run that this one repeats
            self._instance.add_run_tags(run.run_id, stale)
        self._spool.make()
        sizes = {str(part.path): part.size for one in recordings for part in one.parts or (one,)}
        number, gigabytes = max(1, len(keys)), sum(sizes.values()) / _BYTES_PER_GB
        seconds = self.settings.seconds_per_run * number + self.settings.seconds_per_gb * gigabytes
        self._spool.put(SpooledRun(run.run_id, spec, seconds, time.time(), number, sizes))
        self._care()

    def _spec(
        self, run: dg.DagsterRun, recipe_file: Path | None, recordings: Sequence[RecordingFiles]
    ) -> JobSpec:
        if run.job_code_origin is None:
            raise BagAssetsError(f"run {run.run_id}: it does not say where its code is.")
        code = run.job_code_origin.repository_origin
        if code.container_image is not None:
            raise BagAssetsError(
                f"run {run.run_id}: its code lives in the container image {code.container_image}."
            )
        pointer = code.code_pointer
        if not isinstance(pointer, ModuleCodePointer):
            raise BagAssetsError(f"run {run.run_id}: its code is not in a Python module.")
        recipe = self._read(recipe_file)
        environment, needs, stores = {}, [], {}
        if recipe is not None:
            environment["BAGASSETS_RECIPE"] = str(recipe_file)
            # What is missing here, too, is reported by the runs themselves.
            needed = (recipe_file, recipe.bags.root, recipe.store_path)
            needs = [str(path) for path in needed if path is not None and path.exists()]
            # By its id nodes know whether they see the same store.
            if (found := identify(recipe.store_path)) is not None:
                stores[str(recipe.store_path)] = found
        size = sum(one.size for one in recordings)
        options = options_for(self.settings, self.settings.rules, size, run.tags)
        return JobSpec(
            instance=pack_instance(self._instance),
            options=options.as_json(),
            python=self.settings.python or sys.executable,
            cwd=str(pointer.working_directory or Path.cwd()),
            modules=[pointer.module],
            paths=[pointer.working_directory] if pointer.working_directory else [],
            locks=str(self._state / RUN_LOCKS),
            environment=environment,
            needs=needs,
            versions=versions_here(),
            idle_s=self.settings.idle_s,
            minutes=self.settings.minutes_per_job,
            stores=stores,
        )

    def _recordings(self, recipe_file: Path | None, keys: Sequence[str]) -> list[RecordingFiles]:
        """Return those of some recordings of a project that are there."""
        recipe = self._read(recipe_file)
        if not keys or recipe is None or recipe_file is None:
            return []
        with self._mutex:
            looked_at, found = self._found.get(recipe_file, (-_LOOK_S, {}))
            age_s = time.monotonic() - looked_at
            # Runs of new recordings come soon after these; hundreds of runs come in a row.
            if age_s > _LOOK_S or (age_s > _LOOK_LEAST_S and any(key not in found for key in keys)):
                found = discover(recipe.bags).recordings if recipe.bags.root.is_dir() else {}
                self._found[recipe_file] = time.monotonic(), found
        return [found[key] for key in keys if key in found]

    def _read(self, file: Path | None) -> Recipe | None:
        """Return a recipe, read again when it has changed: hundreds of runs may be launched in a row."""
        if file is None:
            return None
        with self._mutex:
            changed_ns = file.stat().st_mtime_ns if file.exists() else 0
            if file not in self._recipes or self._recipes[file][0] != changed_ns:
                self._recipes[file] = changed_ns, load_recipe(file)
            return self._recipes[file][1]

    @property
    def _state(self) -> Path:
        recipe = self._read(self._recipe_file)
        return recipe.state if recipe is not None else Path(self._instance.root_directory)

    @property
    def _spool(self) -> Spool:
        folder = self.settings.folder
        return Spool(Path(folder).absolute() if folder else self._state.absolute() / "slurm")

    # --- care ------------------------------------------------------------------------

    @property
    def _keeper(self) -> Keeper:
        with self._mutex:
            if self._keeper_made is None:
                asked = self.settings
                packing = Packing(asked.runs_per_job, asked.minutes_per_job, asked.gather_s)
                give_up_s = asked.give_up_minutes * 60.0
                self._keeper_made = Keeper(self._instance, self._spool, packing, give_up_s, asked.keep_days)
            return self._keeper_made

    def _care(self) -> None:
        """See to it that a thread cares for the runs."""
        with self._mutex:
            if self._thread is None and not self._closing.is_set():
                self._thread = threading.Thread(target=self._keep, name="slurm", daemon=True)
                self._thread.start()

    def _keep(self) -> None:
        settled_at = -_QUIET_S
        while not self._closing.wait(_BUSY_S):
            try:
                is_left = self._keeper.submit()
                if time.monotonic() - settled_at > _QUIET_S:
                    is_left = self._keeper.tend() or is_left
                    settled_at = time.monotonic()
                else:
                    is_left = True
            except Exception:  # noqa: BLE001  (whatever it is, the other runs need care as well)
                _LOG.exception("Slurm: the care for runs met an error, and goes on")
                self._closing.wait(_QUIET_S)
                continue
            with self._mutex:
                if not is_left and not self._spool.waiting():
                    self._thread = None
                    return

    def end_lost_runs(self) -> list[str]:
        """Report runs whose jobs have ended, and return their ids.

        Runs that go on are cared for from now on.
        """
        keeper = self._keeper
        before = {run.run_id for run in self._unfinished()}
        if not before:
            return []
        if keeper.tend():
            self._care()
        for record in self._instance.get_run_records(dg.RunsFilter(run_ids=list(before))):
            run = record.dagster_run
            waited_s = time.time() - record.update_timestamp.timestamp()
            if run.is_finished or run.status == dg.DagsterRunStatus.STARTED or waited_s < UNTAKEN_S:
                continue
            if not self._spool.is_waiting(run.run_id) and self._spool.job_of(run.run_id) is None:
                report_ended(
                    self._instance,
                    run.run_id,
                    "The process that was about to hand this run to Slurm is gone.",
                )
        return sorted(before - {run.run_id for run in self._unfinished()})

    def waiting_runs(self) -> set[str]:
        """Return the runs that wait for a job, or have one that has not been settled."""
        found = {run.run_id for run in self._spool.waiting()}
        for job in self._spool.jobs():
            found.update(job.runs(), job.begun())
        return found

    def _unfinished(self) -> list[dg.DagsterRun]:
        return list(self._instance.get_runs(dg.RunsFilter(statuses=UNFINISHED)))

    # --- ending ----------------------------------------------------------------------

    def terminate(self, run_id: str) -> bool:
        """Cancel a run, whether it waits or is at work; return False if no job of ours has it."""
        run = self._instance.get_run_by_id(run_id)
        if run is None or run.is_finished:
            return False
        job = self._spool.job_of(run_id)
        if self._spool.withdraw(run_id) or (job is not None and self._spool.drop(job, run_id)):
            self._instance.report_run_canceling(run)
            self._instance.report_run_canceled(run, "The run was cancelled before a job began it.")
            self._care()  # cancels the job, if no other run is left
            return True
        job = job or self._spool.job_of(run_id)
        if job is None:
            return self._refuse_to_cancel(run, "no job of Slurm has it")
        if mark_canceling(self._instance, run):
            job.ask_to_cancel(run_id)
        self._care()
        return True

    # --- health ----------------------------------------------------------------------

    def check_run_worker_health(self, run: dg.DagsterRun) -> CheckRunHealthResult:
        """Return whether the job of a run is alive; a run that waits for one is healthy.

        A run without a job of ours counts as running, since run monitoring fails every run with another status.
        """
        self._care()
        running = partial(CheckRunHealthResult, WorkerStatus.RUNNING)
        if self._spool.is_waiting(run.run_id):
            return running("It waits for a job.")
        job = self._spool.job_of(run.run_id)
        if job is None:
            current = self._instance.get_run_by_id(run.run_id)
            if current is not None and current.is_finished:
                return CheckRunHealthResult(WorkerStatus.SUCCESS, "It has ended.")
            return running("Executed by another program, which monitors it.")
        noted = job.submitted()
        if noted is None:
            return running("Its job is being submitted.")
        try:
            status, words = self._keeper.health(job, noted)
        except SlurmError as err:
            # No reason to fail it: the job goes on without the controller.
            return running(f"Slurm does not answer: {err}", run_worker_id=noted["job"])
        return CheckRunHealthResult(status, words, run_worker_id=noted["job"])

    def get_run_worker_debug_info(
        self, run: dg.DagsterRun, include_container_logs: bool | None = True
    ) -> str | None:
        """Return where the run is or was, and the last lines of its job's log."""
        place, log = run.tags.get(WHERE_TAG), run.tags.get(LOG_TAG)
        said = last_words(Path(log)) if include_container_logs and log else ""
        return "\n".join(filter(None, [place and f"{place}.", said])) or None


def _recordings_of(run: dg.DagsterRun) -> Sequence[str]:
    """Return the partition keys that a run is about; none if it is about a dataset."""
    if PARTITION_TAG in run.tags:
        return [run.tags[PARTITION_TAG]]
    return [key for key in batch_of(run) if key != DATASET]
