"""Small drives cut into parts, as recorders that split write them."""

import shutil
import tempfile
from pathlib import Path

from bagassets_tests.small_drive import START_NS, write_drive


def write_part(path, begin_s=0.0, end_s=1e9, duration_s=3.0, keep=lambda _topic, _stamp_ns: True):
    """Write what is recorded of a drive from one moment to another; latched messages are in the first part only."""

    def kept(topic, stamp_ns):
        return begin_s <= (stamp_ns - START_NS) / 1e9 < end_s and keep(topic, stamp_ns)

    if path.suffix != ".db3":
        return write_drive(path, {".bag": "ros1", ".mcap": "mcap"}[path.suffix], duration_s, kept)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        write_drive(Path(folder) / "drive", "ros2", duration_s, kept)
        shutil.move(next(Path(folder).glob("drive/*.db3")), path)
    return path


def write_parts(whole, cuts_s, duration_s=3.0, **options):
    """Write a drive as `NAME_0`, `NAME_1`, … beside where `whole` would be, cut at some moments; return their paths."""
    edges = [0.0, *cuts_s, 1e9]
    return [
        write_part(
            whole.with_name(f"{whole.stem}_{number}{whole.suffix}"),
            edges[number],
            edges[number + 1],
            duration_s,
            **options,
        )
        for number in range(len(edges) - 1)
    ]
