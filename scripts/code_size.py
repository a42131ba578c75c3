"""Count the product: lines, statements, modules, the largest rooms, and what of Dagster it takes that is not documented.

    python -m scripts.code_size                        # prints the table of docs/code.md
    python -m scripts.code_size --keep after           # keeps the numbers of now for that table
    python -m scripts.code_size --keep before --checkout ../before

A room is a folder of `bagassets`; those of `defs/` are rooms of their own.
"""

import argparse
import ast
import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULT = ROOT / "benchmarks" / "results" / "code_size.json"
LARGEST = 8

# What is counted, in this order: a name, and what the table calls it.
COUNTED = {
    "lines": "lines, with docstrings and blank ones",
    "statements": "statements",
    "modules": "modules",
    "folders": "folders of `bagassets`",
    "private": "private names of Dagster",
    "relied": "other inner workings of Dagster that are relied upon",
    "patches": "of them replaced while it runs",
}


def main() -> None:
    """Print the table; keep what is counted if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--keep", choices=("before", "after"), help="keep the numbers in benchmarks/results/")
    parser.add_argument("--checkout", type=Path, default=ROOT, help="folder whose `bagassets` is counted")
    arguments = parser.parse_args()
    kept = json.loads(RESULT.read_text()) if RESULT.exists() else {}
    kept[arguments.keep or "after"] = count(arguments.checkout / "bagassets")
    if arguments.keep:
        RESULT.write_text(json.dumps(kept, indent=1) + "\n")
    print(code_size_table(kept))


def count(package: Path) -> dict[str, Any]:
    """Return the numbers of a package, and the lines of its largest rooms."""
    lines = statements = modules = 0
    rooms: Counter[str] = Counter()
    for path in package.rglob("*.py"):
        text = path.read_text("utf-8")
        modules += 1
        lines += len(text.splitlines())
        statements += sum(isinstance(node, ast.stmt) for node in ast.walk(ast.parse(text)))
        *folders, _ = path.relative_to(package).parts
        rooms["/".join(folders[: 2 if folders[:1] == ["defs"] else 1])] += len(text.splitlines())
    private = ast.parse((package / "defs" / "dagster_private.py").read_text("utf-8"))
    places = re.findall(r"^- .*(?:\n  .*)*", ast.get_docstring(private) or "", re.MULTILINE)
    return {
        "lines": lines,
        "statements": statements,
        "modules": modules,
        "folders": sum(path.is_dir() and path.name != "__pycache__" for path in package.iterdir()),
        "private": sum(
            len(node.names)
            for block in private.body
            if isinstance(block, ast.If)
            for node in block.body
            if isinstance(node, ast.ImportFrom)
        ),
        "relied": len(places),
        "patches": sum("replaces" in place for place in places),
        "rooms": dict(rooms.most_common(LARGEST)),
    }


def code_size_table(found: dict[str, Any]) -> str:
    """Return the numbers before and after as Markdown."""
    names = [name for name in ("before", "after") if name in found]
    rows = [[words, *(f"{found[name][key]:,}" for name in names)] for key, words in COUNTED.items()]
    rooms = [
        ", ".join(f"`{room or 'top'}` {lines:,}" for room, lines in found[name]["rooms"].items())
        for name in names
    ]
    rows.append([f"lines of the largest {LARGEST} rooms", *rooms])
    return "\n".join(
        [
            f"| | {' | '.join(names)} |",
            f"|---|{'--:|' * len(names)}",
            *(f"| {' | '.join(row)} |" for row in rows),
        ]
    )


if __name__ == "__main__":
    main()
