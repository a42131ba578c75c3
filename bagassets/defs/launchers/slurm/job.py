"""A job on its node: imports what runs share, once, and forks a worker for each of its runs.

`python -m bagassets.defs.launchers.slurm.job FOLDER`, in the batch script. No more runs are at work side by side than the job has
cpus. With none left it waits for more, for some seconds: the dataset follows its last recording, and another job would
have to import everything once more. When Slurm ends the job (a time limit, `scancel`, a job with a higher priority), the workers are killed: why, only
Slurm can say, and `keeper` asks it.
"""

import gc
import logging
import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from bagassets.base.json_types import JsonObject
from bagassets.defs.launchers.slurm.node import problem_of_node
from bagassets.defs.launchers.slurm.options import JOB_TAG, LOG_TAG, NODE_TAG
from bagassets.defs.launchers.slurm.spool import JobFolder, JobSpec, SpooledRun
from bagassets.defs.runs.worker_tag import WHERE_TAG
from bagassets.forkserver.job import Job
from bagassets.forkserver.worker import load_function

_LOG = logging.getLogger("bagassets.slurm")
_LOOK_S = 1.0
_IDLE_LOOK_S = 0.2
_GRACE_S = 30.0
_WORKER = "bagassets.defs.launchers.run_worker"
_ENDS = {signal.SIGTERM, signal.SIGINT}
_SIGNALS = {*_ENDS, signal.SIGCHLD}


def main(arguments: list[str]) -> int:
    """Execute the runs of a job."""
    logging.basicConfig(format="%(asctime)s %(name)s: %(message)s", level=logging.WARNING)
    logging.getLogger("bagassets").setLevel(logging.INFO)
    node = os.environ.get("SLURMD_NODENAME", "")
    folder = JobFolder(Path(arguments[0]))
    if not folder.is_open:
        _LOG.error("node %s does not see %s, or the job was given up", node, folder.path)
        return 1
    spec = folder.spec()
    problem = problem_of_node(spec, node, (size for run in folder.queue() for size in run.sizes.items()))
    if problem is not None:
        _LOG.error("%s", problem)
        folder.note_problem(problem)
        return 1
    os.environ.update(spec.environment)
    sys.path[:0] = [path for path in spec.paths if path not in sys.path]
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    began = time.monotonic()
    gc.disable()  # imports leave nothing to collect
    later = load_function(f"{_WORKER}:preload")(spec.modules) or iter(())
    gc.freeze()
    gc.enable()
    _LOG.info("node %s: ready after %.1f s", node, time.monotonic() - began)
    return _Workers(folder, spec, node, later).work()


class _Workers:
    """The workers of the job.

    Args:
        folder: the job's folder.
        spec: what its runs need.
        node: name of this node.
        later: steps that make workers faster, and can wait.
    """

    def __init__(self, folder: JobFolder, spec: JobSpec, node: str, later: Iterator[None]) -> None:
        self._folder = folder
        self._spec = spec
        self._later: Iterator[None] | None = later
        self._cpus = int(os.environ.get("SLURM_CPUS_PER_TASK") or os.environ.get("SLURM_CPUS_ON_NODE") or 1)
        job = os.environ.get("SLURM_JOB_ID", "")
        self._tags = {
            JOB_TAG: job,
            NODE_TAG: node,
            LOG_TAG: str(folder.log),
            WHERE_TAG: f"Slurm job {job} on {node}",
        }
        self._began = time.monotonic()
        # Worker -> its run; None if it reports that one was lost.
        self._jobs: dict[Job, SpooledRun | None] = {}
        self._count = 0

    @property
    def _is_full(self) -> bool:
        return sum(run is not None for run in self._jobs.values()) >= self._cpus

    def work(self) -> int:
        """Execute all runs; return the exit code."""
        queue = self._folder.queue()[::-1]
        looked_at = busy_at = time.monotonic()
        while True:
            while queue and not self._is_full:
                run = self._folder.take(queue.pop().run_id)
                if run is not None:
                    self._start(run)
            if not queue and not self._is_full and self._spec.idle_s:
                # One that came later than this job, and would otherwise wait for another.
                left_s = self._spec.minutes * 60.0 - (time.monotonic() - self._began)
                later = self._folder.take_waiting(left_s)
                if later is not None:
                    self._start(later)
            if queue or self._jobs:
                busy_at = time.monotonic()
            elif time.monotonic() - busy_at >= self._spec.idle_s:
                return 0
            if self._wait(_LOOK_S if self._is_full else _IDLE_LOOK_S) in _ENDS:
                return self._stop()
            if time.monotonic() - looked_at > _LOOK_S:
                looked_at = time.monotonic()
                if not self._folder.is_open:
                    _LOG.error("the job was given up; its runs are reported as failed")
                    return self._stop()
                self._cancel()
            self._collect()

    def _wait(self, longest_s: float) -> signal.Signals | None:
        """Wait until a worker ends or a signal comes, or use the time for what can wait."""
        found = signal.sigtimedwait(_SIGNALS, 0.0 if self._later is not None else longest_s)
        if found is None and self._later is not None:
            try:
                next(self._later)
            except StopIteration:
                self._later = None
            except Exception:  # noqa: BLE001  (modules of users may raise anything)
                _LOG.exception("a step of the preparation failed; workers do without")
                self._later = None
        return None if found is None else signal.Signals(found.si_signo)

    def _start(self, run: SpooledRun) -> None:
        args: JsonObject = {
            "instance": self._spec.instance,
            "run_id": run.run_id,
            "locks": self._spec.locks,
            "tags": self._tags,
        }
        self._fork("execute", run.run_id, args, run)

    def _fork(self, function: str, label: str, args: JsonObject, run: SpooledRun | None = None) -> None:
        self._count += 1
        request = {
            "function": f"{_WORKER}:{function}",
            "args": args,
            "label": label,
            "env": dict(os.environ),
            "cwd": self._spec.cwd,
        }
        job = Job.start(f"{os.getpid()}-{self._count}", request, self._folder.log, self._close_inherited)
        _LOG.info("run %s: %s in process %d", label, function, job.process.pid)
        self._jobs[job] = run

    def _close_inherited(self) -> None:
        for job in self._jobs:
            job.channel.close()

    def _cancel(self) -> None:
        wanted = set(self._folder.to_cancel())
        for job, run in self._jobs.items():
            if run is not None and run.run_id in wanted:
                job.cancel(_GRACE_S, signal.SIGINT)
            if job.kill_at is not None and time.monotonic() >= job.kill_at:
                job.kill()

    def _collect(self) -> None:
        for job, run in list(self._jobs.items()):
            event = _ended(job)
            if event is None:
                continue
            del self._jobs[job]
            if run is None:
                continue
            self._folder.note_seconds(run, time.monotonic() - job.started)
            if event["event"] == "killed" or event["exit"] != 0:
                reason = event.get("reason") or event["error"]["message"]
                _LOG.info("run %s: %s", run.run_id, reason)
                args = {"args": job.request["args"], "notes": job.notes, "reason": reason}
                self._fork("report_lost", run.run_id, args)

    def _stop(self) -> int:
        for job in self._jobs:
            job.kill()
        return 128 + signal.SIGTERM


def _ended(job: Job) -> JsonObject | None:
    """Return how a worker ended; None if it works."""
    job.listen()
    status = job.collect()
    if status is None:
        return None
    job.lines.is_drained = False
    while not (job.lines.is_closed or job.lines.is_drained):
        job.listen()
    job.channel.close()
    return job.describe_end(status)


if __name__ == "__main__":
    exit_code = main(sys.argv[1:])
    logging.shutdown()
    os._exit(exit_code)  # what libraries do at the end takes time, and fills the log
