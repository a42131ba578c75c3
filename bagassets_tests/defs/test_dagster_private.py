"""Dagster's private API: it is there, imported by one module alone, and each name when it is asked for."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import bagassets
from bagassets.defs import dagster_private
from bagassets_tests.project.test_layers import imports_of

PACKAGE = Path(bagassets.__file__).parent
MODULE = Path(dagster_private.__file__)
PRIVATE = ("dagster._", "dagster_shared", "dagster_webserver.app", "dagster_graphql")


def test_no_other_module_imports_it():
    others = {
        str(path.relative_to(PACKAGE))
        for path in PACKAGE.rglob("*.py")
        if path != MODULE and any(name.startswith(PRIVATE) for name in imports_of(path))
    }
    assert others == set()


@pytest.mark.parametrize("name", sorted(dagster_private._places()))
def test_this_dagster_has_each_name(name):
    """A new minor version of Dagster that moves one fails here, and names it."""
    assert getattr(dagster_private, name) is not None


def test_each_name_is_used():
    used = {
        alias.name
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module == "bagassets.defs.dagster_private"
        for alias in node.names
    }
    assert used == {*dagster_private._places(), "RUN_MODULES"}


def test_a_process_that_needs_one_name_imports_no_other():
    code = (
        "import sys\n"
        "from bagassets.defs.dagster_private import PartitionLoadingContext\n"
        "print('dagster._core.workspace.context' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_what_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = dagster_private.nothing
