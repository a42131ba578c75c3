"""What llvmlite is worth: processor time of plain conversions with it and, by turns, without.

Where it cannot be imported, OpenCV and numpy do the same at the same bytes::

    python -m benchmarks.kernels [--size-gb 0.35] [--trials 5] [--folder FOLDER] [--json FILE]
"""

import argparse
import json
import os
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.common import ROOT, Project, machine, markdown, plain_command, project
from benchmarks.resources import run_watched

_MISSING = 'raise ImportError("hidden by the benchmark")\n'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--size-gb", type=float, default=0.35, help="of one recording, four cameras and a lidar"
    )
    parser.add_argument("--trials", type=int, default=5)
    parser.add_argument("--folder", type=Path, help="where to work; default: a temporary folder")
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder, ignore_cleanup_errors=True) as name:
        folder = Path(name)
        hidden = folder / "hidden"
        hidden.mkdir()
        (hidden / "llvmlite.py").write_text(_MISSING, "utf-8")
        made = project(folder / "project", [options.size_gb * 1e9], options.trials)
        found: dict[str, Any] = {"size_gb": made.size_gb, "with_cpu_s": [], "without_cpu_s": []}
        for _ in range(options.trials):
            found["with_cpu_s"].append(converted(made, str(ROOT)))
            found["without_cpu_s"].append(converted(made, os.pathsep.join([str(hidden), str(ROOT)])))
            print(
                f"{found['with_cpu_s'][-1]:.2f} CPU-s with llvmlite, {found['without_cpu_s'][-1]:.2f} without",
                flush=True,
            )
    print(kernels_table(found))
    if options.json is not None:
        options.json.write_text(json.dumps({"machine": machine(), **found}, indent=1) + "\n", "utf-8")


def kernels_table(found: dict[str, Any]) -> str:
    """Return the table of `kernels.json`: medians, and the range of the ratio of each pair of conversions."""
    fast, slow = found["with_cpu_s"], found["without_cpu_s"]
    ratios = [without / with_ for with_, without in zip(fast, slow, strict=True)]
    return markdown(
        ["plain conversion of", "CPU-s with llvmlite", "without", "without / with", "from", "to"],
        [
            [
                f"{found['size_gb']:.2f} GB",
                *map(statistics.median, (fast, slow, ratios)),
                min(ratios),
                max(ratios),
            ]
        ],
    )


def converted(made: Project, search: str) -> float:
    """Return the processor time of a conversion by a process that looks for modules in `search` first."""
    with tempfile.TemporaryDirectory(dir=made.recipe.parent) as out:
        target = Path(out) / "out"
        target.mkdir()
        made.settle()
        environment = {"PYTHONPATH": search, "BENCH_RECIPE": str(made.recipe)}
        used = run_watched(plain_command(made.bags, target), cwd=ROOT, env=environment)
    if used.code:
        sys.exit(f"the conversion ended with {used.code}")
    return used.cpu_s


if __name__ == "__main__":
    main()
