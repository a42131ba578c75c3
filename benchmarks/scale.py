"""What commands cost with 10, 100, 1,000 recordings: time, memory and Dagster's records, and how that grows.

The recordings are real, and really built, but tiny, since what counts here is what each costs beside its work::

    python -m benchmarks.scale [--numbers 10 100 1000] [--folder DIR] [--json benchmarks/results/scale.json]

Growth is the exponent b of a power law between the two largest numbers: cost ~ number^b.
"""

import argparse
import json
import math
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
from bagassets.forkserver.client import Client
from bagassets.formats.dataset_build import datasets_of
from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets_tests import small_drive
from bagassets_tests.in_process import QUICK
from benchmarks.common import machine, markdown, median
from benchmarks.resources import run_watched

__all__ = ["scale_table"]

NUMBERS = (10, 100, 1000)
DRIVE_S = 2.0  # less is no scene, and a dataset of nothing costs nothing
# A tick of the sensor as its code server evaluates it, with all that it needs imported.
_TICK = """
import sys, time
from pathlib import Path
from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.graph.sensor_cursor import Cursor
from bagassets.defs.graph.sensor_scan import Scan
with open_project(Path(sys.argv[1])) as (instance, workspace):
    cursor = Cursor()
    for _ in range(2):
        began = time.perf_counter()
        requests = Scan(instance, workspace, cursor).scan(time.time())
        print(time.perf_counter() - began)
    assert requests == [], requests
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--numbers", type=int, nargs="+", default=list(NUMBERS))
    parser.add_argument("--times", type=int, default=3, help="how often each command is run")
    parser.add_argument("--folder", type=Path, help="where to work; default: a temporary folder")
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    found: dict[str, Any] = {"machine": machine(), "numbers": sorted(options.numbers), "costs": {}}
    with tempfile.TemporaryDirectory(dir=options.folder, ignore_cleanup_errors=True) as folder:
        for number in found["numbers"]:
            for name, value in measure(Path(folder) / f"p{number}", number, options.times).items():
                found["costs"].setdefault(name, []).append(value)
                print(f"{number:6} {name:50} {value:.4g}", flush=True)
    print(scale_table(found))
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=1) + "\n", "utf-8")


def scale_table(found: dict[str, Any]) -> str:
    """Return the table of `scale.json`, with the growth between the two largest numbers."""
    numbers = found["numbers"]
    rows = []
    for name, values in found["costs"].items():
        growth = ""
        if len(values) > 1 and min(values[-2:]) > 0:
            growth = f"{math.log(values[-1] / values[-2]) / math.log(numbers[-1] / numbers[-2]):.2f}"
        rows.append(
            [name, *(f"{value:,.0f}" if value >= 1000 else f"{value:.3g}" for value in values), growth]
        )
    return markdown(["", *(f"{number:,}" for number in numbers), "growth"], rows)


def measure(folder: Path, number: int, times: int) -> dict[str, float]:
    """Return what everything costs with so many recordings."""
    recipe_file = make(folder, number)

    def command(*arguments: str) -> list[str]:
        return [sys.executable, "-m", "bagassets", *arguments, "--recipe", str(recipe_file)]

    costs: dict[str, float] = {}
    built = run_watched(command("build"), cwd=folder)
    if built.code:
        raise SystemExit(f"the build of {number} recordings ended with status {built.code}")
    dataset = datasets_of(load_recipe(recipe_file))["nuscenes_dataset"].folder
    scenes = json.loads((dataset / "scene.json").read_text())
    if len(scenes) != number:
        raise SystemExit(f"{number} recordings became {len(scenes)} scenes; each must have one")
    costs["first build, s"] = built.seconds
    costs["first build, processor time, s"] = built.cpu_s
    costs["first build, most memory, MB"] = built.peak_mb
    costs["Dagster's records, MB"] = size_of(load_recipe(recipe_file).state / "dagster") / 1e6
    costs["nothing to do, s"] = timed(times, command("build"), "nothing to do")
    end_servers(recipe_file)  # which would carry them out
    costs["`status` without a server, s"] = timed(times, command("status"))
    costs["`build --dry-run` without a server, s"] = timed(times, command("build", "--dry-run"))
    costs["`report --no-checks`, s"] = timed(times, command("report", "--no-checks"))
    first, quiet = ticks(recipe_file)
    costs["tick of a new sensor, s"], costs["tick with nothing to do, s"] = first, quiet
    costs["content of one changed, dataset included, s"] = timed(
        times, command("build"), " in ", lambda: change(recipe_file)
    )
    change(recipe_file)
    end_servers(recipe_file)  # whose memory would not count: it was started before
    costs["the same with a new server, most memory, MB"] = run_watched(command("build"), cwd=folder).peak_mb
    end_servers(recipe_file)
    shutil.rmtree(folder)
    return costs


def make(folder: Path, number: int) -> Path:
    """Write a project of small recordings."""
    start_ns = small_drive.START_NS
    for index in range(number):
        # The same drive a minute later: other content, the same work.
        small_drive.START_NS = start_ns + index * 60 * 10**9
        small_drive.write_drive(folder / "bags" / f"r{index:05}.bag", "ros1", duration_s=DRIVE_S)
    small_drive.START_NS = start_ns
    write_project(folder, QUICK.format(name="many", root="bags"))
    return folder / "recipe.yaml"


def change(recipe_file: Path) -> None:
    """Replace one recording by a drive a little longer than it was."""
    bag = min((recipe_file.parent / "bags").iterdir())
    size = bag.stat().st_size
    bag.unlink()
    seconds = DRIVE_S + 0.2
    while not bag.exists() or bag.stat().st_size <= size:
        bag.unlink(missing_ok=True)
        small_drive.write_drive(bag, "ros1", duration_s=seconds)
        seconds += 0.2


def timed(times: int, command: list[str], expected: str = "", before: Callable[[], object] = bool) -> float:
    """Return the median time of a command, which must succeed and print what is expected."""
    seconds = []
    for _ in range(times):
        before()
        began = time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        seconds.append(time.perf_counter() - began)
        if done.returncode or expected not in done.stdout:
            raise SystemExit(done.stdout[-1000:] + done.stderr[-2000:])
    return median(seconds)


def ticks(recipe_file: Path) -> tuple[float, float]:
    """Return how long the first scan of a sensor takes, and the next."""
    done = subprocess.run(
        [sys.executable, "-c", _TICK, str(recipe_file)], stdout=subprocess.PIPE, text=True, check=True
    )
    first, second = map(float, done.stdout.split())
    return first, second


def size_of(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def end_servers(recipe_file: Path) -> None:
    for client in Client.all_of(load_recipe(recipe_file).state):
        client.shutdown(grace_s=1.0)


if __name__ == "__main__":
    main()
