"""What all benchmarks share: the project they work in, the conversions they compare, and how results are kept."""

import json
import os
import platform
import shlex
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest
from bagassets.recordings.digest_record import ATTRIBUTE
from bagassets.recordings.discover import discover
from bagassets.recordings.model import RecordingFiles
from bagassets.sample.recorder import RecordingFormat
from benchmarks.drives import LEAST_BYTES, seconds_of, tas_recipe, write_tas_drive
from benchmarks.incremental import Bench, count_files
from benchmarks.plain import plain_command

__all__ = [
    "Converted",
    "Options",
    "Project",
    "converter_command",
    "count_files",
    "machine",
    "markdown",
    "median",
    "plain_command",
    "project",
    "repeated",
    "save",
    "speedup",
    "write_drives",
]

ROOT = Path(__file__).parents[1]
_PACKAGES = (
    "bagassets",
    "dagster",
    "rosbags",
    "mcap",
    "opencv-python-headless",
    "numpy",
    "llvmlite",
    "velodyne-decoder",
)

_SUFFIXES: dict[RecordingFormat, str] = {"ros1": ".bag", "ros2": "", "mcap": ".mcap"}


@dataclass(frozen=True)
class Options:
    """What is asked of the benchmarks.

    Attributes:
        folder: where to work; needs room for recordings and results.
        results: where tables and figures go.
        trials: how often each time is taken.
        size_gb: recordings of RQ1 together; the others follow from it.
        recordings: their number.
        converter: another converter, with `{bag}` and `{out}`; None for none.
        tiny: recordings as small as can be, to try a benchmark out; its figures say nothing.
    """

    folder: Path
    results: Path
    trials: int
    size_gb: float
    recordings: int
    converter: str | None
    tiny: bool = False


@dataclass(frozen=True)
class Converted:
    """What a conversion came to: seconds, files it left, and recordings it left nothing of or failed on."""

    seconds: float
    files: int
    failed: tuple[str, ...] = ()


class Project(Bench):
    """A project of drives of the profile `tas`; see `Bench` for what can happen to it."""

    def hash_at_client(self) -> None:
        """Take the stored digests away: the next build hashes for itself."""
        for file in self.files():
            if ATTRIBUTE in os.listxattr(file):
                os.removexattr(file, ATTRIBUTE)

    def store_digests(self) -> None:
        """Have digests stored, as `bagassets watch` does on the machine that has the disks."""
        for recording in discover(load_recipe(self.recipe).bags).recordings.values():
            recording_digest(recording)

    def touch(self) -> None:
        """Give one recording another date; its content stays."""
        os.utime(self.bag())

    def touch_all(self) -> None:
        """Give all recordings another date; their content stays."""
        for path in self.bags.iterdir():
            os.utime(path)

    def settle(self) -> None:
        """Have the disk finish what was written, and the recordings in the page cache, whoever is next."""
        os.sync()
        for file in self.files():
            with file.open("rb", buffering=0) as stream:
                while stream.read(1 << 24):
                    pass

    def files(self) -> list[Path]:
        """Return all files of all recordings."""
        recordings = discover(load_recipe(self.recipe).bags).recordings.values()
        return [file for recording in recordings for file in recording.files]

    @property
    def size_gb(self) -> float:
        """Size of all recordings."""
        return sum(file.stat().st_size for file in self.files()) / 1e9

    def convert_plainly(self) -> Converted:
        """Convert all recordings one after the other with the same code, as `benchmarks.plain` says."""
        out = self._empty_output()
        self.settle()
        began = time.perf_counter()
        done = subprocess.run(plain_command(self.bags, out), check=False, cwd=ROOT, env=self._environment())
        seconds = time.perf_counter() - began
        files = count_files(out)
        if done.returncode or not files:
            sys.exit(f"the plain conversion ended with {done.returncode} and left {files} files")
        return Converted(seconds, files)

    def convert_with(self, converter: str) -> Converted:
        """Run another converter on one recording after the other, and count what it leaves.

        Many converters report errors and end with 0 all the same: one that leaves no file has failed.
        """
        out = self._empty_output()
        self.settle()
        seconds, failed = 0.0, []
        for recording in discover(load_recipe(self.recipe).bags).recordings.values():
            target = out / recording.key
            target.mkdir()
            command = converter_command(converter, recording, target)
            began = time.perf_counter()
            done = subprocess.run(command, check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            seconds += time.perf_counter() - began
            if done.returncode or not count_files(target):
                failed.append(recording.key)
        return Converted(seconds, count_files(out), tuple(failed))

    def _environment(self) -> dict[str, str]:
        return {**os.environ, "BENCH_RECIPE": str(self.recipe)}

    def _empty_output(self) -> Path:
        out = self.recipe.parent / "out"
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        return out


def converter_command(converter: str, recording: RecordingFiles, out: Path) -> list[str]:
    """Return the command that converts one recording; of a ROS 2 folder, converters are given the `.db3` file."""
    databases = [file for file in recording.files if file.suffix == ".db3"]
    bag = databases[0] if databases else recording.path
    return [part.format(bag=bag, out=out) for part in shlex.split(converter)]


def project(
    folder: Path,
    drives: Sequence[float],
    trials: int,
    *,
    first_seed: int = 0,
    formats: Sequence[RecordingFormat] = ("ros1", "ros2"),
) -> Project:
    """Write drives of the given sizes in bytes, in each format by turns, and make a project of them.

    No drive is shorter than `LEAST_BYTES`, which make a scene. All have different seeds: equal content would be
    converted once.
    """
    write_project(folder, tas_recipe(Path("recordings")))
    made = Project(folder / "recipe.yaml", trials)
    made.bags.mkdir(exist_ok=True)
    write_drives(made.bags, drives, first_seed=first_seed, formats=formats)
    return made


def write_drives(
    bags: Path,
    drives: Sequence[float],
    *,
    first_seed: int,
    formats: Sequence[RecordingFormat] = ("ros1", "ros2"),
    prefix: str = "drive",
) -> None:
    """Write drives as `project` does, some at a time."""
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        written = []
        for number, size in enumerate(drives):
            kind = formats[number % len(formats)]
            path = bags / f"{prefix}{number:03}{_SUFFIXES[kind]}"
            seconds = seconds_of(max(size, LEAST_BYTES))
            written.append(pool.submit(write_tas_drive, path, kind, first_seed + number, seconds))
        for one in written:
            one.result()


def repeated(trials: int, before: Callable[[], Any], timed: Callable[[], float]) -> list[float]:
    """Return `trials` times of `timed`, each after `before`."""
    times = []
    for _ in range(trials):
        before()
        os.sync()  # what was written before is not part of it
        times.append(timed())
    return times


def median(times: Sequence[float]) -> float:
    """Return the median."""
    return float(statistics.median(times))


def speedup(base: Sequence[float], method: Sequence[float]) -> tuple[float, float]:
    """Return T_base / T_method and the reduction (1 - T_method / T_base) in percent, of medians."""
    ratio = median(base) / median(method)
    return ratio, (1 - 1 / ratio) * 100


def machine() -> dict[str, Any]:
    """Return what figures depend on: processors, memory, system, versions."""
    return {
        "processor": _processor(),
        "processors": len(os.sched_getaffinity(0)),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1),
        "load_average": round(os.getloadavg()[0], 2),
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in _PACKAGES},
    }


def markdown(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a Markdown table; numbers to three digits."""
    lines = [
        header,
        ["---", *["--:"] * (len(header) - 1)],
        *[[_cell(value) for value in row] for row in rows],
    ]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


def save(options: Options, name: str, figures: Mapping[str, Any], table: str) -> None:
    """Write `<name>.json` and `<name>.md`, and print the table."""
    options.results.mkdir(parents=True, exist_ok=True)
    converter = None
    if options.converter is not None:  # without the folders of this machine
        words = shlex.split(options.converter)
        converter = " ".join(Path(word).name if word.startswith("/") else word for word in words)
    content = {"machine": machine(), "trials": options.trials, "converter": converter, **figures}
    (options.results / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n", "utf-8")
    (options.results / f"{name}.md").write_text(table, "utf-8")
    print(table, flush=True)


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
    return str(value)


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text("utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
