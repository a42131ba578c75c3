"""Builds killed at random moments, all their processes at once, as the end of a container does.

Before each build something has changed: a recording was replaced, touched, removed or added, or the recipe was edited. After each
kill, store and dataset are verified; after every fifth, and at the end, a build must end well; finally the dataset must be that
of a project built from nothing::

    make chaos                                       # 50 kills
    python -m benchmarks.chaos --kills 200 --seed 2

The exit status is 1 if anything went wrong.
"""

import argparse
import sys
import time
from collections import Counter
from typing import Any

from benchmarks.changing import ChangingProject, measure_changes
from benchmarks.common import markdown

__all__ = ["chaos_table"]

_ROUND = 5


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kills", type=int, default=50)
    return measure_changes(parser, 4, lambda project, options: _chaos(project, options.kills), chaos_table)


def _chaos(project: ChangingProject, kills: int) -> dict[str, Any]:
    problems: list[str] = []
    counts: Counter[str] = Counter()

    def must_end_well(what: str, *command: str) -> float:
        counts[what] += 1
        status, output, seconds = project.call(*command)
        if status:
            problems.append(
                f"after {counts['kills']} kills: {' '.join(command)} ended with {status}\n{output}"
            )
        return seconds

    longest_s = must_end_well("builds", "build")
    for number in range(1, kills + 1):
        project.change()
        # Half of the builds find no server, as after a restart of the machine.
        if project.dice.random() < 0.5:
            project.kill_all()
        process = project.start("build")
        time.sleep(project.dice.random() * longest_s)
        counts["kills of a build at work"] += process.poll() is None
        counts["kills"] += 1
        project.kill_all()
        process.communicate()
        must_end_well("verified", "verify")
        if number % _ROUND == 0:
            must_end_well("builds", "build")
        print(f"{number}/{kills}: {len(problems)} problems", flush=True)
    must_end_well("builds", "build")
    afresh = project.build_afresh()
    locks = [str(next(one.glob("dataset/nuscenes/*/dataset.lock.json"))) for one in (project.project, afresh)]
    must_end_well("compared with a project built from nothing", "dataset", "diff", *locks)
    return {"counts": dict(counts), "problems": problems}


def chaos_table(found: dict[str, Any]) -> str:
    """Return the results as a table in Markdown."""
    rows = [*found["counts"].items(), ("problems", len(found["problems"]))]
    return markdown(("", "number"), rows)


if __name__ == "__main__":
    sys.exit(main())
