"""Slurm's commands, and what they answer."""

import re
import subprocess
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from bagassets.base.errors import BagAssetsError

_ANSWER_S = 60.0
# What the commands print when trying again later makes sense.
_TEMPORARY = (
    "unable to contact slurm controller",
    "connection refused",
    "timed out",
    "zero bytes were transmitted",
    "communication",
    "temporarily",
)
# Slurm says this of any limit of an account or QOS, and names the limit in a line before: too many jobs wait only for now,
# but a job that is too large or too long stays so.
_LIMIT, _LIMIT_NAME = "job submit limit", re.compile(r"\b(?:QOS|Assoc)\w+")
_FORMAT = "%i|%T|%r|%N"
_ENDS = {
    "BOOT_FAIL": "a node could not be started for it",
    "CANCELLED": "somebody cancelled it (scancel)",
    "COMPLETED": "it ended",
    "DEADLINE": "it could not end before its deadline",
    "FAILED": "its command failed",
    "NODE_FAIL": "its node failed",
    "OUT_OF_MEMORY": "it took more memory than it asked for",
    "PREEMPTED": "it was stopped in favour of a job with a higher priority",
    "REVOKED": "another cluster took it over",
    "TIMEOUT": "it reached its time limit",
}


class SlurmError(BagAssetsError):
    """A command of Slurm failed; the message has Slurm's own words.

    Attributes:
        is_temporary: True if it may succeed later.
    """

    def __init__(self, message: str, *, is_temporary: bool) -> None:
        super().__init__(message)
        self.is_temporary = is_temporary


@dataclass(frozen=True)
class JobState:
    """The state of a job.

    Attributes:
        job_id: its id.
        state: Slurm's word for it, such as PENDING.
        reason: why it is in this state, such as Resources; empty if there is none.
        node: where it runs or ran; empty while it waits.
    """

    job_id: str
    state: str
    reason: str = ""
    node: str = ""

    @property
    def has_ended(self) -> bool:
        """True if it will never run again."""
        return self.state in _ENDS

    @property
    def is_pending(self) -> bool:
        """True while it waits in Slurm's queue."""
        return self.state in {"PENDING", "CONFIGURING", "REQUEUED", "REQUEUE_HOLD", "RESV_DEL_HOLD"}

    def __str__(self) -> str:
        if self.has_ended:
            where = f" on {self.node}" if self.node else ""
            return f"Slurm job {self.job_id}{where} ended as {self.state}: {_ENDS[self.state]}"
        if self.is_pending:
            why = f" ({self.reason})" if self.reason else ""
            return f"Slurm job {self.job_id} is queued{why}"
        return f"Slurm job {self.job_id} on {self.node}"


def submit_job(arguments: Sequence[str], script: str, folder: Path) -> str:
    """Submit a script from a folder; return the id of the job.

    Raises:
        SlurmError: Slurm does not take it.
    """
    answer = _run(["sbatch", "--parsable", *arguments], folder=folder, given=script)
    return answer.strip().partition(";")[0]


def job_states(users: Collection[str]) -> dict[str, JobState]:
    """Return the state of each job of some users that Slurm still knows.

    Raises:
        SlurmError: Slurm does not answer.
    """
    if not users:
        return {}
    command = [
        "squeue",
        "--states=all",
        "--noheader",
        f"--user={','.join(sorted(users))}",
        f"--format={_FORMAT}",
    ]
    states = {}
    for line in _run(command).splitlines():
        job_id, state, reason, node = line.split("|", 3)
        states[job_id] = JobState(job_id, state, "" if reason == "None" else reason, node)
    return states


def cancel_job(job_id: str) -> None:
    """Cancel a job that waits or runs; one that has ended stays as it is.

    Raises:
        SlurmError: Slurm refuses, or does not answer.
    """
    _run(["scancel", job_id])


def _run(command: list[str], *, folder: Path | None = None, given: str | None = None) -> str:
    name = command[0]
    try:
        done = subprocess.run(
            command, cwd=folder, input=given, capture_output=True, text=True, check=False, timeout=_ANSWER_S
        )
    except FileNotFoundError as err:
        missing = name if err.filename == name else str(err.filename)
        raise SlurmError(
            f"{missing}: not found; install Slurm's commands on this machine, or put them on the PATH.",
            is_temporary=False,
        ) from err
    except OSError as err:
        raise SlurmError(f"{name}: cannot be started ({err.strerror}).", is_temporary=False) from err
    except subprocess.TimeoutExpired as err:
        raise SlurmError(f"{name}: no answer within {_ANSWER_S:.0f} s.", is_temporary=True) from err
    if done.returncode != 0:
        words = " ".join(done.stderr.split()) or f"{name} ended with exit code {done.returncode}."
        raise SlurmError(words, is_temporary=_is_temporary(words))
    return done.stdout


def _is_temporary(words: str) -> bool:
    if any(text in words.lower() for text in _TEMPORARY):
        return True
    name = _LIMIT_NAME.search(words)
    return "submit" in name[0].lower() if name is not None else _LIMIT in words.lower()
