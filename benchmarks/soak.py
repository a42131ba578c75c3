"""Many builds on one server: what grows?

Each round replaces a recording, builds, and builds once more with nothing to do; every tenth round removes what nothing uses::

    make soak                                        # 20 minutes
    python -m benchmarks.soak --minutes 120

The exit status is 1 if a build failed or left a process or a temporary file behind.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from benchmarks.changing import ChangingProject, measure_changes
from benchmarks.common import markdown

__all__ = ["soak_table"]

_COLLECT_EVERY = 10
_COLUMNS = ("build_s", "nothing_s", "memory_mb", "database_mb", "store_mb", "files")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=20.0)
    return measure_changes(parser, 6, lambda project, options: _soak(project, options.minutes), soak_table)


def _soak(project: ChangingProject, minutes: float) -> dict[str, Any]:
    rounds: list[dict[str, float]] = []
    problems: list[str] = []

    def call(*command: str) -> float:
        status, output, took_s = project.call(*command)
        if status:
            problems.append(f"round {len(rounds) + 1}: {' '.join(command)} ended with {status}\n{output}")
        return took_s

    call("build")
    end = time.monotonic() + minutes * 60
    while not rounds or time.monotonic() < end:
        project.replace(len(rounds))
        build_s, nothing_s = call("build"), call("build")
        if (len(rounds) + 1) % _COLLECT_EVERY == 0:
            call("gc", "--keep-days", "0")
        state = project.project / ".bagassets"
        left = [str(path) for path in (state / "store" / "tmp").iterdir()]
        if left:
            problems.append(f"round {len(rounds) + 1}: left behind: {', '.join(left)}")
        figures = (
            build_s,
            nothing_s,
            _memory_mb(project.processes()),
            _megabytes(state / "dagster"),
            _megabytes(state / "store"),
            sum(1 for path in state.rglob("*") if path.is_file()),
        )
        rounds.append(dict(zip(_COLUMNS, figures, strict=True)))
        print(f"round {len(rounds)}: {rounds[-1]}", flush=True)
    return {"minutes": minutes, "rounds": rounds, "problems": problems}


def soak_table(found: dict[str, Any]) -> str:
    """Return the first, the middle and the last rounds, and the growth per round, as a table in Markdown."""
    rounds = found["rounds"]
    part = max(1, len(rounds) // 4)
    middle = (len(rounds) - part) // 2
    chosen = {
        f"first {part}": rounds[:part],
        f"middle {part}": rounds[middle : middle + part],
        f"last {part}": rounds[-part:],
    }
    rows: list[Sequence[Any]] = [
        (name, *(statistics.fmean(one[column] for one in some) for column in _COLUMNS))
        for name, some in chosen.items()
    ]
    if len(rounds) > 1:
        rows.append(
            ("growth per round", *(round(_slope([one[column] for one in rounds]), 4) for column in _COLUMNS))
        )
    header = (
        "rounds, mean",
        "build, s",
        "nothing to do, s",
        "memory, MB",
        "database, MB",
        "store, MB",
        "files of the state",
    )
    return f"{len(rounds)} rounds, {len(found['problems'])} problems.\n\n{markdown(header, rows)}"


def _slope(values: Sequence[float]) -> float:
    return float(statistics.linear_regression(range(len(values)), values).slope)


def _memory_mb(pids: Sequence[int]) -> float:
    """Return the proportional set size of processes."""
    total_kb = 0
    for pid in pids:
        with suppress(OSError, StopIteration):
            lines = Path(f"/proc/{pid}/smaps_rollup").read_text("utf-8").splitlines()
            total_kb += int(next(line for line in lines if line.startswith("Pss:")).split()[1])
    return total_kb / 1000


def _megabytes(folder: Path) -> float:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6


if __name__ == "__main__":
    sys.exit(main())
