"""A pool of runs on the run launcher of the instance: launches a limited number at a time and follows each to its end.

`dagster.yaml` names the launcher, and the launcher alone decides where a run is executed. How a run ended is read from
Dagster's own records, so it makes no difference who executed it.
"""

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self
from uuid import uuid4

import dagster as dg

from bagassets.base.errors import BagAssetsError
from bagassets.base.interrupts import deferred_interrupts
from bagassets.base.trace import span
from bagassets.defs.records.batches import batch_config
from bagassets.defs.records.databases import database_errors_explained
from bagassets.defs.records.events import Records
from bagassets.defs.runs.code_server import LaunchWorkspace
from bagassets.defs.runs.execution import CodeLocation, create_job_run, create_run, fail_if_lost, failure_of
from bagassets.defs.runs.launching import launching_of
from bagassets.defs.runs.run_progress import RunProgress
from bagassets.defs.runs.worker_tag import WHERE_TAG
from bagassets.engine.batches import DATASET, Batch
from bagassets.engine.build_report import Event

_CANCEL_GRACE_S = 35.0  # our own launcher kills after 30 s, and the command waits for 40 s
_HEALTH_S = 5.0
# The end of a run is noticed late by at most 3 % of its duration. To read the records takes some milliseconds.
_QUICKEST_S, _SLOWEST_S = 0.03, 0.5
_POLL_SHARE = 0.03
_LOG_S, _LOG_OF_SEVERAL_S = 2.0, 0.5
_FEW = 20  # active runs that are all read each time
_MOST_THREADS = 32
_ENDED = [dg.DagsterRunStatus.SUCCESS, dg.DagsterRunStatus.FAILURE, dg.DagsterRunStatus.CANCELED]

Listener = Callable[[Event], None]


@dataclass(frozen=True)
class EndedRun:
    """How one run ended: its id, why it failed (None if it succeeded), whether it was stopped, whether it made anything (if known)."""

    run_id: str
    problem: str | None
    stopped: bool
    seconds: float
    has_made: bool | None = None


@dataclass
class _Active:
    """A run that has not ended.

    Attributes:
        batch: partition key -> assets; the key of unpartitioned assets is empty.
        launch: the call of the launcher.
        since: when it was created (monotonic clock).
        checked_at: when its health was last checked (monotonic clock).
        is_ours: False if an earlier build launched it.
        where: where it waits or is executed, if its launcher says so.
        progress: what its log says of its recordings.
        read_at: when its log was last read (monotonic clock).
        has_steps: it has a step for each asset; else its log says what became of its recordings.
    """

    batch: Batch
    launch: "Future[dg.DagsterRun] | Future[dg.DagsterRun | None]"
    since: float
    checked_at: float
    is_ours: bool = True
    where: str = ""
    progress: RunProgress = field(default_factory=RunProgress)
    read_at: float = 0.0
    has_steps: bool = True


@dataclass
class RunPool:
    """Launches runs, at most `jobs` at the same time; a context manager.

    Attributes:
        records: of the project whose assets are made, in the instance whose launcher executes the runs.
        jobs: most runs at the same time, unless they wait in a queue of the launcher's own (`most_at_once`).
        on_event: called when a run begins and when it ends.
        log: log file of the code server, if the launcher needs one.
        location: code location of the assets.
        key_of: how the keys of assets are made from their names; default: below the prefix of the project.
        tags: partition key -> further tags of its run.
        ended: partition key -> how its run ended; the key of unpartitioned assets is empty.
        interrupted: the user pressed Ctrl-C.
    """

    records: Records
    jobs: int
    on_event: Listener
    log: Path
    location: CodeLocation = field(default_factory=CodeLocation)
    key_of: Callable[[str], dg.AssetKey] | None = None
    tags: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    ended: dict[str, EndedRun] = field(default_factory=dict)
    interrupted: bool = False
    _without_steps: Collection[str] = ()
    _waiting: list[Batch] = field(default_factory=list)
    _active: dict[str, _Active] = field(default_factory=dict)
    _looked_at: float = 0.0

    def __post_init__(self) -> None:
        self.instance, self.names = self.records.instance, self.records.names
        self.jobs = launching_of(self.instance).most_at_once or self.jobs
        self._key_of = self.key_of or self.names.key
        # Below a prefix, steps of assets are run by whatever executor the location names, perhaps a process each.
        self._is_by_job = self.key_of is None and bool(self.names.prefix)
        # One for all runs: a code server takes seconds to start.
        self._workspace = LaunchWorkspace(self.instance, self.location, self.log)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._workspace.close()

    def work(
        self,
        batches: Sequence[Batch],
        following: Mapping[str, Sequence[str]] | None = None,
        without_steps: Collection[str] = (),
    ) -> None:
        """Launch a run for each batch.

        An interrupt cancels the runs and waits for them to end; a second interrupt does not wait.

        Args:
            batches: partition key -> assets, for each run; the key of unpartitioned assets is empty.
            following: run of an earlier build -> partition keys; it is followed to its end and never cancelled.
            without_steps: recordings whose run has no step for each asset.
        """
        self._without_steps = without_steps
        for run_id, keys in (following or {}).items():
            self._take_over(run_id, keys)
        self._waiting = list(batches)[::-1]
        # Some launchers take most of a second for each run.
        with (
            ThreadPoolExecutor(min(self.jobs, _MOST_THREADS)) as pool,
            deferred_interrupts() as interrupt,
        ):
            while (self._waiting or self._active) and not interrupt.asked:
                polled_at = time.monotonic()
                while self._waiting and len(self._active) < self.jobs and not interrupt.asked:
                    self._start(self._waiting.pop(), pool)
                    if time.monotonic() - polled_at > _HEALTH_S:
                        break
                self._poll()
            if interrupt.asked:
                self.interrupted = True
                for active in self._active.values():
                    active.launch.cancel()
                self._stop()
                for key in (key for batch in self._waiting for key in batch):
                    self.ended.setdefault(key, EndedRun("", None, stopped=True, seconds=0.0))

    def _take_over(self, run_id: str, keys: Sequence[str]) -> None:
        launch: Future[dg.DagsterRun | None] = Future()
        launch.set_result(None)
        now = time.monotonic()
        self._active[run_id] = _Active(
            dict.fromkeys(keys, ()), launch, now, now, is_ours=False, has_steps=False
        )
        if len(keys) == 1:
            self.on_event(Event("started", keys[0]))

    def _start(self, batch: Batch, pool: ThreadPoolExecutor) -> None:
        began, run_id = time.monotonic(), str(uuid4())
        key, is_alone = next(iter(batch)), len(batch) == 1
        has_steps = is_alone and key not in self._without_steps and not self._is_by_job
        try:
            with span("create run", bags=list(batch)):
                if has_steps:
                    create_run(
                        self.instance,
                        [self._key_of(asset) for asset in batch[key]],
                        partition_key=key or None,
                        tags=self.tags.get(key),
                        location=self.location,
                        run_id=run_id,
                    )
                else:
                    create_job_run(
                        self.instance,
                        self.names.batch_job,
                        batch_config(batch, self.names),
                        location=self.location,
                        run_id=run_id,
                    )
        except BagAssetsError as err:  # a recording that was removed meanwhile
            for one in batch:
                self._conclude(one, EndedRun("", str(err), stopped=False, seconds=0.0))
            return
        launch = pool.submit(self._launch, run_id)
        self._active[run_id] = _Active(batch, launch, began, began, has_steps=has_steps)
        if is_alone:
            self.on_event(Event("started", key))

    def _launch(self, run_id: str) -> dg.DagsterRun:
        with database_errors_explained(self.instance.root_directory):
            return self.instance.launch_run(run_id, self._workspace.for_launcher())

    def _poll(self) -> None:
        """Wait a little, then conclude the runs that have ended."""
        if not self._active:
            return
        now = time.monotonic()
        youngest = min(now - active.since for active in self._active.values())
        time.sleep(min(_SLOWEST_S, max(_QUICKEST_S, _POLL_SHARE * youngest)))
        self._read()

    def _read(self) -> None:
        """Read the records of the active runs, and conclude those that have ended."""
        now = time.monotonic()
        is_whole = len(self._active) <= _FEW or now - self._looked_at > _HEALTH_S
        wanted = dg.RunsFilter(run_ids=list(self._active), statuses=None if is_whole else _ENDED)
        records = {run.run_id: run for run in self.instance.get_runs(wanted)}
        self._looked_at = now if is_whole else self._looked_at
        for run_id, active in list(self._active.items()):
            if not active.launch.done():
                continue
            run = records.get(run_id)
            # The log of a run about one recording says something only if that takes long, and in the end.
            log_s = _LOG_OF_SEVERAL_S if len(active.batch) > 1 and not active.has_steps else _LOG_S
            is_over = run is not None and run.is_finished and not active.has_steps
            if is_over or min(now - active.since, now - active.read_at) > log_s:
                active.read_at = now
                self._follow(run_id, active)
            if run is None:
                if is_whole:
                    self._drop(run_id, "its run was deleted before it ended")
            elif run.is_finished:
                self._drop(run_id, self._problem(run, active))
            elif not active.launch.cancelled() and active.launch.exception() is not None:
                # Dagster has noted that itself by now, unless it was the database that failed.
                noted = self.instance.get_run_by_id(run_id)
                if noted is not None and not noted.is_finished:
                    self.instance.report_run_failed(noted)
                self._drop(run_id, self._problem(run, active))
            else:
                self._look_at(run, active)

    def _look_at(self, run: dg.DagsterRun, active: _Active) -> None:
        """Tell where a run is, and now and then check whether its worker is alive."""
        where = run.tags.get(WHERE_TAG, "")
        if where != active.where:
            active.where = where
            for key in active.batch.keys() - active.progress.ended.keys():
                self.on_event(Event("where", key, where))
        if time.monotonic() - active.checked_at > _HEALTH_S:
            active.checked_at = time.monotonic()
            fail_if_lost(self.instance, run)

    def _problem(self, run: dg.DagsterRun, active: _Active) -> str | None:
        """Return why a run failed, or None if it succeeded."""
        if run.is_success:
            return None
        refused = None if active.launch.cancelled() else active.launch.exception()
        if refused is not None:
            return f"its run could not be launched: {refused}"
        return failure_of(self.instance, run) or f"run {run.run_id} ended {run.status.value}"

    def _follow(self, run_id: str, active: _Active) -> None:
        """Report what a run about several recordings has begun and ended."""
        for key, has_ended in active.progress.read(self.instance, run_id):
            if has_ended:
                problem, seconds, has_made = active.progress.ended[key]
                self._conclude(key, EndedRun(run_id, problem, False, seconds, has_made))
            elif len(active.batch) > 1:  # of one alone it was said when its run was launched
                self.on_event(Event("started", key))
        for key, (text, share) in active.progress.reading.items():
            if key not in active.progress.ended:
                said = f"{active.where}: {text}" if active.where else text
                self.on_event(Event("where", key, said, share=share))
        active.progress.reading.clear()

    def _drop(self, run_id: str, problem: str | None) -> None:
        active = self._active.pop(run_id)
        stopped = problem is not None and self.interrupted
        run = self.instance.get_run_by_id(run_id) if problem is not None and active.is_ours else None
        has_failed = run is not None and run.status == dg.DagsterRunStatus.FAILURE
        if run is not None and has_failed and stopped:
            # Dagster's own launcher reports a failure of a run that we cancelled if it was only starting.
            self.instance.report_run_canceled(run, "The build that launched it was interrupted.")
        begun, ended = active.progress.begun, active.progress.ended
        left = {key: assets for key, assets in active.batch.items() if key not in begun and key != DATASET}
        if begun and left and has_failed and not stopped:
            # Its worker died with one recording, which failed; the others get another run.
            self._waiting.append(left)
        else:
            left = {}
        seconds = time.monotonic() - active.since
        unfinished = active.batch.keys() - ended.keys() - left.keys()
        if len(active.batch) > 1 and DATASET not in begun:
            unfinished -= {DATASET}  # the recordings failed, and the datasets are yet to be made without them
        for key in unfinished:
            self._conclude(key, EndedRun(run_id, problem, stopped, seconds))

    def _conclude(self, key: str, ended: EndedRun) -> None:
        self.ended[key] = ended
        if ended.stopped:
            self.on_event(Event("stopped", key))
        elif ended.problem is not None:
            self.on_event(Event("failed", key, ended.problem))
        else:
            self.on_event(Event("done", key))

    def _stop(self) -> None:
        """Cancel the active runs and wait for them to end."""
        asked: set[str] = set()
        deadline = time.monotonic() + _CANCEL_GRACE_S
        while self._active and time.monotonic() < deadline:
            for run_id, active in list(self._active.items()):
                if not active.is_ours:
                    self._drop(run_id, "an earlier build launched it, and it goes on")
                    continue
                if run_id in asked or not active.launch.done():
                    continue
                asked.add(run_id)
                if active.launch.cancelled():  # it was still waiting to be launched
                    run = self.instance.get_run_by_id(run_id)
                    if run is not None:
                        self.instance.report_run_canceled(
                            run, "The build was interrupted before it was launched."
                        )
                    continue
                # If the launcher refuses, the other runs still have to be cancelled.
                with suppress(Exception):
                    self.instance.run_launcher.terminate(run_id)
            self._poll()
        for run_id in list(self._active):
            self._drop(run_id, f"run {run_id} did not stop within {_CANCEL_GRACE_S:.0f} s")
