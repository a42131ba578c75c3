"""What small recordings cost: time and processor time of each, beside the work alone, and Dagster's records of each.

Recordings of half a second, from nothing. Projects of two sizes are built by turns; what each recording more of the
larger one took is a recording's share, free of the start of the server and of the dataset. The work alone is the same
assets of the same recordings, made in one process that has everything imported, without Dagster. What is kept of each in
PostgreSQL is measured once: after the first build, and how much another one adds once all recordings have changed. That is
less, as it uses the room of rows that the first one replaced. In a long build PostgreSQL itself sees to that every minute;
`--many 1200` measures one (a quarter of an hour).
"""

import argparse
import json
import shutil
import statistics
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from bagassets.engine.execute import execute
from bagassets.engine.graph import Graph
from bagassets.engine.process import keep_freed_memory
from bagassets.forkserver.client import Client
from bagassets.formats.catalogue import recording_assets
from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets_tests.postgres_server import Postgres, running_postgres, use_postgres
from benchmarks.common import machine
from benchmarks.drives import with_short_scenes
from benchmarks.resources import Used, run_watched

__all__ = ["small_table"]

_DURATION_S = 0.5
_WARM = 2  # recordings made before the clock is looked at
_OTHER_SEEDS = 1000  # of recordings that have changed
_LONG_FEWER = 200  # recordings of the smaller project that a long build is compared with


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures here")
    parser.add_argument("--fewer", type=int, default=10, help="recordings of the smaller project")
    parser.add_argument("--more", type=int, default=50, help="recordings of the larger project")
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--many", type=int, help="also build so many with PostgreSQL")
    arguments = parser.parse_args()
    if not _WARM < arguments.fewer < arguments.more:
        parser.error(f"--fewer must be more than {_WARM}, and less than --more")
    if arguments.many is not None and arguments.many <= _LONG_FEWER:
        parser.error(f"--many must be more than {_LONG_FEWER}")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        figures = measure(Path(folder), arguments.fewer, arguments.more, arguments.times)
    if arguments.many is not None:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            figures["postgres_long"] = measure_long(Path(folder), arguments.many)
    print(small_table(figures), flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps({"machine": machine(), **figures}, indent=1) + "\n", "utf-8")


def small_table(figures: dict[str, Any]) -> str:
    """Return the table of `small.json`; medians."""
    middle = {name: statistics.median(values) for name, values in figures["each"].items()}
    number = figures["recordings"][1]
    rows = [
        ("recording", f"{figures['recording_bytes'] / 1e6:.1f} MB"),
        ("time", f"{middle['seconds']:.2f} s"),
        ("processor time", f"{middle['cpu_s']:.2f} s"),
        ("processor time of the work alone", f"{middle['work_cpu_s']:.2f} s"),
        ("Dagster's records in SQLite", f"{middle['record_bytes'] / 1e3:.0f} kB"),
        (
            f"Dagster's records in PostgreSQL, a build of {number}",
            f"{figures['postgres_bytes'] / 1e3:.0f} kB",
        ),
        ("what each further build adds there", f"{figures['postgres_further_bytes'] / 1e3:.0f} kB"),
    ]
    if "postgres_long" in figures:
        number = figures["postgres_long"]["recordings"][1]
        kept = f"{figures['postgres_long']['bytes'] / 1e3:.0f} kB"
        rows.insert(-1, (f"likewise, a build of {number:,}", kept))
    return (
        "\n".join(["| each recording | |", "|---|--:|", *(f"| {name} | {value} |" for name, value in rows)])
        + "\n"
    )


def measure(folder: Path, fewer: int, more: int, times: int) -> dict[str, Any]:
    """Return what each recording costs, for each time that it was measured."""
    recordings = _recordings(folder, fewer, more)
    each: dict[str, list[float]] = {"seconds": [], "cpu_s": [], "record_bytes": [], "work_cpu_s": []}
    for _ in range(times):
        few, many = (_build(folder / "project", recordings[size]) for size in (fewer, more))
        for name, value in many.items():
            each[name].append((value - few[name]) / (more - fewer))
        each["work_cpu_s"].append(_work_cpu_s(folder / "project", recordings[fewer]))
    size = next(recordings[more].iterdir()).stat().st_size
    with running_postgres() as server:
        kept = [_postgres_bytes(folder / "project", recordings[number], server) for number in (fewer, more)]
    postgres_bytes, further_bytes = ((end - begin) / (more - fewer) for begin, end in zip(*kept, strict=True))
    return {
        "recordings": [fewer, more],
        "recording_bytes": size,
        "postgres_bytes": postgres_bytes,
        "postgres_further_bytes": further_bytes,
        "each": each,
    }


def measure_long(folder: Path, many: int) -> dict[str, Any]:
    """Return what PostgreSQL keeps of each recording of a first build that takes minutes, beyond a shorter one."""
    recordings = _recordings(folder, _LONG_FEWER, many)
    sizes = []
    with running_postgres() as server:
        for number, found in recordings.items():
            recipe_file, name = _postgres_project(folder / f"project-{number}", found, server)
            _run_build(recipe_file)
            sizes.append(server.database_bytes(name))
            shutil.rmtree(recipe_file.parent)
    return {"recordings": [_LONG_FEWER, many], "bytes": (sizes[1] - sizes[0]) / (many - _LONG_FEWER)}


def _recordings(folder: Path, fewer: int, more: int) -> dict[int, Path]:
    """Write recordings, and return how many -> folder; the smaller one has the same files as the larger one."""
    recordings = {size: folder / f"recordings-{size}" for size in (fewer, more)}
    targets = [recordings[more] / f"d{seed:04}.bag" for seed in range(more)]
    with ProcessPoolExecutor() as pool:
        list(pool.map(_write_recording, targets, range(more)))
    recordings[fewer].mkdir()
    for path in targets[:fewer]:
        (recordings[fewer] / path.name).hardlink_to(path)
    return recordings


def _write_recording(path: Path, seed: int) -> None:
    write_recordings([Target(path, "ros1")], seed, "small", _DURATION_S)


def _project(folder: Path, recordings: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    write_project(folder, with_short_scenes(sample_recipe(root=str(recordings))))
    return folder / "recipe.yaml"


def _build(folder: Path, recordings: Path) -> dict[str, float]:
    """Build a new project, and return what that took."""
    recipe_file = _project(folder, recordings)
    used = _run_build(recipe_file)
    state = load_recipe(recipe_file).state
    records = sum(path.stat().st_size for path in (state / "dagster").rglob("*") if path.is_file())
    return {"seconds": used.seconds, "cpu_s": used.cpu_s, "record_bytes": records}


def _run_build(recipe_file: Path) -> Used:
    command = [sys.executable, "-m", "bagassets", "build", "--recipe", str(recipe_file)]
    used = run_watched(command, cwd=recipe_file.parent, memory=False)
    if used.code:
        raise SystemExit(f"the build ended with status {used.code}")
    for client in Client.all_of(load_recipe(recipe_file).state):
        client.shutdown(grace_s=1.0)
    return used


def _postgres_bytes(folder: Path, recordings: Path, server: Postgres) -> tuple[int, int]:
    """Build a project that keeps its records in PostgreSQL, change all recordings, and build it again.

    Returns:
        Bytes of its database after the first build, and by how many the second one let it grow.
    """
    recipe_file, name = _postgres_project(folder, recordings, server)
    _run_build(recipe_file)
    built_bytes = server.database_bytes(name)
    server.vacuum(name)
    for seed, path in enumerate(sorted(recordings.iterdir())):
        path.unlink()
        _write_recording(path, _OTHER_SEEDS + seed)
    _run_build(recipe_file)
    return built_bytes, server.database_bytes(name) - built_bytes


def _postgres_project(folder: Path, recordings: Path, server: Postgres) -> tuple[Path, str]:
    """Write a project that keeps its records in PostgreSQL; return its recipe and the name of its database."""
    name = recordings.name.replace("-", "_")
    server.create_database(name)
    recipe_file = _project(folder, recordings)
    use_postgres(recipe_file, server.url_of(name))
    return recipe_file, name


def _work_cpu_s(folder: Path, recordings: Path) -> float:
    """Return the processor time that the assets of a recording take without Dagster."""
    recipe = load_recipe(_project(folder, recordings))
    assets = recording_assets(recipe)
    keep_freed_memory()
    taken = []
    for recording in discover(recipe.bags).recordings.values():
        began = time.process_time()
        stat, digest = recording_stat(recording), recording_digest(recording, assets.index)
        graph = Graph(assets, recording, digest.digest, stat, wanted=set(assets.names), given={})
        list(execute(graph))
        taken.append(time.process_time() - began)
    return statistics.mean(taken[_WARM:])


if __name__ == "__main__":
    main()
