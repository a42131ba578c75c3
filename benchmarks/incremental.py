"""What a build costs, cold, warm and after a change, beside a plain conversion of the same recordings.

Writes recordings of the profile `tas` with different seeds and builds them::

    python benchmarks/incremental.py [--bags 8] [--seconds 2.8] [--times 3] [--json FILE]
        [--external 'converter {bags} {output}']

Every mode is run `--times` times and the median printed. `plain` is a sequential conversion with the same
code: no store, no digests, no pictures, no Dagster, one process for all recordings. An external converter is called with
the folder of the recordings and an empty output folder; the files it leaves are counted, since one that
fails quietly must not look fast.
"""

import argparse
import json
import os
import shlex
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
from bagassets.forkserver.client import Client
from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest
from bagassets.recordings.digest_record import ATTRIBUTE
from bagassets.recordings.discover import find_one
from benchmarks.drives import tas_recipe, write_tas_drive
from benchmarks.plain import plain_command
from benchmarks.rewrite import rewrite

ROOT = Path(__file__).parents[1]
CAMERA = "/cam_front/image_raw"
_MARK = 16  # bytes changed amid a message: fits between the block headers of a lidar packet
_FEWEST_FILES = 20  # per recording, of a second or more
DECODING = {"frames", "sweeps"}


@dataclass
class Bench:
    """A project, and what was measured with it.

    Attributes:
        recipe: its recipe file.
        times: how often each mode is run.
        figures: mode -> seconds of each time, and what ran.
    """

    recipe: Path
    times: int
    figures: dict[str, dict[str, Any]] = field(default_factory=dict)
    change: int = 0

    @property
    def bags(self) -> Path:
        """Folder of the recordings."""
        return self.recipe.parent / "recordings"

    @property
    def state(self) -> Path:
        """State folder of the recipe."""
        return load_recipe(self.recipe).state

    def measure(
        self, mode: str, before: Callable[[], None], expected: str, *, times: int | None = None
    ) -> None:
        """Run a build after `before` some times; the last line must say what is expected."""
        seconds, ran = [], set()
        for _ in range(times or self.times):
            before()
            os.sync()  # what was written before is not part of it
            known = set(self.actions())
            seconds.append(self.build(expected))
            ran = {name for digest, name in self.actions().items() if digest not in known}
        self.note(mode, seconds, ran=sorted(ran), files=count_files(self.recipe.parent / "nuscenes"))

    def note(self, mode: str, seconds: list[float], **more: Any) -> None:
        """Keep and print what was measured."""
        self.figures[mode] = {"median_s": statistics.median(seconds), "seconds": seconds, **more}
        print(f"{mode:34} {statistics.median(seconds):8.2f} s  {more.get('ran', '')}", flush=True)

    def build(self, expected: str) -> float:
        """Return the wall time of a build, which must print what is expected."""
        command = [sys.executable, "-m", "bagassets", "build", "--recipe", str(self.recipe)]
        began = time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
        seconds = time.perf_counter() - began
        if done.returncode or expected not in done.stdout:
            sys.exit(f"build: {done.returncode}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
        return seconds

    def actions(self) -> dict[str, str]:
        """Return digest -> step and channel of every action in the store."""
        found = {}
        for path in (self.state / "store" / "actions").glob("*/*.json"):
            action = json.loads(path.read_bytes())["action"]
            channel = action["params"].get("channel")
            found[path.stem] = action["step"] + (f":{channel}" if channel else "")
        return found

    # --- what happens before a build ---

    def stop_server(self) -> None:
        """End the fork server and wait until it is gone."""
        for client in Client.all_of(self.state):
            process = client.process
            client.shutdown(grace_s=1.0)
            while process.is_alive():
                time.sleep(0.02)

    def start_over(self) -> None:
        """Keep nothing but the recordings."""
        self.stop_server()
        shutil.rmtree(self.state)
        shutil.rmtree(self.recipe.parent / "nuscenes", ignore_errors=True)
        write_project(self.recipe.parent, None)

    def forget_results(self) -> None:
        """Keep the server, but neither store nor records."""
        for name in ("store", "dagster", "freshness.sqlite"):
            path = self.state / name
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        shutil.rmtree(self.recipe.parent / "nuscenes", ignore_errors=True)
        write_project(self.recipe.parent, None)

    def change_content(self) -> None:
        """Change every image and every lidar packet of one recording, as another drive would."""
        self.change += 1
        mark = blake2b(str(self.change).encode(), digest_size=_MARK).digest()
        rewrite(self.bag(), lambda topic, data: patched(data, mark) if is_bulk(topic) else data)

    def change_camera(self) -> None:
        """Change the images of one camera in one recording."""
        self.change += 1
        mark = blake2b(str(self.change).encode(), digest_size=_MARK).digest()
        rewrite(self.bag(), lambda topic, data: patched(data, mark) if topic == CAMERA else data)

    def change_metadata(self) -> None:
        """Change a message that nothing reads, in one recording."""
        self.change += 1
        rewrite(self.bag(), note=f"change {self.change}")

    def bag(self) -> Path:
        """Return the recording that changes."""
        return min(self.bags.glob("*.bag"))


def is_bulk(topic: str) -> bool:
    return topic.endswith(("/image_raw", "packets"))


def patched(data: bytes, mark: bytes) -> bytes:
    """Put some bytes amid a message: in pixels, or in distances; a pixel alone may make no other JPEG.

    An image is hit half a row (of 1920 pixels) beyond its middle, which is an edge: undistortion drops those.
    """
    place = len(data) // 2 + (900 if len(data) > 1_000_000 else 0)
    return data[:place] + mark + data[place + len(mark) :]


def count_files(folder: Path) -> int:
    return sum(1 for path in folder.rglob("*") if path.is_file())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--bags", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=2.8, help="length of each; 90 MB per second")
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--external", help="another converter; {bags} and {output} are filled in")
    parser.add_argument("--folder", type=Path, help="where to work; default: a temporary folder")
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder, ignore_cleanup_errors=True) as folder:
        bench = prepare(Path(folder) / "project", options.bags, options.seconds, options.times)
        run(bench, options.external)
        bench.stop_server()
        digests(bench)
        if options.json is not None:
            about = {"bags": options.bags, "bytes": sizes(bench.bags), "processors": os.cpu_count()}
            about |= {"trials": options.times, "modes": bench.figures}
            options.json.write_text(json.dumps(about, indent=1) + "\n", "utf-8")


def incremental_table(found: dict[str, Any]) -> str:
    """Return the table of `incremental.json`: medians, and which steps ran."""
    size_mb = found["bytes"] / found["bags"] / 1e6
    lines = [f"| {found['bags']} recordings of {size_mb:.0f} MB | | what ran |", "|---|--:|---|"]
    for mode, one in found["modes"].items():
        steps = sorted({name.partition(":")[0] for name in one.get("ran", ())})
        lines.append(f"| {mode} | {one['median_s']:.2f} s | {', '.join(steps)} |")
    return "\n".join(lines) + f"\n\nMedians of {found['trials']}.\n"


def prepare(folder: Path, bags: int, seconds: float, times: int) -> Bench:
    write_project(folder, tas_recipe(Path("recordings")))
    bench = Bench(folder / "recipe.yaml", times)
    for seed in range(bags):
        write_tas_drive(bench.bags / f"drive{seed}.bag", "ros1", seed, seconds)
    print(f"{bags} recordings, {sizes(bench.bags) / 1e6:.0f} MB, {os.cpu_count()} processors", flush=True)
    return bench


def run(bench: Bench, external: str | None) -> None:
    alone = bench.recipe.parent / "alone"
    alone.mkdir()
    os.link(bench.bag(), alone / bench.bag().name)
    conversions: list[tuple[str, Callable[[Path, Path], list[str]]]] = [("plain", plain_command)]
    if external is not None:
        conversions.append(
            ("external", lambda bags, out: shlex.split(external.format(bags=bags, output=out)))
        )
    for name, command in conversions:
        for what, bags in (("all", bench.bags), ("one recording", alone)):
            done = [convert(command(bags, bench.recipe.parent / "out"), bench) for _ in range(bench.times)]
            bench.note(f"{name}, {what}", [seconds for seconds, _ in done], files=done[-1][1])

    def nothing() -> None:
        pass

    bench.measure("cold, server down", bench.start_over, "built in")
    bench.measure("cold, server up", bench.forget_results, "built in")
    files, expected = (bench.figures[mode]["files"] for mode in ("cold, server up", "plain, all"))
    if files != expected or files < _FEWEST_FILES * len(list(bench.bags.glob("*.bag"))):
        sys.exit(
            f"the build left {files} files, the plain conversion {expected}: recordings too short for a scene?"
        )
    bench.measure("warm, server up", nothing, "nothing to do", times=3 * bench.times)
    bench.measure("warm, server down", bench.stop_server, "nothing to do")
    bench.build("nothing to do")
    for mode, change in (
        ("one recording changed", bench.change_content),
        ("one camera changed", bench.change_camera),
        ("metadata only", bench.change_metadata),
    ):
        change()
        bench.build(" in ")  # the server is up from here on
        bench.measure(f"{mode}, server up", change, " in ")
    ran = {name.split(":")[0] for name in bench.figures["metadata only, server up"]["ran"]}
    if ran & DECODING:
        sys.exit(f"a change of metadata ran {sorted(ran)}")

    def stop_and_change() -> None:
        bench.change_content()
        bench.stop_server()

    bench.measure("one recording changed, server down", stop_and_change, " in ")
    figures = bench.figures
    limit = 1.3 * figures["plain, one recording"]["median_s"] + 0.8
    print(f"{'one recording changed, allowed':34} {limit:8.2f} s  (1.3 x plain alone + 0.8 s)")


def convert(command: list[str], bench: Bench) -> tuple[float, int]:
    """Run a converter; return its time in seconds and how many files it left."""
    out = bench.recipe.parent / "out"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    os.sync()
    began = time.perf_counter()
    done = subprocess.run(
        command, check=False, cwd=ROOT, env={**os.environ, "BENCH_RECIPE": str(bench.recipe)}
    )
    seconds = time.perf_counter() - began
    files = count_files(out)
    shutil.rmtree(out)
    if done.returncode or not files:
        sys.exit(f"{command} ended with {done.returncode} and left {files} files")
    return seconds, files


def digests(bench: Bench) -> None:
    """Measure what stored digests save: the same bytes in one, two and eight files."""
    data = bench.bag().read_bytes()
    for number in (1, 2, 8):
        folder = bench.recipe.parent / f"split{number}"
        folder.mkdir()
        recordings = [find_one(path) for path in split(data, number, folder)]
        hashed: list[float] = []
        stored: list[float] = []
        for _ in range(bench.times):
            for recording in recordings:
                os.removexattr(recording.files[0], ATTRIBUTE) if has_attribute(recording.files[0]) else None
            for seconds in (hashed, stored):
                began = time.perf_counter()
                for recording in recordings:
                    recording_digest(recording)
                seconds.append(time.perf_counter() - began)
        bench.note(f"digest of {number} file(s), hashed", hashed)
        bench.note(f"digest of {number} file(s), stored", stored)


def split(data: bytes, number: int, folder: Path) -> Iterator[Path]:
    size = -(-len(data) // number)
    for index in range(number):
        path = folder / f"{index}.bag"
        path.write_bytes(data[index * size : (index + 1) * size])
        yield path


def has_attribute(path: Path) -> bool:
    try:
        return ATTRIBUTE in os.listxattr(path)
    except OSError:
        return False


def sizes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.glob("*.bag"))


if __name__ == "__main__":
    main()
