"""What drives in several files cost: a build of one, beside the same drive in one file, and looking for 10,000 files again.

Builds from nothing, by turns::

    python -m benchmarks.series [--seconds 5] [--parts 5] [--times 5] [--files 10000] [--json FILE]
"""

import argparse
import json
import statistics
import sys
import tempfile
import time
from bisect import bisect_right
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Reader as Rosbag1Reader
from rosbags.rosbag1 import Writer as Rosbag1Writer

from bagassets.propose.project import write_project
from bagassets.recipe.model import Bags
from bagassets.recordings.discover import discover
from bagassets.recordings.open import open_recording
from bagassets.sample.recorder import RecordingFormat
from benchmarks.common import ROOT, Project, machine, markdown
from benchmarks.drives import tas_recipe, write_tas_drive
from benchmarks.resources import Used, run_watched

__all__ = ["series_table"]

_FORMATS: dict[str, RecordingFormat] = {".bag": "ros1", ".mcap": "mcap"}
_ROUNDS = 15


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=5.0, help="length of the drive; 90 MB per second")
    parser.add_argument("--parts", type=int, default=5)
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--files", type=int, default=10_000, help="how many are looked for")
    parser.add_argument("--json", type=Path, help="write the figures here")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        figures = {
            "seconds": chosen.seconds,
            "parts": chosen.parts,
            "builds": builds(Path(folder), chosen.seconds, chosen.parts, chosen.times),
            "discovery": discovery(Path(folder) / "many", chosen.files),
            "files": chosen.files,
        }
    print(series_table(figures), flush=True)
    if chosen.json:
        chosen.json.write_text(json.dumps({"machine": machine(), **figures}, indent=1) + "\n", "utf-8")


def series_table(figures: dict[str, Any]) -> str:
    """Return the table of `series.json`; medians."""
    rows = []
    for suffix, taken in figures["builds"].items():
        for what in ("seconds", "cpu_s"):
            whole, cut = (statistics.median(one[what] for one in taken[shape]) for shape in ("whole", "cut"))
            rows.append([f"build, {suffix}, {what}", whole, cut, cut / whole])
    alone, row = (statistics.median(figures["discovery"][name]) for name in ("alone", "row"))
    rows.append([f"discovery of {figures['files']:,} files, cpu_s", alone, row, row / alone])
    return markdown(
        ["medians", "one file, or not numbered", f"{figures['parts']} parts, or one row", "ratio"], rows
    )


def builds(
    folder: Path, seconds: float, parts: int, times: int
) -> dict[str, dict[str, list[dict[str, float]]]]:
    """Return suffix -> shape of the drive -> what each build from nothing took."""
    taken: dict[str, dict[str, list[dict[str, float]]]] = {}
    for suffix, file_format in _FORMATS.items():
        shapes = {name: _project(folder / f"{file_format}-{name}", times) for name in ("whole", "cut")}
        drive = write_tas_drive(shapes["whole"].bags / f"drive{suffix}", file_format, 0, seconds)
        cut(drive, [seconds * number / parts for number in range(1, parts)], shapes["cut"].bags)
        taken[suffix] = {name: [] for name in shapes}
        for _ in range(times):
            for name, made in shapes.items():
                used = _build(made)
                taken[suffix][name].append({"seconds": used.seconds, "cpu_s": used.cpu_s})
        for made in shapes.values():
            made.stop_server()
    return taken


def cut(drive: Path, cuts_s: list[float], folder: Path) -> None:
    """Write the messages of a drive as parts in another folder, as a recorder that splits does."""
    paths = [folder / f"{drive.stem}_{number}{drive.suffix}" for number in range(len(cuts_s) + 1)]
    with ExitStack() as stack:
        write = _cut_bag if drive.suffix == ".bag" else _cut_mcap
        write(drive, cuts_s, paths, stack)


def _cut_bag(drive: Path, cuts_s: list[float], paths: list[Path], stack: ExitStack) -> None:
    reader = stack.enter_context(Rosbag1Reader(drive))
    writers = [stack.enter_context(Rosbag1Writer(path)) for path in paths]
    connections = [
        {
            one.id: writer.add_connection(one.topic, one.msgtype, msgdef=one.msgdef.data, md5sum=one.digest)
            for one in reader.connections
        }
        for writer in writers
    ]
    start_ns = reader.start_time
    for connection, time_ns, data in reader.messages():
        number = bisect_right(cuts_s, (time_ns - start_ns) / 1e9)
        writers[number].write(connections[number][connection.id], time_ns, bytes(data))


def _cut_mcap(drive: Path, cuts_s: list[float], paths: list[Path], stack: ExitStack) -> None:
    recording = stack.enter_context(open_recording(drive))
    writers, channels = [], []
    for path in paths:
        writer = McapWriter(stack.enter_context(path.open("wb")), compression=CompressionType.NONE)
        writer.start("ros2", "benchmark")
        stack.callback(writer.finish)
        made = {}
        for name, topic in recording.topics.items():
            schema = writer.register_schema(topic.msgtype, "ros2msg", topic.definition.text.encode())
            made[name] = writer.register_channel(name, "cdr", schema)
        writers.append(writer)
        channels.append(made)
    start_ns = None
    for message in recording.messages(list(recording.topics)):
        time_ns = message.log_time_ns
        start_ns = time_ns if start_ns is None else start_ns
        number = bisect_right(cuts_s, (time_ns - start_ns) / 1e9)
        writers[number].add_message(channels[number][message.topic], time_ns, bytes(message.data), time_ns)


def discovery(folder: Path, files: int) -> dict[str, list[float]]:
    """Return the processor time of looking for files again, in one numbered row and otherwise, by turns."""
    taken: dict[str, list[float]] = {}
    for name, stem in (("alone", "drive-"), ("row", "drive_")):
        for number in range(files):
            _write_small(folder / name / f"{stem}{number}.mcap", number)
        discover(Bags(root=folder / name))
        taken[name] = []
    for _ in range(_ROUNDS):
        for name, times in taken.items():
            began = time.process_time()
            discover(Bags(root=folder / name))
            times.append(time.process_time() - began)
    return taken


def _write_small(path: Path, number: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros2", "benchmark")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/a", "cdr", schema)
        for time_ns in (number * 10**9, number * 10**9 + 5 * 10**8):
            writer.add_message(channel, time_ns, b"\0\1\0\0\1\0\0\0\0", time_ns)
        writer.finish()  # type: ignore[no-untyped-call]  # the library has no types here


def _project(folder: Path, times: int) -> Project:
    write_project(folder, tas_recipe(Path("recordings")))
    made = Project(folder / "recipe.yaml", times)
    made.bags.mkdir(exist_ok=True)
    return made


def _build(made: Project) -> Used:
    made.start_over()
    made.hash_at_client()
    made.settle()
    used = run_watched([sys.executable, "-m", "bagassets", "build", "--recipe", str(made.recipe)], cwd=ROOT)
    if used.code:
        sys.exit(f"{made.recipe}: the build ended with {used.code}")
    return used


if __name__ == "__main__":
    main()
