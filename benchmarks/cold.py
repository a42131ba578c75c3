"""Cold builds beside a loop without a store: seconds, processor time, memory and idle processors.

The loop is the plain conversion (`benchmarks/plain.py`) of one fixed commit, in a checkout of its own: what makes the
conversion faster makes the build faster, and must not move what it is compared with. Clock and processor time of a
build end when its server has no job left: every picture, check and record is done. What the server spends on its start, and
what it puts off until then, counts as processor time.

One long recording, the same at a quarter of its length (memory must not grow), eight side by side, few and many small
ones (their difference is what each recording costs beyond the loop, and what is left is paid once), and JPEG that is passed
through, of two sizes: their difference is without what starting takes. The floor is what the stages take, each alone
(`benchmarks/floor.py`), on processors that are never idle.
"""

import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bagassets.forkserver.client import Client
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
    project,
    save,
)
from benchmarks.drives import LEAST_BYTES, write_jpeg_project
from benchmarks.floor import stages_of
from benchmarks.resources import Used, run_watched

__all__ = ["BUILD", "FIXED_LOOP", "PICTURES", "cold", "cold_table"]

LOOP_COMMIT = "72ffbfda0365498a46733fed356036fa75ce96a7"
PICTURES, BUILD, FIXED_LOOP = "bagassets", "bagassets, no pictures", "loop"

_BAG_GB = 1.9
_FEW = 4
_JPEG_BYTES = 700_000  # of one image, roughly
_CUT = "cutting it into files"
_POLL_S = 0.01


def cold(options: Options) -> None:
    """Measure, and write `cold.json` and `cold.md`."""
    size = _BAG_GB * options.size_gb
    folder, trials = options.folder, options.trials
    several, few, many = (2, 1, 2) if options.tiny else (8, _FEW, max(_FEW + 1, round(20 * options.size_gb)))
    small = f"recordings of {LEAST_BYTES / 1e6:.0f} MB"
    few_name, many_name = f"{few} {small}", f"{many} {small}"
    cases: dict[str, Callable[[], Project]] = {
        f"one recording of {size:.2f} GB": lambda: project(folder / "cold-one", [size * 1e9], trials),
        f"one recording of {size / 4:.2f} GB": lambda: project(
            folder / "cold-quarter", [size * 2.5e8], trials
        ),
        f"{several} recordings of {size / several:.2f} GB": lambda: project(
            folder / "cold-several", [size * 1e9 / several] * several, trials
        ),
        few_name: lambda: project(folder / "cold-few", [LEAST_BYTES] * few, trials),
        many_name: lambda: project(folder / "cold-small", [LEAST_BYTES] * many, trials),
        f"JPEG, {size / 2:.2f} GB": lambda: jpeg_project(folder / "cold-jpeg", size * 5e8, trials),
        f"JPEG, {size / 8:.2f} GB": lambda: jpeg_project(folder / "cold-jpeg-part", size * 1.25e8, trials),
    }
    found: dict[str, Any] = {}
    loop = _checkout(folder)
    for name, make in cases.items():
        print(name, flush=True)
        made = make()
        floor_cpu_s, _ = stages_of(made, folder / "floor")
        runs = _runs(made, options, loop)
        found[name] = {
            "size_gb": made.size_gb,
            "recordings": len(list(made.bags.iterdir())),
            "floor_cpu_s": sum(floor_cpu_s.values()),
        }
        found[name] |= {what: [asdict(one) for one in used] for what, used in runs.items()}
        made.stop_server()
        if name.startswith("JPEG"):
            found[name][_CUT] = [asdict(Used(seconds=one)) for one in _copy_s(made, options)]
        shutil.rmtree(made.state)
        shutil.rmtree(made.recipe.parent / "nuscenes", ignore_errors=True)
    figures = {
        "loop_commit": LOOP_COMMIT,
        "processors": len(os.sched_getaffinity(0)),
        "cases": found,
        "beyond": _beyond(found[few_name], found[many_name]),
    }
    figures["jpeg_mb_per_s"] = _rates(*[one for name, one in found.items() if name.startswith("JPEG")])
    save(options, "cold", figures, cold_table(figures))


def cold_table(figures: dict[str, Any]) -> str:
    """Return the table of `cold.json`, and some sentences."""
    rows = []
    for name, case in figures["cases"].items():
        loops = case[FIXED_LOOP]
        for what, used in case.items():
            if not isinstance(used, list) or what == _CUT:
                continue
            title = f"{name}: {what}" + (", FAILED on some" if any(one["code"] for one in used) else "")
            seconds, cpu_s = _middle(used, "seconds"), _middle(used, "cpu_s")
            busy, peak_mb = 100 * _middle(used, "busy"), _middle(used, "peak_mb")
            of_loop = _of_loop(used, loops, "seconds")
            rows.append([title, seconds, of_loop, cpu_s, cpu_s - _middle(loops, "cpu_s"), busy, peak_mb])
        floor_s = case["floor_cpu_s"] / figures["processors"]
        rows.append(
            [f"{name}: floor", floor_s, floor_s / _middle(loops, "seconds"), case["floor_cpu_s"], "", 100, ""]
        )
    head = [
        "run, medians",
        "s",
        "of the loop's",
        "CPU-s",
        "beyond the loop",
        "processors busy %",
        "peak memory MB",
    ]
    rates = ", ".join(f"{what} {rate:.0f} MB/s" for what, rate in figures["jpeg_mb_per_s"].items())
    beyond = figures["beyond"]
    return (
        markdown(head, rows)
        + f"\nBeyond the loop: {beyond['once']:.2f} CPU-seconds once, {beyond['each']:.2f} for each recording, and "
        f"{beyond['pictures']:.2f} for its pictures (from the few and the many small ones).\n"
        f"\nJPEG, each MB beyond those of the smaller recording: {rates}.\n"
    )


def _of_loop(used: list[dict[str, Any]], loops: list[dict[str, Any]], field: str) -> float:
    """Return the median of the ratio within each turn."""
    return median([one[field] / loop[field] for one, loop in zip(used, loops, strict=True)])


def _beyond(few: dict[str, Any], many: dict[str, Any]) -> dict[str, float]:
    """Return the processor time that builds take beyond the loop: once, for each recording, and for its pictures."""
    (less, little), (more, much) = (
        (case["recordings"], _middle(case[BUILD], "cpu_s") - _middle(case[FIXED_LOOP], "cpu_s"))
        for case in (few, many)
    )
    each = (much - little) / (more - less)
    drawn, without = (
        _middle(many[what], "cpu_s") - _middle(few[what], "cpu_s") for what in (PICTURES, BUILD)
    )
    return {"once": little - less * each, "each": each, "pictures": (drawn - without) / (more - less)}


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


def _checkout(folder: Path) -> Path:
    """Return a folder with the code of the loop."""
    target = folder / "loop"
    if not target.exists():
        target.mkdir()
        archive = subprocess.run(
            ["git", "archive", LOOP_COMMIT, "bagassets", "benchmarks"],
            cwd=ROOT,
            capture_output=True,
            check=False,
        )
        if archive.returncode:
            shutil.rmtree(target)
            sys.exit(
                f"git cannot read commit {LOOP_COMMIT[:7]}, whose loop builds are compared with: a checkout with its "
                f"history is needed.\n{archive.stderr.decode()}"
            )
        subprocess.run(["tar", "-x"], cwd=target, input=archive.stdout, check=True)
    return target


def _runs(made: Project, options: Options, loop: Path) -> dict[str, list[Used]]:
    plain = [
        sys.executable,
        str(loop / "benchmarks" / "plain.py"),
        str(made.bags),
        str(made.recipe.parent / "out"),
    ]
    commands: dict[str, Callable[[], Used]] = {
        PICTURES: lambda: _build(made, pictures=True),
        BUILD: lambda: _build(made, pictures=False),
        FIXED_LOOP: lambda: _convert(made, plain, loop),
    }
    if options.converter is not None and "jpeg" not in made.recipe.parent.name:
        commands["external converter"] = lambda: _convert_each(made, str(options.converter))
    runs: dict[str, list[Used]] = {name: [] for name in commands}
    for _ in range(options.trials):  # by turns: what else the machine does changes with time
        for name, run in commands.items():
            made.settle()
            runs[name].append(run())
    return runs


def _build(made: Project, *, pictures: bool) -> Used:
    """Build from nothing."""
    made.start_over()
    made.hash_at_client()
    recipe = made.recipe.read_text("utf-8")

    def until() -> None:
        for client in Client.all_of(made.state):
            while client.status()["jobs"]:
                time.sleep(_POLL_S)

    try:
        if not pictures:
            made.recipe.write_text(f"{recipe}preview:\n  enabled: false\n  trajectory_map: false\n", "utf-8")
        command = [sys.executable, "-m", "bagassets", "build", "--recipe", str(made.recipe)]
        used = run_watched(command, cwd=ROOT, until=until)
    finally:
        made.recipe.write_text(recipe, "utf-8")
    if used.code:
        sys.exit(f"{made.recipe}: the build ended with {used.code}")
    return used


def _convert(made: Project, command: list[str], code: Path) -> Used:
    out = made.recipe.parent / "out"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    used = run_watched(command, cwd=code, env={"BENCH_RECIPE": str(made.recipe)})
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
