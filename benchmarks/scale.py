"""What commands cost with 10 to 100,000 recordings: time, memory and Dagster's records, and how that grows.

The recordings are real, and really built, but tiny, since what counts here is what each costs beside its work. Where there
are many, `--base` of them are built, and the others are copies of these (see `benchmarks.replicate`), but for their tables::

    python -m benchmarks.scale [--numbers 10 100 1000 10000] [--replicated 30000 100000] [--unbuilt 40000]
        [--postgres] [--folder DIR] [--json benchmarks/results/scale.json]

Growth is the exponent b of a power law, number^b, fitted to the numbers from 1,000 on (to all, if these are less than two).

A project is removed only once the next one has been built: ext4 without a journal does not give away the inodes of removed
files for minutes, and looks at each of them whenever a file is created, which then takes up to forty times as long. For the
same reason, remove nothing large in the minutes before.
"""

import argparse
import io
import json
import math
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack, redirect_stdout
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
from bagassets.forkserver.client import Client
from bagassets.formats.dataset_build import datasets_of
from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets_tests import small_drive
from bagassets_tests.in_process import QUICK
from bagassets_tests.postgres_server import running_postgres, use_postgres
from benchmarks.common import machine, markdown, median
from benchmarks.replicate import add_unbuilt, replicate
from benchmarks.resources import Used, run_watched

__all__ = ["scale_table", "unbuilt_table"]

NUMBERS = (10, 100, 1000)
DRIVE_S = 2.0  # less is no scene, and a dataset of nothing costs nothing
# A tick of the sensor as its code server evaluates it, with all that it needs imported.
_TICK = """
import sys, time
from pathlib import Path
from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.graph.sensor_cursor import Cursor
from bagassets.defs.graph.sensor_scan import Scan
with open_project(Path(sys.argv[1])) as workspace:
    cursor = Cursor()
    for _ in range(2):
        began = time.perf_counter()
        requests = Scan(workspace, cursor).scan(time.time())
        print(time.perf_counter() - began)
    assert requests == [], requests
"""
# What a build does first with recordings that are gone, without making the others.
_REMOVE = """
import sys, time
from pathlib import Path
from bagassets.defs.builds.loop import BuildLoop
from bagassets.defs.builds.own_states import load_own
from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.records.partitions import remove_partitions
from bagassets.engine.build_report import BuildOptions
with open_project(Path(sys.argv[1])) as workspace:
    gone = workspace.discover().removed(workspace.records.live())
    began = time.perf_counter()
    remove_partitions(workspace.records, gone)
    print(time.perf_counter() - began, len(gone))
"""
_MANY = 1000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--numbers", type=int, nargs="*", default=list(NUMBERS), help="of recordings that are built"
    )
    parser.add_argument(
        "--replicated", type=int, nargs="*", default=[], help="of recordings, most of them copies"
    )
    parser.add_argument("--base", type=int, default=500, help="how many of those are built")
    parser.add_argument(
        "--unbuilt", type=int, nargs="*", default=[], help="of recordings that are only registered"
    )
    parser.add_argument("--postgres", action="store_true", help="keep Dagster's records in PostgreSQL")
    parser.add_argument("--times", type=int, default=3, help="how often each command is run")
    parser.add_argument("--folder", type=Path, help="where to work; default: a temporary folder")
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    if any(number % options.base for number in options.replicated):
        parser.error("--replicated must be multiples of --base")
    found: dict[str, Any] = {
        "machine": machine(),
        "database": "PostgreSQL" if options.postgres else "SQLite",
        "base": options.base,
        "built": {"numbers": sorted(options.numbers + options.replicated), "costs": {}},
        "replicated": sorted(options.replicated),
        "unbuilt": {"numbers": sorted(options.unbuilt), "costs": {}},
    }
    with ExitStack() as stack:
        work = tempfile.TemporaryDirectory(dir=options.folder, ignore_cleanup_errors=True)
        folder = Path(stack.enter_context(work))
        server = stack.enter_context(running_postgres()) if options.postgres else None
        former: list[Path] = []
        for kind, measure in (("built", measure_built), ("unbuilt", measure_unbuilt)):
            for number in found[kind]["numbers"]:
                built = options.base if number in options.replicated else number
                recipe_file = make(folder / f"{kind}{number}", built if kind == "built" else 1)
                if server is not None:
                    server.create_database(f"{kind}{number}")
                    use_postgres(recipe_file, server.url_of(f"{kind}{number}"))
                for name, value in measure(recipe_file, number, built, options.times, former).items():
                    found[kind]["costs"].setdefault(name, []).append(value)
                    print(f"{number:6} {name:60} {'' if value is None else f'{value:.4g}'}", flush=True)
                end_servers(recipe_file)
                former.append(recipe_file.parent)
                if options.json is not None:  # as far as it has come
                    options.json.write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    print(scale_table(found))
    print(unbuilt_table(found))


def scale_table(found: dict[str, Any]) -> str:
    """Return the table of `scale.json`, with the growth of each row."""
    copied = found["replicated"]
    heads = [f"{number:,}{' (copies)' if number in copied else ''}" for number in found["built"]["numbers"]]
    return _table(found["built"], heads)


def unbuilt_table(found: dict[str, Any]) -> str:
    """Return the table of recordings that are only registered."""
    if not found["unbuilt"]["numbers"]:
        return "not measured yet"
    return _table(found["unbuilt"], [f"{number:,}" for number in found["unbuilt"]["numbers"]])


def _table(found: dict[str, Any], heads: list[str]) -> str:
    rows = [
        [name, *map(_shown, values), growth(found["numbers"], values)]
        for name, values in found["costs"].items()
    ]
    return markdown(["", *heads, "growth"], rows)


def _shown(value: float | None) -> str:
    return "" if value is None else f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"


def growth(numbers: Sequence[int], values: Sequence[float | None]) -> str:
    """Return the exponent of a power law that is fitted to costs, by least squares of logarithms."""
    known = [(n, v) for n, v in zip(numbers, values, strict=True) if v is not None and v > 0]
    many = [one for one in known if one[0] >= _MANY]
    points = [(math.log(n), math.log(v)) for n, v in (many if len(many) > 1 else known)]
    if len(points) < 2:
        return ""
    x, y = zip(*points, strict=True)
    return f"{statistics.linear_regression(x, y).slope:.2f}"


def measure_built(
    recipe_file: Path, number: int, built: int, times: int, former: list[Path]
) -> dict[str, float | None]:
    """Return what everything costs with so many recordings, of which `built` are really built; remove `former` projects."""
    folder, recipe = recipe_file.parent, load_recipe(recipe_file)

    def command(*arguments: str) -> list[str]:
        return [sys.executable, "-m", "bagassets", *arguments, "--recipe", str(recipe_file)]

    first = watched(command("build"), folder)
    if number > built:
        end_servers(recipe_file)
        replicate(recipe_file, number // built - 1)
        watched(command("build"), folder)
    remove(former)
    dataset = datasets_of(recipe)["nuscenes_dataset"].folder
    scenes = json.loads((dataset / "scene.json").read_bytes())
    if len(scenes) != number:
        raise SystemExit(f"{number} recordings became {len(scenes)} scenes; each must have one")
    costs: dict[str, float | None] = {}
    is_first = number == built
    costs["first build, s"] = first.seconds if is_first else None
    costs["first build, ms each"] = first.seconds * 1e3 / number if is_first else None
    costs["first build, processor time, s"] = first.cpu_s if is_first else None
    costs["first build, most memory, MB"] = first.peak_mb if is_first else None
    records = recipe.state / "dagster"
    if (records / "history").is_dir():
        costs["Dagster's records, MB"] = size_of(records) / 1e6
    costs["nothing to do, s"] = timed(times, command("build"), "nothing to do")
    end_servers(recipe_file)  # which would carry them out
    costs["first build, `check` after it, s"] = timed(1, command("check")) if is_first else None
    for name, arguments in (
        ("status", ["status"]),
        ("build --dry-run", ["build", "--dry-run"]),
        ("check", ["check"]),
        ("report", ["report"]),
    ):
        costs[f"`{name}` without a server, s"] = timed(times, command(*arguments))
        costs[f"`{name}`, most memory, MB"] = watched(command(*arguments), folder).peak_mb
    costs["tick of a new sensor, s"], costs["tick with nothing to do, s"] = ticks(recipe_file)
    seconds, copies = [], []
    for _ in range(times + 1):
        before = tables_of(dataset)
        change(recipe_file)
        seconds.append(timed(1, command("build"), " in "))
        changed = [file for file, inode in tables_of(dataset).items() if before.get(file) != inode]
        copies.append(copied_s(changed, folder))
    # The first one starts the server.
    costs["content of one changed, dataset included, s"] = median(seconds[1:])
    costs["plain copy of the tables that this changed, s"] = median(copies[1:])
    costs["these tables, MB"] = sum(file.stat().st_size for file in changed) / 1e6
    costs["one changed beyond that copy, s"] = median(seconds[1:]) - median(copies[1:])
    change(recipe_file)
    end_servers(recipe_file)  # whose memory would not count: it was started before
    costs["the same with a new server, most memory, MB"] = watched(command("build"), folder).peak_mb
    return costs


def measure_unbuilt(
    recipe_file: Path, number: int, _: int, times: int, former: list[Path]
) -> dict[str, float | None]:
    """Return what commands cost where so many recordings are registered, and none is built; and removing half of them."""
    remove(former)
    folder, bags = recipe_file.parent, load_recipe(recipe_file).bags.root

    def command(*arguments: str) -> list[str]:
        return [sys.executable, "-m", "bagassets", *arguments, "--recipe", str(recipe_file)]

    watched(command("build"), folder)
    end_servers(recipe_file)
    began = time.perf_counter()
    add_unbuilt(recipe_file, number)
    costs: dict[str, float | None] = {"registering them, s": time.perf_counter() - began}
    for name, arguments in (("status", ["status"]), ("build --dry-run", ["build", "--dry-run"])):
        costs[f"`{name}`, s"] = timed(times, command(*arguments), failing=True)
        costs[f"`{name}`, most memory, MB"] = watched(command(*arguments), folder, failing=True).peak_mb
    for file in sorted(bags.glob("u*"))[: number // 2]:
        file.unlink()
    done = subprocess.run(
        [sys.executable, "-c", _REMOVE, str(recipe_file)], capture_output=True, text=True, check=True
    )
    costs["removing half of them, s"], removed = map(float, done.stdout.split())
    if removed != number // 2:
        raise SystemExit(f"{removed} partitions were removed, not {number // 2}")
    return costs


def watched(command: list[str], folder: Path, *, failing: bool = False) -> Used:
    """Run a command, which must succeed, and return what it used."""
    with redirect_stdout(io.StringIO() if failing else sys.stdout):
        used = run_watched(command, cwd=folder)
    if used.code and not failing:
        raise SystemExit(f"{' '.join(command)}: ended with status {used.code}")
    return used


def tables_of(dataset: Path) -> dict[Path, int]:
    """Return each file of a dataset's own, which are no links to artifacts -> its inode."""
    found = [path for path in dataset.rglob("*") if path.is_file() and path.suffix == ".json"]
    return {path: path.stat().st_ino for path in found}


def copied_s(files: Sequence[Path], folder: Path) -> float:
    """Return how long it takes to copy files, and to have them on the disk as a build does."""
    with tempfile.TemporaryDirectory(dir=folder) as target:
        began = time.perf_counter()
        for index, file in enumerate(files):
            shutil.copyfile(file, f"{target}/{index}")
        return time.perf_counter() - began


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


def timed(times: int, command: list[str], expected: str = "", *, failing: bool = False) -> float:
    """Return the median time of a command, which must succeed and print what is expected."""
    seconds = []
    for _ in range(times):
        began = time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        seconds.append(time.perf_counter() - began)
        if (done.returncode and not failing) or expected not in done.stdout:
            raise SystemExit(done.stdout[-1000:] + done.stderr[-2000:])
    return median(seconds)


def ticks(recipe_file: Path) -> tuple[float, float]:
    """Return how long the first scan of a sensor takes, and the next."""
    done = subprocess.run(
        [sys.executable, "-c", _TICK, str(recipe_file)], stdout=subprocess.PIPE, text=True, check=True
    )
    first, second = map(float, done.stdout.split())
    return first, second


def remove(folders: list[Path]) -> None:
    while folders:
        shutil.rmtree(folders.pop())


def size_of(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def end_servers(recipe_file: Path) -> None:
    for client in Client.all_of(load_recipe(recipe_file).state):
        client.shutdown(grace_s=1.0)


if __name__ == "__main__":
    main()
