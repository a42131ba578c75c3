"""The recordings of the demo, each with its own seed: six drives, two per format; or the arm, one per format of ROS."""

import os
import shutil
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.connection import wait
from pathlib import Path
from threading import Thread
from typing import Literal

from bagassets.base.interrupts import interrupts_blocked
from bagassets.sample.drive import Target, write_arm_recordings, write_recordings

Robot = Literal["car", "arm"]

# The number of a recording is its seed; compressions are the common ones.
_TARGETS: dict[Robot, tuple[Target, ...]] = {
    "car": (
        Target(Path("drive_1.bag"), "ros1"),
        Target(Path("drive_2.bag"), "ros1", "lz4"),
        Target(Path("drive_3"), "ros2"),
        Target(Path("drive_4"), "ros2", "zstd"),
        Target(Path("drive_5.mcap"), "mcap"),
        Target(Path("drive_6.mcap"), "mcap", "zstd"),
    ),
    "arm": (
        Target(Path("arm_1.bag"), "ros1", "lz4"),
        Target(Path("arm_2"), "ros2"),
        Target(Path("arm_3.mcap"), "mcap", "zstd"),
    ),
}


def missing_drives(folder: Path, robot: Robot = "car") -> list[Target]:
    """Return the recordings of a robot that a folder lacks."""
    return [target for target in _TARGETS[robot] if not (folder / target.path).exists()]


def write_drives(
    folder: Path, targets: list[Target], duration_s: float, robot: Robot = "car"
) -> Iterator[str]:
    """Write recordings in parallel, and yield the name of each finished one.

    Each is written elsewhere and moved into the folder when it is whole, so that an interrupted demo
    leaves no half recording behind, and begins with what is missing.

    Args:
        folder: folder of the recordings.
        targets: recordings to write.
        duration_s: duration of each.
        robot: whose.
    """
    folder.mkdir(parents=True, exist_ok=True)
    unfinished = folder.parent / ".writing"
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir()
    # Spawned, because the caller may have threads.
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn"), _end_with_parent) as pool:
        try:
            with interrupts_blocked():  # in a terminal, Ctrl-C is for the caller alone
                written = [pool.submit(_write, unfinished, folder, duration_s, robot, one) for one in targets]
            for one in written:
                yield one.result()
        except BaseException:
            for process in active_children():
                process.kill()
            raise
    unfinished.rmdir()


def _end_with_parent() -> None:
    """Have this process end when its parent does: children of one that is killed would wait for work for ever."""
    parent = parent_process()
    if parent is not None:
        Thread(target=_end_after, args=(parent.sentinel,), daemon=True).start()


def _end_after(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


def _write(unfinished: Path, folder: Path, duration_s: float, robot: Robot, target: Target) -> str:
    part = unfinished / target.path
    seed = _TARGETS[robot].index(target) + 1
    write = write_arm_recordings if robot == "arm" else write_recordings
    write([Target(part, target.format, target.compression)], seed, "drive", duration_s)
    part.replace(folder / target.path)
    return target.path.name
