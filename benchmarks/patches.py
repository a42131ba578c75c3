"""What is gained by each place that relies on Dagster's inner workings for speed: a build and a tick without it, by turns.

    python -m benchmarks.patches --json benchmarks/results/patches.json

Each is switched off in a copy of the code, by replacing a few lines; the script ends if these are not there any more. Measured are
processor seconds, with all servers and workers, of three things:

- cold: the first build of a project of small recordings, for which what Dagster does counts most; its server is started;
- warm: a build of one recording that has changed, with a server that is up;
- tick: a scan by the sensor that remembers nothing.

Also how much room Dagster's records take then. The gain is the quotient without / with, of two builds one after the other, since
the processors of a shared machine are now faster, now slower; the median of several pairs.
"""

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from bagassets.forkserver.client import Client
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from benchmarks.common import ROOT, machine

CASES = ("cold", "warm", "tick", "room")
WORTH = 1.03
"""A patch that gains no more than this in any of the cases is not worth its lines."""
_RECORDINGS, _DURATION_S, _TICKS = 12, 1.5, 40
_ENDING_S = 0.5  # workers give back their memory
_IDLE_S = 3.0
_PROJECT = """
import sys
from pathlib import Path
from bagassets.propose.project import write_project
write_project(Path(sys.argv[1]), sys.argv[2])
"""
_TICK = f"""
import os, time
from pathlib import Path
from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.graph.sensor_cursor import Cursor
from bagassets.defs.graph.sensor_scan import Scan
with open_project(Path(os.environ["BAGASSETS_RECIPE"])) as workspace:
    taken = []
    for _ in range({_TICKS}):
        began = time.process_time()
        Scan(workspace, Cursor()).scan(time.time())
        taken.append(time.process_time() - began)
print(min(taken))
"""


@dataclass(frozen=True)
class Patch:
    """A place that relies on Dagster's inner workings.

    Attributes:
        what: what it does, for the table.
        edits: file, text and what stands there without the patch.
    """

    what: str
    edits: tuple[tuple[str, str, str], ...]


_STORAGE = "defs/records/sqlite_storage.py"
PATCHES = {
    "connections": Patch(
        "connections to SQLite that stay open",
        (
            # As Dagster opens them, two workers that record at once can meet a locked database.
            (_STORAGE, "poolclass=QueuePool, max_overflow=-1", 'poolclass=__import__("sqlalchemy.pool").pool.NullPool'),
        ),
    ),
    "one_file": Patch(
        "the events of all runs in one file",
        ((_STORAGE, "_events: type[SqliteEventLogStorage] = ProjectEventLogStorage", "_events: type[SqliteEventLogStorage] = _EventLogStorage"),),
    ),
    "event_id": Patch(
        "the id of the event just recorded is not looked up",
        ((_STORAGE, 'return getattr(self._thread, "event_id", None)', "return None"),),
    ),
    "asset_keys": Patch(
        "the latest event of an asset is updated before an insert is tried",
        ((_STORAGE, 'if not conn.execute(_NOTE_LATEST, {"its_key": happened.asset_key.to_string(), **values}).rowcount:', "if values:"),),
    ),
    "alembic": Patch(
        "Alembic is not asked whether a database is new",
        (
            (_STORAGE, 'self._run_storage = _RunStorage(f"sqlite:///{runs}")', "self._run_storage = _RunStorage.from_local(str(runs.parent))"),
            (_STORAGE, 'self._schedule_storage = _ScheduleStorage(f"sqlite:///{schedules}")', "self._schedule_storage = _ScheduleStorage.from_local(str(schedules.parent))"),
        ),
    ),
    "checks": Patch(
        "checks that passed are recorded in one statement",
        (("defs/records/recorder.py", "if evaluation.passed and isinstance(storage, SqlEventLogStorage):", "if evaluation is None:"),),
    ),
    "tails": Patch(
        "no `tail` processes for the output of steps",
        (("defs/runs/execution.py", "with capture_interrupts(), _compute_logs_without_tails():", "with capture_interrupts():"),),
    ),
    "rehearsal": Patch(
        "the server asks the project's database what plans ask, before it forks",
        (("defs/launchers/run_worker.py", "_UNTIL_IDLE, _rehearse()", "_UNTIL_IDLE"),),
    ),
    "modules": Patch(
        "what Dagster imports when it executes a run is imported before the server forks",
        (("defs/launchers/run_worker.py", "    *RUN_MODULES,\n", ""),),
    ),
}  # fmt: skip


def main() -> None:
    """Measure, and print or keep the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the figures here")
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("patch", nargs="*", default=[*PATCHES], help=f"of {', '.join(PATCHES)}")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        found = measure(Path(folder), arguments.patch, arguments.times)
    if arguments.json:
        before = json.loads(arguments.json.read_text("utf-8")) if arguments.json.exists() else {}
        kept = before.get("pairs", {}) | found
        ordered = {name: kept[name] for name in PATCHES if name in kept}
        arguments.json.write_text(
            json.dumps({"machine": machine(), "pairs": ordered}, indent=1) + "\n", "utf-8"
        )
    print(patches_table({"pairs": found}))


def patches_table(figures: dict[str, Any]) -> str:
    """Return the gains as Markdown."""
    rows = [
        f"| {PATCHES[name].what} | {' | '.join(f'{gain:.2f}' for gain in gains(pairs).values())} |"
        for name, pairs in figures["pairs"].items()
    ]
    return "\n".join([f"| gain | {' | '.join(CASES)} |", f"|---|{'--:|' * len(CASES)}", *rows])


def gains(pairs: list[dict[str, list[float]]]) -> dict[str, float]:
    """Return case -> what a patch gains in it."""
    return {
        case: statistics.median(without / ours for ours, without in (one[case] for one in pairs))
        for case in CASES
    }


def measure(folder: Path, names: list[str], times: int) -> dict[str, list[dict[str, list[float]]]]:
    """Return patch -> for each time, case -> what it takes with all patches, and without this one."""
    recordings = folder / "recordings"
    for seed in range(_RECORDINGS):
        _write(recordings / f"d{seed:02}.bag", seed)
    ours = _code(folder / "ours", None)
    code = {name: _code(folder / name, PATCHES[name]) for name in names}
    found: dict[str, list[dict[str, list[float]]]] = {name: [] for name in names}
    seeds = count(_RECORDINGS)  # each time another recording comes
    for _ in range(times):
        for name, place in code.items():
            both = [_once(folder / "project", recordings, each, next(seeds)) for each in (ours, place)]
            found[name].append({case: [one[case] for one in both] for case in CASES})
            print(f"{name:12} {found[name][-1]}", flush=True)
    return found


def _code(folder: Path, patch: Patch | None) -> Path:
    """Copy the code, without a patch; return the folder to be put on the module search path."""
    shutil.copytree(ROOT / "bagassets", folder / "bagassets", ignore=shutil.ignore_patterns("__pycache__"))
    for file, ours, without in () if patch is None else patch.edits:
        path = folder / "bagassets" / file
        text = path.read_text("utf-8")
        if text.count(ours) != 1:
            raise SystemExit(f"bagassets/{file}: it should say once: {ours}")
        path.write_text(text.replace(ours, without), "utf-8")
    return folder


def _once(project: Path, recordings: Path, code: Path, seed: int) -> dict[str, float]:
    """Return case -> processor seconds, or bytes, in a new project."""
    shutil.rmtree(project, ignore_errors=True)
    env = {**os.environ, "PYTHONPATH": str(code), "BAGASSETS_RECIPE": str(project / "recipe.yaml")}
    arguments = [str(project), sample_recipe(root=str(recordings))]
    subprocess.run([sys.executable, "-c", _PROJECT, *arguments], check=True, env=env)
    try:
        cold = _build_cpu_s(project, env)
        _write(recordings / "d00.bag", seed)
        server = _idle_server_cpu_s(project)
        warm = _build_cpu_s(project, env) - server
    finally:
        for client in Client.all_of(project / ".bagassets"):
            client.shutdown(grace_s=1.0)
    tick = subprocess.run(
        [sys.executable, "-c", _TICK], cwd=project, env=env, check=True, capture_output=True, text=True
    )
    room = sum(
        path.stat().st_size for path in (project / ".bagassets" / "dagster").rglob("*") if path.is_file()
    )
    return {"cold": cold, "warm": warm, "tick": float(tick.stdout.split()[-1]), "room": float(room)}


def _build_cpu_s(project: Path, env: dict[str, str]) -> float:
    """Build; return the seconds of the command, and those of its server since that was started."""
    command = [sys.executable, "-m", "bagassets", "build"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, cwd=project, env=env, check=False, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"the build ended with status {done.returncode}: {done.stderr}{done.stdout}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    time.sleep(_ENDING_S)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return used + _server_cpu_s(project)


def _idle_server_cpu_s(project: Path) -> float:
    """Return the seconds of the server once it has prepared all that can wait."""
    before, now = -1.0, _server_cpu_s(project)
    while now > before:
        time.sleep(_IDLE_S)
        before, now = now, _server_cpu_s(project)
    return now


def _server_cpu_s(project: Path) -> float:
    """Return the seconds of the server of a project, and of its workers that have ended."""
    ticks = 0
    for client in Client.all_of(project / ".bagassets"):
        with client:
            stat = Path(f"/proc/{client.process.pid}/stat").read_text("ascii", "replace")
            ticks += sum(int(field) for field in stat.rpartition(")")[2].split()[11:15])
    return ticks / os.sysconf("SC_CLK_TCK")


def _write(path: Path, seed: int) -> None:
    path.unlink(missing_ok=True)
    write_recordings([Target(path, "ros1")], seed, "small", _DURATION_S)


if __name__ == "__main__":
    main()
