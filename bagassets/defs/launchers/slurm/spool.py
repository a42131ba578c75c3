"""The files by which launcher, keeper and jobs know of each other, on a file system that all nodes share.

A run is one file. It lies in `waiting`, in `runs` of a job's folder, or in `begun` of it, and gets from one to the next
by a rename, which only one process can do. So a run that a job has begun is never submitted again, and one that was
taken back from a job that is gone cannot be begun by it any more. No locks are needed.
"""

import json
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from shlex import quote
from typing import Self
from uuid import uuid4

from bagassets.base.files import make_folder, move, remove, remove_all, write, write_atomically
from bagassets.base.json_types import JsonMapping, JsonObject

_JOB, _SUBMITTED, _ENDED = "job.json", "submitted.json", "ended.json"
_LATEST = 20  # jobs that tell how long runs take


@dataclass(frozen=True)
class JobSpec:
    """What all runs of a job have in common; only runs with equal specs can share one.

    Attributes:
        instance: the Dagster instance, from `pack_instance`.
        options: what the job asks Slurm for (`JobOptions.as_json`).
        python: interpreter.
        cwd: current folder.
        modules: modules of definitions.
        paths: folders put on the module search path.
        locks: folder of lock files.
        environment: variables that are set.
        needs: folders and files that the node must see.
        versions: distribution -> version that the node must have.
        idle_s: how long a job waits for more runs when it has none left.
        minutes: a job takes no more runs that might end later than that after its begin.
        stores: folder of a store -> its id.
    """

    instance: str
    options: JsonMapping
    python: str
    cwd: str
    modules: list[str]
    paths: list[str]
    locks: str
    environment: JsonMapping
    needs: list[str]
    versions: JsonMapping
    idle_s: float = 0.0
    minutes: float = 0.0
    stores: JsonMapping = field(default_factory=dict)


@dataclass(frozen=True)
class SpooledRun:
    """A run in the spool.

    Attributes:
        run_id: the run.
        spec: what its job must be like.
        seconds: how long it may take.
        since: when it was launched, in Unix seconds.
        recordings: how many it is about; 1 if it is about none.
        sizes: path of a recording that it is about -> its bytes, as far as they are known.
    """

    run_id: str
    spec: JobSpec
    seconds: float
    since: float
    recordings: int = 1
    sizes: JsonMapping = field(default_factory=dict)

    @classmethod
    def from_json(cls, value: JsonMapping) -> Self:
        """Inverse of `asdict`."""
        return cls(**dict(value) | {"spec": JobSpec(**value["spec"])})


@dataclass(frozen=True)
class JobFolder:
    """The folder of one job.

    Attributes:
        path: the folder.
    """

    path: Path

    @property
    def name(self) -> str:
        """Name of the folder, and of the log."""
        return self.path.name

    @property
    def log(self) -> Path:
        """What the job prints."""
        return self.path.parent.parent / "logs" / f"{self.name}.log"

    def spec(self) -> JobSpec:
        """Return the spec of its runs."""
        return JobSpec(**_read(self.path / _JOB) or {})

    def age_s(self) -> float:
        """Return how long ago it was made."""
        return time.time() - (self.path / _JOB).stat().st_mtime

    # --- its runs ---

    def runs(self) -> list[str]:
        """Return the runs that it has not begun."""
        return _names(self.path / "runs")

    def queue(self) -> list[SpooledRun]:
        """Return the runs that it has not begun, in the order in which it begins them."""
        return _by_age(self.path / "runs")

    def begun(self) -> list[str]:
        """Return the runs that it has begun."""
        return _names(self.path / "begun")

    def take(self, run_id: str) -> SpooledRun | None:
        """Take a run for the job; None if somebody took it back."""
        return _moved(self.path / "runs" / f"{run_id}.json", self.path / "begun" / f"{run_id}.json")

    def take_waiting(self, seconds: float) -> SpooledRun | None:
        """Take a run that waits for a job such as this one; None if there is none.

        Args:
            seconds: longest that the run may take.
        """
        root = self.path.parent.parent
        for run in Spool(root).waiting():
            if run.seconds <= seconds and asdict(run.spec) == _read(self.path / _JOB):
                name = f"{run.run_id}.json"
                got = _moved(root / "waiting" / name, self.path / "begun" / name)
                if got is not None:
                    return got
        return None

    def has(self, run_id: str) -> bool:
        """Return whether the job has the run, begun or not."""
        # In this order: the job may begin it meanwhile.
        return any((self.path / name / f"{run_id}.json").exists() for name in ("runs", "begun"))

    def note_seconds(self, run: SpooledRun, seconds: float) -> None:
        """Note how long a run took, for estimates."""
        with suppress(OSError):
            write_atomically(
                self.path / "took" / run.run_id, json.dumps([run.seconds, round(seconds, 3)]).encode()
            )

    def ask_to_cancel(self, run_id: str) -> None:
        """Have the job cancel a run that it has begun."""
        with suppress(FileNotFoundError):  # it has just ended
            write(self.path / "cancel" / run_id, b"")

    def to_cancel(self) -> list[str]:
        """Return the runs that somebody asked to cancel."""
        return _names(self.path / "cancel")

    # --- the job ---

    @property
    def is_open(self) -> bool:
        """False once it was settled."""
        return self.path.is_dir()

    def submitted(self) -> JsonObject | None:
        """Return `job`, `user` and `at` of the submission; None before it."""
        return _read(self.path / _SUBMITTED)

    def note_submitted(self, job_id: str, user: str) -> None:
        """Note under which id the job was submitted."""
        _write(self.path / _SUBMITTED, {"job": job_id, "user": user, "at": time.time()})

    def ended(self) -> JsonObject | None:
        """Return `code`, `node` and `problem` that the job left when it ended; None if it has not."""
        found = _read(self.path / _ENDED)
        if found is None:
            return None
        with suppress(OSError):
            found["problem"] = (self.path / "problem").read_text("utf-8")
        return found

    def note_problem(self, problem: str) -> None:
        """Note, on the node, why the job can do nothing."""
        write_atomically(self.path / "problem", problem.encode())

    def script(self, command: str) -> str:
        """Return the batch script that executes a command, and leaves a record when it ends."""
        record, new = (quote(str(self.path / name)) for name in (_ENDED, f"{_ENDED}.new"))
        return (
            "#!/bin/sh\n"
            "trap : TERM  # the command gets it, too; this shell goes on, and records the end\n"
            f"{command}\n"
            "code=$?\n"
            f'printf \'{{"code": %d, "node": "%s"}}\' "$code" "$SLURMD_NODENAME" > {new} '
            f"&& mv {new} {record}\n"
            'exit "$code"\n'
        )


@dataclass(frozen=True)
class Spool:
    """All files of one launcher.

    Attributes:
        root: the folder, on a file system that all nodes share.
    """

    root: Path

    def make(self) -> None:
        """Make the folders."""
        for name in ("waiting", "tries", "jobs", "ended", "logs"):
            make_folder(self.root / name)

    def put(self, run: SpooledRun) -> None:
        """Have a run wait for a job."""
        _write(self.root / "waiting" / f"{run.run_id}.json", asdict(run))

    def waiting(self) -> list[SpooledRun]:
        """Return the runs that wait for a job, the oldest first."""
        return _by_age(self.root / "waiting")

    def withdraw(self, run_id: str) -> bool:
        """Take away a run that waits for a job; return False if none waits."""
        return remove(self.root / "waiting" / f"{run_id}.json")

    def is_waiting(self, run_id: str) -> bool:
        """Return whether the run waits for a job."""
        return (self.root / "waiting" / f"{run_id}.json").exists()

    def new_job(self, runs: Iterable[SpooledRun]) -> tuple[JobFolder, list[SpooledRun]]:
        """Move runs with equal specs from `waiting` into the folder of a new job; return it, and those that it got."""
        runs = list(runs)
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S")
        folder = JobFolder(self.root / "jobs" / f"{stamp}-{uuid4().hex[:8]}")
        for name in ("runs", "begun", "cancel", "took"):
            make_folder(folder.path / name)
        _write(folder.path / _JOB, asdict(runs[0].spec))
        got = []
        for run in runs:
            name = f"{run.run_id}.json"
            if _moved(self.root / "waiting" / name, folder.path / "runs" / name) is not None:
                got.append(run)
        return folder, got

    def take_back(self, folder: JobFolder, run_id: str) -> bool:
        """Have a run wait for another job; return False if its job, or somebody else, took it."""
        name = f"{run_id}.json"
        return _moved(folder.path / "runs" / name, self.root / "waiting" / name) is not None

    def count_try(self, run_id: str) -> int:
        """Note that a job ended before it began the run, or could not be submitted; return how often that was so."""
        with (self.root / "tries" / run_id).open("ab") as file:
            file.write(b".")
            return file.tell()

    def drop(self, folder: JobFolder, run_id: str) -> bool:
        """Take away a run that its job has not begun; return False if it has."""
        return remove(folder.path / "runs" / f"{run_id}.json")

    def jobs(self) -> list[JobFolder]:
        """Return the jobs that are not settled, the oldest first."""
        return [JobFolder(path) for path in sorted((self.root / "jobs").glob("*T*-*"))]

    def job_of(self, run_id: str) -> JobFolder | None:
        """Return the job that has the run; None if no job that is not settled has it."""
        return next((job for job in self.jobs() if job.has(run_id)), None)

    def settle(self, folder: JobFolder) -> None:
        """Put a job aside whose runs have all ended."""
        with suppress(OSError):  # somebody else did
            move(folder.path, self.root / "ended" / folder.name)

    def durations(self) -> Iterator[tuple[float, float]]:
        """Yield how long runs of the last jobs should have taken, and took."""
        for path in sorted((self.root / "ended").glob("*T*-*"), reverse=True)[:_LATEST]:
            for name in _names(path / "took"):
                with suppress(OSError, ValueError):
                    expected, took = json.loads((path / "took" / name).read_text("utf-8"))
                    yield expected, took

    def remove_old(self, days: float) -> None:
        """Remove what is left of jobs that ended long ago."""
        oldest = time.time() - days * 86400
        old = (("ended", "*T*-*"), ("logs", "*.log"), ("tries", "*"))
        for path in [path for name, pattern in old for path in (self.root / name).glob(pattern)]:
            with suppress(OSError):
                if path.stat().st_mtime < oldest:
                    remove_all(path) if path.is_dir() else remove(path)


def _names(folder: Path) -> list[str]:
    try:
        return sorted(path.name.removesuffix(".json") for path in folder.iterdir() if path.name[0] != ".")
    except FileNotFoundError:
        return []


def _by_age(folder: Path) -> list[SpooledRun]:
    """Return the runs in a folder, the oldest first."""
    found = [_read(path) for path in folder.glob("*.json")]
    return sorted((SpooledRun.from_json(one) for one in found if one), key=lambda run: run.since)


def _moved(source: Path, target: Path) -> SpooledRun | None:
    """Move a run; None if it is not there (any more)."""
    try:
        move(source, target)
    except FileNotFoundError:
        return None
    found = _read(target)
    return None if found is None else SpooledRun.from_json(found)


def _read(path: Path) -> JsonObject | None:
    try:
        value: JsonObject = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        return None
    return value


def _write(path: Path, value: JsonMapping) -> None:
    write_atomically(path, json.dumps(value, sort_keys=True).encode())
