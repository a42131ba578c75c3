"""Imports point down, in every package and module, inside functions as well; only `defs/` and `definitions.py` know
Dagster, and only the executor runs actions."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

import bagassets

pytestmark = pytest.mark.once

ROOT = Path(bagassets.__file__).parent

# From the ground up: each may import what stands in lines above it here, and nothing else. Those of one line do not
# know each other, so there is no cycle between packages either.
LAYERS = [
    ("__init__", "base"),
    ("geometry", "recipe"),
    ("store",),
    ("recordings",),
    ("decode",),
    ("assets",),
    ("engine",),
    ("forkserver", "report"),
    ("formats",),
    ("view", "propose"),
    ("sample",),
    ("defs",),
    ("cli",),
    ("definitions", "__main__", "notebook"),
]
# The rooms of `defs/`, likewise.
ROOMS = ("records", "runs", "graph", "builds", "ui", "launchers")
FACE = ROOT / "__init__.py"  # names what users import, and imports it when they use it (test_reader.py)
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}


@cache
def imports_of(path: Path) -> set[str]:
    """Return the full names of all modules, or of things in them, that a module imports anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            if node.module == "bagassets":
                names |= {f"bagassets.{alias.name}" for alias in node.names}
            else:
                names.add(node.module or "")
    return names


def package_of(path: Path) -> str:
    """The package of `bagassets`, or module at its top, that a file belongs to."""
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def imported_package(name: str) -> str | None:
    """The package or top module that an import is of; None if it is of another project."""
    first, _, rest = name.partition(".")
    if first != "bagassets":
        return None
    package = rest.partition(".")[0]
    return package if package in LEVEL else "__init__"  # of the package itself, such as its version


def test_every_package_has_its_place():
    there = {package_of(path) for path in ROOT.rglob("*.py")}
    assert there == set(LEVEL)


def test_only_defs_import_dagster():
    leaks = [
        str(path.relative_to(ROOT))
        for path in ROOT.rglob("*.py")
        if package_of(path) not in {"defs", "definitions"}
        and any(name.split(".")[0].startswith("dagster") for name in imports_of(path))
    ]
    assert leaks == []


def test_nothing_imports_what_is_beside_or_above_it():
    upward = set()
    for path in ROOT.rglob("*.py"):
        package = package_of(path)
        if path == FACE:
            continue
        for name in imports_of(path):
            other = imported_package(name)
            if other is not None and other != package and LEVEL[other] >= LEVEL[package]:
                upward.add(f"{path.relative_to(ROOT)} -> {name.removeprefix('bagassets.')}")
    assert upward == set()


def test_the_rooms_of_defs_import_downwards():
    rooms = ROOT / "defs"
    assert {path.name for path in rooms.iterdir() if path.is_dir() and path.name != "__pycache__"} == {*ROOMS}
    upward = {
        f"{path.relative_to(ROOT)} -> {name.removeprefix('bagassets.')}"
        for path in rooms.rglob("*.py")
        if (room := path.relative_to(rooms).parts[0]) in ROOMS
        for name in imports_of(path)
        if name.startswith("bagassets.defs.") and name.split(".")[2] in ROOMS
        if ROOMS.index(name.split(".")[2]) > ROOMS.index(room)
    }
    assert upward == set()


def test_only_the_executor_runs_actions():
    """What starts an action is `engine.run_action`, by which all go, and the two passes over a recording."""
    starting = {
        str(path.relative_to(ROOT))
        for path in ROOT.rglob("*.py")
        if re.search("begin|Pending", text := path.read_text(encoding="utf-8"))
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call)
        and ast.unparse(node.func).endswith((".begin", "Pending"))
        # The log of builds, and a transaction.
        and ast.unparse(node.func) not in {"builds.begin", "_engine(url).begin"}
    }
    stores = {"store/store.py", "engine/rebuild.py"}  # which are asked to
    assert starting - stores == {"engine/run_action.py", "engine/execute.py", "engine/first_pass.py"}


def test_the_documentation_shows_the_layers_from_above():
    text = (ROOT.parent / "docs" / "code.md").read_text("utf-8")
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    output = [name for row in rows for name in re.findall(r"`(\w+)(?:/|\.py)`", row)]
    assert sorted(output) == sorted(set(LEVEL) - {"__init__", "__main__"})
    assert [LEVEL[name] for name in output] == sorted((LEVEL[name] for name in output), reverse=True)
