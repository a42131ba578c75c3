"""The drives of the demo: six, two per format, each another seed."""

import os
import shutil
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from bagassets.sample.drive import Target, write_recordings

__all__ = ["DURATION_S", "PROFILE", "missing_drives", "write_drives"]

PROFILE, DURATION_S = "drive", 5.0

# Number of a drive is its seed; compressions are those that people use.
_TARGETS = (
    Target(Path("drive_1.bag"), "ros1"),
    Target(Path("drive_2.bag"), "ros1", "lz4"),
    Target(Path("drive_3"), "ros2"),
    Target(Path("drive_4"), "ros2", "zstd"),
    Target(Path("drive_5.mcap"), "mcap"),
    Target(Path("drive_6.mcap"), "mcap", "zstd"),
)


def missing_drives(folder: Path) -> list[Target]:
    """Return the drives that a folder of recordings lacks."""
    return [target for target in _TARGETS if not (folder / target.path).exists()]


def write_drives(folder: Path, targets: list[Target], workers: int | None = None) -> Iterator[str]:
    """Write drives side by side; yields the name of each that is done.

    Each is written elsewhere and moved into the folder when it is whole, so that an interrupted demo
    leaves no half recording behind, and begins with what is missing.

    Args:
        folder: of the recordings.
        targets: drives to write.
        workers: processes; default: one per processor.
    """
    folder.mkdir(parents=True, exist_ok=True)
    unfinished = folder.parent / ".writing"
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir()
    # Spawned, as the caller may have threads.
    with ProcessPoolExecutor(workers or os.cpu_count(), get_context("spawn")) as pool:
        yield from pool.map(_write, targets, [unfinished] * len(targets), [folder] * len(targets))
    unfinished.rmdir()


def _write(target: Target, unfinished: Path, folder: Path) -> str:
    part = unfinished / target.path
    seed = _TARGETS.index(target) + 1
    write_recordings([Target(part, target.format, target.compression)], seed, PROFILE, DURATION_S)
    part.replace(folder / target.path)
    return target.path.name
