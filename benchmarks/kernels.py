"""What llvmlite is worth: processor time of plain conversions with it and, by turns, without.

Where it cannot be imported, OpenCV and numpy do the same at the same bytes::

    python -m benchmarks.kernels [--size-gb 0.7] [--trials 6] [--folder FOLDER]
"""

import argparse
import os
import statistics
import sys
import tempfile
from pathlib import Path

from benchmarks.common import ROOT, Project, plain_command, project
from benchmarks.resources import run_watched

_MISSING = 'raise ImportError("hidden by the benchmark")\n'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--size-gb", type=float, default=0.7, help="of one recording, four cameras and a lidar"
    )
    parser.add_argument("--trials", type=int, default=6)
    parser.add_argument("--folder", type=Path, help="where to work; default: a temporary folder")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        hidden = folder / "hidden"
        hidden.mkdir()
        (hidden / "llvmlite.py").write_text(_MISSING, "utf-8")
        made = project(folder / "project", [options.size_gb * 1e9], options.trials)
        ratios = []
        for _ in range(options.trials):
            fast, slow = (
                converted(made, str(ROOT)),
                converted(made, os.pathsep.join([str(hidden), str(ROOT)])),
            )
            ratios.append(slow / fast)
            print(f"{fast:.2f} CPU-s with llvmlite, {slow:.2f} without", flush=True)
    print(f"without / with: median {statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})")


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
