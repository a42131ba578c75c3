"""Care for the runs in a spool: submits those that wait, and settles jobs that have ended.

Any number of processes may do so at the same time: the daemon, the web server, builds. All that they know is in the
spool, in Dagster's records and in Slurm, so one carries on where another has died.
"""

import getpass
import json
import logging
import shlex
import sys
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import dagster as dg

from bagassets.base.json_types import JsonObject
from bagassets.defs.dagster_private import WorkerStatus
from bagassets.defs.launchers.slurm.commands import JobState, SlurmError, cancel_job, job_states, submit_job
from bagassets.defs.launchers.slurm.options import JOB_TAG, LOG_TAG, NODE_TAG, JobOptions
from bagassets.defs.launchers.slurm.spool import JobFolder, Spool, SpooledRun
from bagassets.defs.records.events import runs_of
from bagassets.defs.runs.launching import last_words
from bagassets.defs.runs.orphaned_runs import report_ended
from bagassets.defs.runs.worker_tag import WHERE_TAG

_LOG = logging.getLogger(__name__)
# A job that Slurm does not know, and that left no record: the file system may show it late.
_FORGOTTEN_S = 15.0
# A job that left a record, but that Slurm still takes for running: its state says more.
_RECORDED_S = 30.0
_LINGERS_S = 45.0  # longer than a cancelled worker may take to end
_ABANDONED_S = 180.0  # a folder that somebody made and did not submit
_MOST_TRIES = 5
_FRESH_S = 1.0  # run monitoring asks for each run; Slurm is asked for all jobs at once
_PLACE_S = 10.0
_PACE_S, _PACE_LEAST_S = 60.0, 10.0
# Runs that such a job had not begun are submitted again; in all other cases they would meet the same end.
_TRY_AGAIN = {"COMPLETED", "NODE_FAIL", "PREEMPTED", "TIMEOUT", "OUT_OF_MEMORY", "BOOT_FAIL"}


@dataclass(frozen=True)
class Packing:
    """How many runs go into one job.

    Attributes:
        runs: a job is full with so many; one of several recordings counts as so many.
        minutes: a job is full when its runs may take so long, side by side on its cpus.
        gather_s: how long the first runs wait for more.
    """

    runs: int
    minutes: float
    gather_s: float

    def jobs(
        self, waiting: Iterable[SpooledRun], *, pace: float = 1.0, now: float | None = None
    ) -> list[list[SpooledRun]]:
        """Return the runs of each job that is to be submitted.

        Args:
            waiting: the runs that wait, the oldest first.
            pace: how much longer runs take than they are expected to.
            now: the time, in Unix seconds; None not to wait for more runs.
        """
        groups: dict[str, list[SpooledRun]] = {}
        for run in waiting:
            groups.setdefault(json.dumps(asdict(run.spec), sort_keys=True), []).append(run)
        return [job for group in groups.values() for job in self._packed(group, pace, now)]

    def _packed(self, group: list[SpooledRun], pace: float, now: float | None) -> list[list[SpooledRun]]:
        cpus = max(1, int(group[0].spec.options.get("cpus", 1)))
        jobs: list[list[SpooledRun]] = []
        full = True
        for run in group:
            if full:
                jobs.append([])
            jobs[-1].append(run)
            seconds = pace * sum(one.seconds for one in jobs[-1]) / cpus
            full = sum(one.recordings for one in jobs[-1]) >= self.runs or seconds >= self.minutes * 60.0
        if not full and now is not None:
            # As long as more keep coming, but not for ever.
            first, last = jobs[-1][0].since, jobs[-1][-1].since
            if now - last < self.gather_s and now - first < 10 * self.gather_s:
                jobs.pop()
        return jobs


@dataclass(eq=False)
class Keeper:
    """Cares for one spool.

    Attributes:
        instance: where the runs are recorded.
        spool: their files.
        packing: how many go into one job.
        give_up_s: how long to try to submit runs while Slurm does not answer.
        keep_days: how long logs and records of ended jobs are kept.
    """

    instance: dg.DagsterInstance
    spool: Spool
    packing: Packing
    give_up_s: float
    keep_days: float
    # Job -> since when Slurm and its record disagree, and since when all its runs have ended.
    _odd_since: dict[str, float] = field(default_factory=dict)
    _idle_since: dict[str, float] = field(default_factory=dict)
    _placed: dict[str, tuple[float, str]] = field(default_factory=dict)
    _waits_until: float = 0.0
    _told: set[str] = field(default_factory=set)
    _pace: tuple[float, float] = (-_PACE_S, 1.0)
    _asked: tuple[float, set[str], dict[str, JobState]] = (-_FRESH_S, set(), {})

    def tend(self, *, flush: bool = False) -> bool:
        """Submit what waits, settle what has ended; return whether anything is left.

        Args:
            flush: True not to wait for more runs that might share a job.
        """
        is_left = self.submit(flush=flush)
        try:
            return self.settle() or is_left
        except SlurmError as err:
            _LOG.warning("Slurm does not tell the states of jobs: %s", err)
            return True

    def _pace_of_late(self) -> float:
        """Return how much longer runs took of late than expected."""
        now = time.monotonic()
        if now - self._pace[0] > _PACE_S:
            pairs = list(self.spool.durations())
            expected, took = sum(pair[0] for pair in pairs), sum(pair[1] for pair in pairs)
            # A few short runs say little.
            factor = took / expected if expected > 0.0 and took > _PACE_LEAST_S else 1.0
            self._pace = now, min(10.0, max(0.1, factor))
        return self._pace[1]

    def health(self, job: JobFolder, submitted: JsonObject) -> tuple[WorkerStatus, str]:
        """Return whether a job is alive, and a description of its state.

        Raises:
            SlurmError: Slurm does not answer.
        """
        state = self._states({submitted["user"]}).get(submitted["job"])
        if self._is_over(job, state):
            return WorkerStatus.FAILED, self._reason(job, submitted["job"], state)[0]
        return WorkerStatus.RUNNING, f"{state or 'its end is being looked into'}."

    # --- submitting ---

    def submit(self, *, flush: bool = False) -> bool:
        """Submit the runs that wait; return whether some still do."""
        waiting = self.spool.waiting()
        if time.monotonic() < self._waits_until:
            return bool(waiting)
        for runs in self.packing.jobs(waiting, pace=self._pace_of_late(), now=None if flush else time.time()):
            job, got = self.spool.new_job(runs)
            wanted = self._still_wanted(job, got)
            if not wanted:
                self.spool.settle(job)
                continue
            if not self._submit(job, wanted):
                break
        return bool(waiting)

    def _still_wanted(self, job: JobFolder, runs: list[SpooledRun]) -> list[SpooledRun]:
        """Return the runs of a job that have not ended; drop the others."""
        ended = {
            run.run_id for run in runs_of(self.instance, (one.run_id for one in runs)) if run.is_finished
        }
        for run_id in ended:
            self.spool.drop(job, run_id)
        return [run for run in runs if run.run_id not in ended]

    def _submit(self, job: JobFolder, runs: list[SpooledRun]) -> bool:
        """Submit a job; return False if Slurm takes none at present."""
        spec = runs[0].spec
        options = JobOptions.from_json(spec.options)
        log = str(job.log).replace("%", "%%")
        arguments = [
            *options.arguments(),
            *(f"--job-name=bagassets-{len(runs)}", f"--output={log}", "--open-mode=append"),
            *("--no-requeue", f"--chdir={spec.cwd}"),
        ]
        command = shlex.join(
            [spec.python or sys.executable, "-m", "bagassets.defs.launchers.slurm.job", str(job.path)]
        )
        try:
            job_id = submit_job(arguments, job.script(f"{options.prefix} {command}".strip()), Path(spec.cwd))
        except SlurmError as err:
            self._refused(job, runs, err)
            return not err.is_temporary
        job.note_submitted(job_id, getpass.getuser())
        place = str(JobState(job_id, "PENDING"))
        for run in runs:
            self.instance.add_run_tags(
                run.run_id, {JOB_TAG: job_id, NODE_TAG: "", LOG_TAG: str(job.log), WHERE_TAG: place}
            )
            self._told.discard(run.run_id)
        return True

    def _refused(self, job: JobFolder, runs: list[SpooledRun], err: SlurmError) -> None:
        for run in runs:
            waited_s = time.time() - run.since
            record = self.instance.get_run_by_id(run.run_id)
            if err.is_temporary and waited_s < self.give_up_s:
                if record is not None and run.run_id not in self._told:
                    self._told.add(run.run_id)
                    message = f"Slurm takes no job at present; tried again until it does, for {self.give_up_s:.0f} s at most: {err}"
                    self.instance.report_engine_event(message, dagster_run=record, cls=self.__class__)
                self.spool.take_back(job, run.run_id)
                continue
            if self.spool.drop(job, run.run_id):
                report_ended(self.instance, run.run_id, f"The run could not be submitted to Slurm: {err}")
        if err.is_temporary:
            self._waits_until = time.monotonic() + 5.0
        self.spool.settle(job)

    # --- settling ---

    def settle(self) -> bool:
        """Report the runs of jobs that have ended, and cancel jobs whose runs have; return whether jobs are left.

        Raises:
            SlurmError: Slurm does not answer.
        """
        jobs = self.spool.jobs()
        if not jobs:
            return False
        submitted = {job.name: job.submitted() for job in jobs}
        states = self._states({one["user"] for one in submitted.values() if one})
        is_left = False
        for job in jobs:
            noted = submitted[job.name]
            if noted is None:
                if job.is_open and job.age_s() > _ABANDONED_S:
                    self._end(job, "The process that was about to submit the job is gone.", try_again=True)
                is_left = True
                continue
            state = states.get(noted["job"])
            if self._is_over(job, state):
                self._odd_since.pop(job.name, None)
                reason, try_again = self._reason(job, noted["job"], state)
                self._end(job, reason, try_again=try_again)
            else:
                is_left = True
                self._look_after(job, noted["job"], state)
        return is_left

    def _states(self, users: set[str]) -> dict[str, JobState]:
        asked_at, found, states = self._asked
        if time.monotonic() - asked_at > _FRESH_S or not users <= found:
            states = job_states(users)
            self._asked = time.monotonic(), users, states
        return states

    def _is_over(self, job: JobFolder, state: JobState | None) -> bool:
        if state is not None and state.has_ended:
            return True
        ended = job.ended()
        if ended is not None and ended["code"] == 0:
            return True
        if state is not None and ended is None:
            return False
        since = self._odd_since.setdefault(job.name, time.monotonic())
        return time.monotonic() - since > (_FORGOTTEN_S if state is None else _RECORDED_S)

    def _reason(self, job: JobFolder, job_id: str, state: JobState | None) -> tuple[str, bool]:
        """Return why a job ended, and whether runs that it has not begun may be submitted again."""
        ended = job.ended()
        if ended is not None and ended.get("problem"):
            return str(ended["problem"]), False
        if state is not None and state.has_ended:
            unseen = state.state == "FAILED" and ended is None and not job.log.exists()
            why = f" It left neither a record nor a log in {job.path.parent.parent}, as when its node does not see this folder."
            return f"{state}.{why if unseen else ''}", state.state in _TRY_AGAIN
        if ended is not None:
            code, node = int(ended["code"]), ended["node"]
            how = "was ended by a signal" if code > 128 else f"ended with exit code {code}"
            return f"Slurm job {job_id} on {node} {how}; Slurm has forgotten why.", code == 0
        return (
            f"Slurm job {job_id} is gone: Slurm has forgotten it, and it left no record in {job.path}, as when its node "
            "lost power, or does not see this folder."
        ), True

    def _end(self, job: JobFolder, reason: str, *, try_again: bool) -> None:
        """Report what a job leaves, and put it aside."""
        if not try_again and (told := last_words(job.log)):
            reason = f"{reason}\n{told}"
        for run_id in job.runs():
            if not try_again:
                if self.spool.drop(job, run_id):
                    report_ended(self.instance, run_id, reason)
            elif (tries := self.spool.count_try(run_id)) < _MOST_TRIES:
                run = self.instance.get_run_by_id(run_id)
                if self.spool.take_back(job, run_id) and run is not None and not run.is_finished:
                    message = f"{reason} It had not begun this run, which is submitted again."
                    self.instance.report_engine_event(message, dagster_run=run, cls=self.__class__)
            elif self.spool.drop(job, run_id):
                report_ended(
                    self.instance, run_id, f"{tries} jobs ended before they began this run. {reason}"
                )
        # After those: what a job that still lives begins meanwhile is found here.
        for run_id in job.begun():
            report_ended(self.instance, run_id, reason)
        self.spool.settle(job)
        self.spool.remove_old(self.keep_days)

    def _look_after(self, job: JobFolder, job_id: str, state: JobState | None) -> None:
        """Cancel a job whose runs have all ended; else tell its runs where they are."""
        run_ids = [*job.runs(), *job.begun()]
        runs = runs_of(self.instance, run_ids)
        unfinished = [run for run in runs if not run.is_finished]
        if not unfinished:
            # One at work is about to end by itself.
            idle_s = time.monotonic() - self._idle_since.setdefault(job.name, time.monotonic())
            if state is None or state.is_pending or idle_s > _LINGERS_S:
                cancel_job(job_id)
            return
        self._idle_since.pop(job.name, None)
        if state is None:
            return
        seen_at, place = self._placed.get(job.name, (0.0, ""))
        if str(state) == place or (time.monotonic() - seen_at < _PLACE_S and state.is_pending):
            return
        self._placed[job.name] = time.monotonic(), str(state)
        for run in unfinished:
            if run.tags.get(WHERE_TAG) != str(state):
                self.instance.add_run_tags(run.run_id, {WHERE_TAG: str(state), NODE_TAG: state.node})
