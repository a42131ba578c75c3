"""Imports point down: only `defs/` and `definitions.py` know Dagster."""

import ast
from pathlib import Path

import bagassets

ROOT = Path(bagassets.__file__).parent

# Lower layers may not import upper ones; each package names what it may import.
ORDER = [
    ("escaping", "kernels", "lock_files"),
    ("errors",),
    ("geometry",),
    ("recipe",),
    ("store", "bags"),
    ("decode",),
    ("timeline", "annotations"),
    ("nuscenes",),
    ("vision", "preview", "report", "view"),
    ("steps",),
    ("quality",),
    ("engine",),
    ("defs", "cli", "definitions"),
]


def imports_of(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""


def test_only_defs_import_dagster():
    leaks = [
        str(path.relative_to(ROOT))
        for path in ROOT.rglob("*.py")
        if path.relative_to(ROOT).parts[0] not in {"defs", "definitions.py"}
        and any(name.split(".")[0] == "dagster" for name in imports_of(path))
    ]
    assert leaks == []


def test_steps_and_engine_import_nothing_above_them():
    level = {name: i for i, names in enumerate(ORDER) for name in names}
    wrong = []
    for package in (
        "steps",
        "vision",
        "preview",
        "report",
        "view",
        "quality",
        "engine",
        "nuscenes",
        "timeline",
        "annotations",
        "store",
    ):
        for path in (ROOT / package).rglob("*.py"):
            for name in imports_of(path):
                parts = name.split(".")
                if parts[0] == "bagassets" and len(parts) > 1 and level.get(parts[1], -1) > level[package]:
                    wrong.append(f"{path.relative_to(ROOT)} imports {name}")
    assert wrong == []
