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
from benchmarks.common import (
    ROOT,
    Options,
    Project,
    converter_command,
    count_files,
    markdown,
    median,
    plain_command,
    project,
    save,
)
from benchmarks.drives import LEAST_BYTES, write_jpeg_project
from benchmarks.resources import Used, run_watched
from benchmarks.rq1 import PLAIN

__all__ = ["cold", "cold_table"]

_BAG_GB = 1.9
_SMALL_BYTES = 5e6
_JPEG_BYTES = 700_000  # of one image, roughly
_BAGASSETS, _CUT = "bagassets", "cutting it into files"


def cold(options: Options) -> None:
    """Measure, and write `cold.json` and `cold.md`."""
    size = _BAG_GB * options.size_gb
    folder, trials = options.folder, options.trials
    several, small = (2, 4) if options.tiny else (8, max(12, round(20 * options.size_gb)))
    small_name = f"{small} recordings of {max(_SMALL_BYTES, LEAST_BYTES) / 1e6:.0f} MB"
    several_name = f"{several} recordings of {size / several:.2f} GB"
    cases: dict[str, Callable[[], Project]] = {
        f"one recording of {size:.2f} GB": lambda: project(folder / "cold-one", [size * 1e9], trials),
        f"one recording of {size / 4:.2f} GB": lambda: project(
            folder / "cold-quarter", [size * 2.5e8], trials
        ),
        several_name: lambda: project(folder / "cold-several", [size * 1e9 / several] * several, trials),
        small_name: lambda: project(folder / "cold-small", [_SMALL_BYTES] * small, trials),
        f"JPEG, {size / 2:.2f} GB": lambda: jpeg_project(folder / "cold-jpeg", size * 5e8, trials),
        f"JPEG, {size / 8:.2f} GB": lambda: jpeg_project(folder / "cold-jpeg-part", size * 1.25e8, trials),
    }
    found: dict[str, Any] = {}
    for name, make in cases.items():
        made = make()
        runs = _runs(made, options)
        found[name] = {"size_gb": made.size_gb, "recordings": len(list(made.bags.iterdir()))}
        found[name] |= {what: [asdict(one) for one in used] for what, used in runs.items()}
        made.stop_server()
        if name.startswith("JPEG"):
            found[name][_CUT] = [asdict(Used(seconds=one)) for one in _copy_s(made, options)]
        shutil.rmtree(made.state)
        shutil.rmtree(made.recipe.parent / "nuscenes", ignore_errors=True)
    figures = {"cases": found, **_beyond(found[several_name], found[small_name])}
    figures["jpeg_mb_per_s"] = _rates(*[one for name, one in found.items() if name.startswith("JPEG")])
    save(options, "cold", figures, cold_table(figures))


def cold_table(figures: dict[str, Any]) -> str:
    """Return the table of `cold.json`, and two sentences."""
    rows = []
    for name, case in figures["cases"].items():
        for what, used in case.items():
            if not isinstance(used, list) or what == _CUT:
                continue
            seconds = _middle(used, "seconds")
            title = f"{name}: {what}" + (", FAILED on some" if any(one["code"] for one in used) else "")
            rate = case["size_gb"] * 1000 / seconds
            busy, peak_mb = 100 * _middle(used, "busy"), _middle(used, "peak_mb")
            rows.append([title, seconds, _middle(used, "cpu_s"), busy, peak_mb, rate])
    head = ["run, medians", "s", "CPU-s", "processors busy %", "peak memory MB", "MB/s"]
    rates = ", ".join(f"{what} {rate:.0f} MB/s" for what, rate in figures["jpeg_mb_per_s"].items())
    return (
        markdown(head, rows)
        + f"\nBeyond the plain conversion: {figures['cpu_s_per_recording']:.2f} CPU-seconds for each recording, and "
        f"{figures['cpu_s_to_start']:.1f} once, to start (from the many and the small ones).\n"
        f"\nJPEG, each MB beyond those of the smaller recording: {rates}.\n"
    )


def _beyond(several: dict[str, Any], small: dict[str, Any]) -> dict[str, float]:
    """Return the processor time that a build takes beyond a plain conversion: for each recording, and once."""
    (few, first), (many, second) = (
        (case["recordings"], _middle(case[_BAGASSETS], "cpu_s") - _middle(case[PLAIN], "cpu_s"))
        for case in (several, small)
    )
    each = (second - first) / (many - few)
    return {"cpu_s_per_recording": each, "cpu_s_to_start": first - few * each}


def _rates(large: dict[str, Any], little: dict[str, Any]) -> dict[str, float]:
    """Return MB/s of each way to convert JPEG, without what it takes to start."""
    size_mb = (large["size_gb"] - little["size_gb"]) * 1000
    ways = [what for what, used in large.items() if isinstance(used, list)]
    return {
        what: size_mb / (_middle(large[what], "seconds") - _middle(little[what], "seconds")) for what in ways
    }


def _middle(used: list[dict[str, Any]], field: str) -> float:
    return median([one[field] for one in used])


def _copy_s(made: Project, options: Options) -> list[float]:
    """Return the seconds of cutting the recordings into files: reading and writing, nothing else."""
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
    return taken


def jpeg_project(folder: Path, size: float, trials: int) -> Project:
    """Return a project of one recording of four JPEG cameras that are not undistorted."""
    recipe = write_jpeg_project(folder, size)
    return Project(recipe, trials)


def _runs(made: Project, options: Options) -> dict[str, list[Used]]:
    commands: dict[str, Callable[[], Used]] = {
        _BAGASSETS: lambda: _build(made),
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
        used = run_watched(converter_command(converter, recording, target), cwd=ROOT)
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
