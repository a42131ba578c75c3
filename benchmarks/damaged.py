"""What is saved of damaged recordings, and how fast they are read: drives of the sample, damaged in the ways of every day.

    python -m benchmarks.damaged [--json FILE]

The table goes to `docs/damaged.md`. Messages that can be read are counted after a whole pass; the speed is that of such a
pass over a sound recording, in time of the processor, by the readers for damaged ones and by the ordinary ones in turn.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

# Those that are run as files find the package beside them.
sys.path.insert(0, str(Path(__file__).parents[1]))


from bagassets.base.errors import BagAssetsError
from bagassets.recordings.open import open_recording
from bagassets.recordings.recording import Recording
from bagassets.recordings.salvage.open import open_salvaged
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recorder import Compression, RecordingFormat
from benchmarks.common import machine, markdown, median

__all__ = ["damaged_table"]

DURATION_S = 20.0
KINDS: dict[str, tuple[RecordingFormat, Compression, str]] = {
    "ROS 1": ("ros1", "none", "a.bag"),
    "ROS 1, lz4": ("ros1", "lz4", "b.bag"),
    "ROS 1, bz2": ("ros1", "bz2", "c.bag"),
    "MCAP": ("mcap", "none", "d.mcap"),
    "MCAP, lz4": ("mcap", "lz4", "e.mcap"),
    "MCAP, zstd": ("mcap", "zstd", "f.mcap"),
    "SQLite": ("ros2", "none", "g.db3"),
}

Damage = Callable[[bytes], bytes]


def _without_index(data: bytes) -> bytes:
    if data.startswith(b"#ROSBAG"):
        at = data.index(b"index_pos=") + len(b"index_pos=")
        return data[:at] + bytes(8) + data[at + 8 : int.from_bytes(data[at : at + 8], "little")]
    if data.startswith(b"\x89MCAP"):
        return data[: int.from_bytes(data[-28:-20], "little")]
    return data[:3] + bytes([data[3] ^ 1]) + data[4:]  # a database has its beginning instead


def _flip(data: bytes) -> bytes:
    at = len(data) * 2 // 5
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


DAMAGES: dict[str, Damage] = {
    "without index, summary or header": _without_index,
    "cut at 90 %": lambda data: data[: len(data) * 9 // 10],
    "cut at 50 %": lambda data: data[: len(data) // 2],
    "last tenth zeros": lambda data: data[: len(data) * 9 // 10] + bytes(len(data) - len(data) * 9 // 10),
    "a bit": _flip,
}


def _read(recording: Recording) -> int:
    with recording:
        recording.check_content()
        return sum(1 for _ in recording.messages(list(recording.topics)))


def _ordinary(path: Path, total: int) -> str:
    """Return what builds made of it before there was salvage."""
    try:
        return "not noticed" if _read(open_recording(path)) == total else "fails"
    except BagAssetsError:
        return "fails"


def measure(folder: Path, duration_s: float) -> dict[str, Any]:
    """Damage and read everything; return what was found."""
    found: dict[str, Any] = {"messages": 0, "kinds": {}}
    targets = [
        Target(folder / name, file_format, compression) for file_format, compression, name in KINDS.values()
    ]
    write_recordings(targets, duration_s=duration_s)
    for kind, (_, _, name) in KINDS.items():
        path = folder / name
        data, total = path.read_bytes(), _read(open_recording(path))
        seconds: dict[str, list[float]] = {"ordinary": [], "salvage": []}
        for _ in range(5):
            for readers, opener in (("ordinary", open_recording), ("salvage", open_salvaged)):
                began_s = time.process_time()
                _read(opener(path))
                seconds[readers].append(time.process_time() - began_s)
        rows = {}
        for damage, change in DAMAGES.items():
            damaged = folder / f"damaged{path.suffix}"
            damaged.write_bytes(change(data))
            rows[damage] = {
                "ordinary": _ordinary(damaged, total),
                "saved": _read(open_salvaged(damaged)) / total,
            }
            damaged.unlink()
        found["messages"] = total
        found["kinds"][kind] = {"damages": rows, "seconds": seconds}
    return found


def damaged_table(found: dict[str, Any]) -> str:
    """Return the table of docs/damaged.md."""
    damages = list(next(iter(found["kinds"].values()))["damages"])
    rows = []
    for kind, one in found["kinds"].items():
        cells = [
            f"{row['saved']:.1%}" + (" (not noticed)" if row["ordinary"] == "not noticed" else "")
            for row in (one["damages"][damage] for damage in damages)
        ]
        speed = median(one["seconds"]["ordinary"]) / median(one["seconds"]["salvage"])
        rows.append([kind, *cells, f"{speed:.2f}"])
    table = markdown(["recorded as", *damages, "speed"], rows)
    return f"{table}\n{found['messages']} messages each.\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--duration", type=float, default=DURATION_S, metavar="S", help="of the drives")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bagassets-bench-", ignore_cleanup_errors=True) as folder:
        found = {"machine": machine(), **measure(Path(folder), options.duration)}
    print(damaged_table(found))
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
