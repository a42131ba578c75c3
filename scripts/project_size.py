"""Measure how much disk space a project takes beside its recordings, and what for.

    python scripts/project_size.py           # measures, writes benchmarks/results/project_size.json
    python scripts/project_size.py --print   # the table of docs/install.md from that file

Builds the demo, six drives of five seconds, in a temporary folder, and adds up its files. A file with several names, as
datasets have it in common with the store, counts where it is first: in the store.
"""

import argparse
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).parents[1]
RESULT = ROOT / "benchmarks" / "results" / "project_size.json"
SECONDS = 5.0
MB = 1e6

# What is counted, in this order: a name, and what it is.
PARTS = {
    "store/artifacts": "artifacts: images, points, tables, pictures, each once",
    "store": "which action made which artifact",
    "dagster": "Dagster's records and logs of runs",
    "state": "digests, fingerprints, locks and logs of the server",
    "dataset": "tables of the dataset; its images and points are links into the store",
    "project": "recipe, settings",
}


def main() -> None:
    """Measure, or print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--print", action="store_true", help="print the table of the last measurement")
    parser.add_argument("--output", type=Path, default=RESULT)
    arguments = parser.parse_args()
    if not arguments.print:
        arguments.output.write_text(json.dumps(measure(), indent=1) + "\n")
    print(table(json.loads(arguments.output.read_text())))


def measure(seconds: float = SECONDS) -> dict[str, Any]:
    """Build the demo, and return the bytes and files of each part."""
    with TemporaryDirectory(ignore_cleanup_errors=True) as name:  # the demo's server may still write
        folder = Path(name) / "demo"
        demo = [sys.executable, "-m", "bagassets", "demo", str(folder), "--seconds", str(seconds)]
        subprocess.run(demo, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return {
            "seconds": seconds,
            "recordings": len(list((folder / "recordings").iterdir())),
            "parts": sizes(folder),
        }


def sizes(folder: Path) -> dict[str, dict[str, int]]:
    """Return what each part of a project takes: bytes, and files of its own."""
    state = folder / ".bagassets"
    places = {
        "recordings": folder / "recordings",
        "store/artifacts": state / "store" / "artifacts",
        "store": state / "store",
        "dagster": state / "dagster",
        "state": state,
        "dataset": folder / "nuscenes",
        "project": folder,
    }
    counted: set[tuple[int, int]] = set()
    found: dict[str, Counter[str]] = {}
    for part, place in places.items():
        found[part] = Counter(bytes=0, files=0)
        for path in place.rglob("*"):
            status = path.lstat()
            if path.is_symlink() or not path.is_file() or (status.st_dev, status.st_ino) in counted:
                continue
            counted.add((status.st_dev, status.st_ino))
            found[part] += Counter(bytes=status.st_size, files=1)
    return {part: {"bytes": counts["bytes"], "files": counts["files"]} for part, counts in found.items()}


def table(result: dict[str, Any]) -> str:
    """Return the parts as Markdown."""
    parts = result["parts"]
    own = [parts[name] for name in PARTS]
    rows = [f"| {PARTS[name]} | {_megabytes(parts[name])} | {parts[name]['files']} |" for name in PARTS]
    total = {key: sum(part[key] for part in own) for key in ("bytes", "files")}
    share = total["bytes"] / parts["recordings"]["bytes"]
    given = f"{result['recordings']} recordings of {result['seconds']:.0f} s"
    return "\n".join(
        [
            f"| beside {given}, {_megabytes(parts['recordings'])} MB | MB | files |",
            "|---|--:|--:|",
            *rows,
            f"| **all**, {100 * share:.0f} % of the recordings | **{_megabytes(total)}** | **{total['files']}** |",
        ]
    )


def _megabytes(part: dict[str, int]) -> str:
    return f"{part['bytes'] / MB:.1f}"


if __name__ == "__main__":
    main()
