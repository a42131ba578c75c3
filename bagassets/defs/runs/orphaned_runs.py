"""Orphaned runs, which nobody executes any more: reported as failed or cancelled so that nothing waits for them.

A run of ours is orphaned if

- its worker is gone, and so is the server that would have reported that; or
- no worker took it within `UNTAKEN_S` seconds after it was created, began to start or was handed over: the process
  that was about to launch it is gone. Launching takes two minutes at most, when a server has to be started twice.

Runs of other programs, machines and launchers are left to them; the launcher is asked to report its own (see `launching`).
"""

import json
import socket
import time

import dagster as dg

from bagassets.defs.dagster_private import GRPC_INFO_TAG
from bagassets.defs.runs.launching import launching_of
from bagassets.defs.runs.worker_tag import RunWorker

UNTAKEN_S = 300.0
_BEFORE_START = (dg.DagsterRunStatus.NOT_STARTED, dg.DagsterRunStatus.STARTING)
# Queued runs are not orphaned: the daemon launches them once it is back.
UNFINISHED = [*_BEFORE_START, dg.DagsterRunStatus.STARTED, dg.DagsterRunStatus.CANCELING]
_ANSWER_S = 2.0


def end_orphaned_runs(instance: dg.DagsterInstance) -> tuple[list[str], int]:
    """Report the orphaned runs of an instance.

    Returns:
        ids of the runs reported; number of runs that may yet be orphaned without anybody else noticing.
    """
    launching = launching_of(instance)
    reported, unwatched = launching.end_lost_runs(), 0
    for record in instance.get_run_records(dg.RunsFilter(statuses=UNFINISHED)):
        run = record.dagster_run
        worker = RunWorker.of(run)
        is_untaken = worker is None or (worker.process is None and worker.is_watched())
        if run.status in _BEFORE_START and is_untaken and launching.names_workers:
            waited_s = time.time() - record.update_timestamp.timestamp()
            if waited_s < UNTAKEN_S:
                unwatched += 1
                continue
            if not _has_other_executor(run):
                reason = f"No worker took this run within {UNTAKEN_S:.0f} s; the process that was about to launch it is gone."
                reported += [run.run_id] if report_ended(instance, run.run_id, reason) else []
                continue
        if worker is None or not worker.is_on_this_host or worker.is_watched():
            continue
        if worker.is_alive():
            unwatched += 1
            continue
        reason = f"The worker ({worker}) is gone, and so is the server that watched it."
        reported += [run.run_id] if report_ended(instance, run.run_id, reason) else []
    return reported, unwatched


def report_ended(instance: dg.DagsterInstance, run_id: str, reason: str) -> bool:
    """Report a run whose worker is gone as cancelled or failed; return False if it has already ended."""
    run = instance.get_run_by_id(run_id)
    if run is None or run.is_finished:
        return False
    if run.status == dg.DagsterRunStatus.CANCELING:
        instance.report_run_canceled(run, reason)
    else:
        instance.report_run_failed(run, reason)
    return True


def _has_other_executor(run: dg.DagsterRun) -> bool:
    """Return whether the run was left to Dagster's own launcher and its code server answers."""
    try:
        server = json.loads(run.tags[GRPC_INFO_TAG])
        place = server.get("socket") or (server["host"], server["port"])
        family = socket.AF_UNIX if isinstance(place, str) else socket.AF_INET
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.settimeout(_ANSWER_S)
            return probe.connect_ex(place) == 0
    except (KeyError, TypeError, ValueError, OSError):
        return False
