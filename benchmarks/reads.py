"""How often a cold build reads a recording from the disk, if the page cache cannot keep it.

The build, its server and all workers run in a control group whose memory is smaller than the recording. Needs root::

    python -m benchmarks.reads [--size 3] [--memory 0.9] [--json FILE]
"""

import argparse
import ctypes
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from bagassets.forkserver.client import Client
from bagassets.recipe import load_recipe
from bagassets.sample.recorder import RecordingFormat
from benchmarks.common import ROOT, Project, machine, markdown, project

__all__ = ["reads_table"]

_FORMATS: dict[RecordingFormat, str] = {"ros1": "ROS 1 bag", "ros2": "ROS 2 bag (SQLite)", "mcap": "MCAP"}
_WARM_UP_BYTES = 27e6
_SET_CHILD_SUBREAPER = 36  # prctl.h


@contextmanager
def _cgroup(limit_bytes: int) -> Iterator[Path]:
    """Make a control group with this much memory, page cache included; yield the file that takes its processes."""
    root = Path("/sys/fs/cgroup")
    unified = (root / "cgroup.controllers").exists()
    folder = (root if unified else root / "memory") / f"bagassets-bench-{os.getpid()}"
    folder.mkdir()
    try:
        limit = "memory.max" if unified else "memory.limit_in_bytes"
        (folder / limit).write_text(str(limit_bytes), "ascii")
        yield folder / "cgroup.procs"
    finally:
        folder.rmdir()


def _build_and_count(recipe: Path, group: Path) -> None:
    """Build in a control group, and print how many bytes this process and all its descendants read from disks.

    The kernel adds to a process what the children had read that it waited for. The server leaves its parent, so this
    process has to be the one that orphans are given to.
    """
    ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    group.write_text(str(os.getpid()), "ascii")
    command = [sys.executable, "-m", "bagassets", "build", "--recipe", str(recipe)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    for client in Client.all_of(load_recipe(recipe).state):
        client.shutdown(grace_s=1.0)
    with suppress(ChildProcessError):
        while True:
            os.wait()
    if done.returncode:
        sys.exit(f"build: {done.returncode}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    fields = dict(line.split(": ") for line in Path("/proc/self/io").read_text("ascii").splitlines())
    print(fields["read_bytes"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--size", type=float, default=3.0, metavar="GB", help="of each recording (default 3)")
    parser.add_argument(
        "--memory",
        type=float,
        default=0.9,
        metavar="GB",
        help="of the build, page cache included (default 0.9)",
    )
    parser.add_argument("--folder", type=Path, help="where to work; what is there is used again")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--counted", nargs=2, type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.counted:
        _build_and_count(*options.counted)
        return
    with tempfile.TemporaryDirectory(prefix="bagassets-bench-", ignore_cleanup_errors=True) as temporary:
        folder = (options.folder or Path(temporary)).absolute()
        warm_up = project(folder / "warm-up", [_WARM_UP_BYTES], 1)
        warm_up.build("")  # the libraries enter the page cache, which the group is not charged for
        warm_up.start_over()
        found = {
            kind: _measure(folder, kind, options.size * 1e9, round(options.memory * 1e9)) for kind in _FORMATS
        }
    content = {"machine": machine(), "formats": found}
    print(reads_table(content))
    if options.json:
        options.json.write_text(json.dumps(content, indent=1) + "\n", "utf-8")


def _measure(folder: Path, kind: RecordingFormat, size: float, memory: int) -> dict[str, Any]:
    made = project(folder / kind, [size], 1, formats=[kind])
    stored = sum(file.stat().st_size for file in made.files())
    read = {}
    for mode, prepare in (("no digest stored", made.hash_at_client), ("digest stored", made.store_digests)):
        made.start_over()
        prepare()
        _drop_from_cache(made)
        with _cgroup(memory) as group:
            command = [sys.executable, "-m", "benchmarks.reads", "--counted", str(made.recipe), str(group)]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, cwd=ROOT)
        read[mode] = int(done.stdout)
        print(f"{kind}, {mode}: {read[mode] / stored:.3f} times", flush=True)
    return {"recording_bytes": stored, "memory_bytes": memory, "read_bytes": read}


def _drop_from_cache(made: Project) -> None:
    os.sync()
    for path in made.files():
        with path.open("rb") as file:
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def reads_table(found: dict[str, Any]) -> str:
    """Return how often recordings were read, as a table in Markdown."""
    rows = [
        (
            _FORMATS[kind],
            f"{case['recording_bytes'] / 1e9:.2f}",
            f"{case['memory_bytes'] / 1e9:.2f}",
            *(f"{read / case['recording_bytes']:.2f}" for read in case["read_bytes"].values()),
        )
        for kind, case in found["formats"].items()
    ]
    header = ("recording", "GB", "memory, GB", "read, no digest stored", "read, digest stored")
    return markdown(header, rows)


if __name__ == "__main__":
    main()
