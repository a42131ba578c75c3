"""A fence around what runs record and publish: a run that has ended does so no more.

A cluster may declare a node dead on which a worker is still at work, or frozen. Its run is reported as failed, and a retry
begins: two workers then have the same recording, and the first of them must not record what the second one has made
obsolete. Asking and recording are two moments, so the plan ignores such records as well (`events`), and the store
keeps the artifact of the first writer.
"""

import time
from dataclasses import dataclass, field

import dagster as dg

from bagassets.base.errors import RunEndedError

# Before a run is given up, nothing is heard of its worker for many seconds: no need to ask for each record.
_ALIVE_S = 2.0
# It goes on while the process, or the machine, is stopped.
_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)


@dataclass
class Fence:
    """The fence of a run, in its worker.

    Attributes:
        instance: has the run.
        run_id: the run.
        known_open_s: when it was last known not to have ended, on the clock of `check`; default: now.
    """

    instance: dg.DagsterInstance
    run_id: str
    known_open_s: float = field(default_factory=lambda: time.clock_gettime(_CLOCK))

    def check(self) -> None:
        """Refuse to record something if the run was given up; the database is asked every few seconds at most.

        Raises:
            RunEndedError: it was.
        """
        now_s = time.clock_gettime(_CLOCK)
        if now_s - self.known_open_s > _ALIVE_S:
            refuse_if_ended(self.instance, self.run_id)
            self.known_open_s = now_s


def run_has_ended(instance: dg.DagsterInstance, run_id: str) -> bool:
    """Return whether a run is known to have ended, so that nobody need wait for what its worker holds."""
    run = instance.get_run_by_id(run_id)
    return run is not None and run.is_finished


def refuse_if_ended(instance: dg.DagsterInstance, run_id: str) -> None:
    """Refuse to record or publish for a run that was reported as ended, or deleted.

    Raises:
        RunEndedError: it was.
    """
    run = instance.get_run_by_id(run_id)
    if run is None or run.is_finished:
        how = "was deleted" if run is None else f"ended as {run.status.value}"
        raise RunEndedError(
            f"run {run_id} {how} while its worker was still at work, so the worker records and publishes nothing more."
        )
