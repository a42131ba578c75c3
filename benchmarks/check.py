"""How old the results are: `make bench-check`, before a release.

Each file in `benchmarks/results/` was measured on the commit that brought it. Of those since then, the ones that touch the
product are counted; of too many, this ends with exit status 1. What it found is a table in docs/performance.md.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
_RESULTS, _PRODUCT = "benchmarks/results", "bagassets"
_COUNTED = "measured.json"  # what this module writes, which is no result


def ages(root: Path) -> list[dict[str, Any]]:
    """Return each result of a checkout with its commit, its day, and how many commits touched the product since; oldest first.

    Raises:
        SystemExit: git is not there, or this is no checkout with its history.
    """
    found = []
    for path in sorted((root / _RESULTS).glob("*.json")):
        if path.name == _COUNTED:
            continue
        noted = _git(root, "log", "-1", "--format=%h %cs", "--", f"{_RESULTS}/{path.name}")
        commit, _, day = noted.partition(" ")  # nothing of one that is not committed yet
        since = _git(root, "rev-list", "--count", f"{commit}..HEAD", "--", _PRODUCT) if commit else "0"
        found.append({"result": path.stem, "commit": commit, "day": day, "commits_since": int(since)})
    return sorted(found, key=lambda one: (-one["commits_since"], one["result"]))


def ages_table(found: dict[str, Any]) -> str:
    """Return the ages as a Markdown table."""
    rows = [
        f"| `{one['result']}` | {one['commit']} | {one['day']} | {one['commits_since']} |"
        for one in found["results"]
    ]
    head = ["| result | measured on | day | commits to the product since then |", "|---|---|---|--:|"]
    return "\n".join([*head, *rows]) + f"\n\nCounted at {found['commit']}.\n"


def main(arguments: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """Print how old each result is, note it for the pages, and return 1 if one is too old."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.check", description=__doc__)
    parser.add_argument(
        "--most", type=int, default=100, help="most commits to the product since a result was measured"
    )
    most = parser.parse_args(arguments).most
    results = ages(root)
    found = {"commit": _git(root, "rev-parse", "--short", "HEAD"), "results": results}
    (root / _RESULTS / _COUNTED).write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    print(ages_table(found))
    old = [one["result"] for one in results if one["commits_since"] > most]
    if old:
        print(
            f"error: more than {most} commits old: {', '.join(old)}; measure again: `make bench-all`, or as docs say of each.",
            file=sys.stderr,
        )
    return 1 if old else 0


def _git(root: Path, *arguments: str) -> str:
    try:
        done = subprocess.run(["git", "-C", root, *arguments], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError) as err:
        why = getattr(err, "stderr", "") or str(err)
        raise SystemExit(
            f"error: {root}: results have no age without git and its history ({why.strip()})."
        ) from err
    return done.stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
