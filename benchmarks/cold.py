"""Cold builds: seconds, processor time, memory and idle processors, beside conversions without a store.

One long recording, the same at a quarter of its length (memory must not grow), eight side by side, many small
ones (what a recording costs beyond the work), and JPEG that is passed through, of two sizes: their
difference is without what starting takes.
"""

import os
import shlex
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bagassets.recipe import load_recipe
from bagassets.recordings.discover import discover
from benchmarks.common import ROOT, Options, Project, count_files, markdown, plain_command, project, save
from benchmarks.drives import write_jpeg_project
from benchmarks.resources import Used, run_watched
from benchmarks.rq1 import PLAIN

__all__ = ["cold"]

_BAG_GB = 1.9
_SMALL_BYTES = 5e6
_JPEG_BYTES = 700_000  # of one image, roughly


def cold(options: Options) -> None:
    """Measure, and write `cold.json` and `cold.md`."""
    size = _BAG_GB * options.size_gb
    folder, trials = options.folder, options.trials
    small = max(12, round(40 * options.size_gb))
    cases: dict[str, Callable[[], Project]] = {
        f"one recording of {size:.2f} GB": lambda: project(folder / "cold-one", [size * 1e9], trials),
        f"one recording of {size / 4:.2f} GB": lambda: project(
            folder / "cold-quarter", [size * 2.5e8], trials
        ),
        f"8 recordings of {size / 8:.2f} GB": lambda: project(folder / "cold-8", [size * 1.25e8] * 8, trials),
        f"{small} recordings of 5 MB": lambda: project(folder / "cold-small", [_SMALL_BYTES] * small, trials),
        f"JPEG, {size / 2:.2f} GB": lambda: jpeg_project(folder / "cold-jpeg", size * 5e8, trials),
        f"JPEG, {size / 8:.2f} GB": lambda: jpeg_project(folder / "cold-jpeg-quarter", size * 1.25e8, trials),
    }
    figures: dict[str, Any] = {}
    rows: list[list[Any]] = []
    extra: dict[int, float] = {}  # recordings -> processor time beyond that of the plain conversion
    passed_on: list[tuple[float, dict[str, float]]] = []  # GB of JPEG, and seconds of each way
    for name, make in cases.items():
        made = make()
        runs = _runs(made, options)
        figures[name] = {"size_gb": made.size_gb, "recordings": len(list(made.bags.iterdir()))}
        for what, used in runs.items():
            best = min(used, key=lambda one: one.seconds)
            figures[name][what] = [asdict(one) for one in used]
            rate = made.size_gb * 1000 / best.seconds
            title = f"{name}: {what}" + (", FAILED on some" if any(one.code for one in used) else "")
            rows.append([title, best.seconds, best.cpu_s, 100 * best.busy, best.peak_mb, rate])
        extra[figures[name]["recordings"]] = _least_cpu_s(runs["bagassets"]) - _least_cpu_s(runs[PLAIN])
        made.stop_server()
        if name.startswith("JPEG"):
            seconds = {what: min(one.seconds for one in used) for what, used in runs.items()}
            passed_on.append((made.size_gb, seconds | {"cutting it into files": _copy_s(made, options)}))
        shutil.rmtree(made.state)
    head = ["run, best of trials", "s", "CPU-s", "processors busy %", "peak memory MB", "MB/s"]
    each = (extra[small] - extra[8]) / (small - 8)
    figures["cpu_s_per_recording"], figures["cpu_s_to_start"] = each, extra[8] - 8 * each
    note = (
        f"\nBeyond the plain conversion: {each:.2f} CPU-seconds for each recording, and {extra[8] - 8 * each:.1f} "
        "once, to start (from 8 recordings and the small ones).\n"
    )
    (large, slow), (little, fast) = passed_on
    rates = {what: (large - little) * 1000 / (slow[what] - fast[what]) for what in slow}
    figures["jpeg_mb_per_s"] = rates
    note += (
        f"\nJPEG, each MB beyond the first {little * 1000:.0f}: "
        + ", ".join(f"{what} {rate:.0f} MB/s" for what, rate in rates.items())
        + ".\n"
    )
    save(options, "cold", {"cases": figures}, markdown(head, rows) + note)


def _least_cpu_s(runs: list[Used]) -> float:
    return min(used.cpu_s for used in runs)


def _copy_s(made: Project, options: Options) -> float:
    """Return the seconds of cutting the recordings into files, the best of some: reading and writing, nothing else."""
    taken = []
    for _ in range(options.trials):
        made.settle()
        target = made.recipe.parent / "pieces"
        target.mkdir()
        began = time.perf_counter()
        for file in made.files():
            with file.open("rb", buffering=0) as stream:
                for number, piece in enumerate(iter(lambda: stream.read(_JPEG_BYTES), b"")):
                    (target / f"{file.name}-{number}").write_bytes(piece)
        taken.append(time.perf_counter() - began)
        shutil.rmtree(target)
    return min(taken)


def jpeg_project(folder: Path, size: float, trials: int) -> Project:
    """Return a project of one recording of four JPEG cameras that are not undistorted."""
    recipe = write_jpeg_project(folder, size)
    return Project(recipe, trials)


def _runs(made: Project, options: Options) -> dict[str, list[Used]]:
    commands: dict[str, Callable[[], Used]] = {
        "bagassets": lambda: _build(made),
        PLAIN: lambda: _convert(made, plain_command(made.bags, made.recipe.parent / "out")),
    }
    if options.converter is not None and "jpeg" not in made.recipe.parent.name:
        commands["external converter"] = lambda: _convert_each(made, str(options.converter))
    runs: dict[str, list[Used]] = {name: [] for name in commands}
    for _ in range(options.trials):  # by turns: what else the machine does changes with time
        for name, run in commands.items():
            made.settle()
            runs[name].append(run())
    return runs


def _build(made: Project) -> Used:
    made.start_over()
    made.hash_at_client()
    used = run_watched([sys.executable, "-m", "bagassets", "build", "--recipe", str(made.recipe)], cwd=ROOT)
    if used.code:
        sys.exit(f"{made.recipe}: the build ended with {used.code}")
    return used


def _convert(made: Project, command: list[str]) -> Used:
    out = made.recipe.parent / "out"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    used = run_watched(command, cwd=ROOT, env={"BENCH_RECIPE": str(made.recipe)})
    if used.code or not count_files(out):
        sys.exit(f"{shlex.join(command)} ended with {used.code} and left {count_files(out)} files")
    shutil.rmtree(out)
    return used


def _convert_each(made: Project, converter: str) -> Used:
    out, sum_ = made.recipe.parent / "out", Used()
    shutil.rmtree(out, ignore_errors=True)
    for recording in discover(load_recipe(made.recipe).bags).recordings.values():
        target = out / recording.key
        target.mkdir(parents=True)
        command = [part.format(bag=recording.path, out=target) for part in shlex.split(converter)]
        used = run_watched(command, cwd=ROOT)
        failed = bool(used.code) or not count_files(target)
        if failed:
            print(f"  the converter FAILED on {recording.key}", flush=True)
        sum_ = Used(
            sum_.seconds + used.seconds,
            sum_.cpu_s + used.cpu_s,
            max(sum_.peak_mb, used.peak_mb),
            code=sum_.code or int(failed),
        )
    shutil.rmtree(out)
    sum_.busy = sum_.cpu_s / max(sum_.seconds, 1e-9) / len(os.sched_getaffinity(0))
    return sum_
