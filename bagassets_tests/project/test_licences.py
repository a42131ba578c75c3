"""The licences in docs/install.md are those that the packages of the lock state."""

import re
import sys
from pathlib import Path

import pytest

from scripts.licences import (
    BEGIN,
    COPYLEFT,
    END,
    NAMED_ONLY,
    PAGE,
    is_installed,
    names_copyleft,
    required,
    tables,
)

LOCK = (Path(__file__).parents[2] / "requirements.lock").read_text("utf-8")
SHOWN = PAGE.read_text("utf-8").partition(BEGIN)[2].partition(END)[0]
HOW = "python scripts/licences.py, in the environment of requirements.lock"

# Other versions of libraries have other tables.
pytestmark = pytest.mark.once


def everything():
    """Also what extras add, as far as it is installed."""
    return {name for name in required() | required("postgres") | required("video") if is_installed(name)}


def test_versions_are_those_of_the_lock():
    locked = dict(re.findall(r"^([\w.-]+)==([^\s;]+)", LOCK, re.MULTILINE))
    locked = {re.sub(r"[._-]+", "-", name).lower(): version for name, version in locked.items()}
    rows = re.findall(r"^\| [^|]+ \| (.*) \|$", SHOWN.partition("| copyleft")[0], re.MULTILINE)
    shown = dict(re.findall(r"([\w-]+) (\d[\w.]*)(?=,| \(|$)", "\n".join(rows), re.MULTILINE))
    assert len(shown) > 70
    assert {name: locked.get(name) for name in shown} == shown, HOW


def test_the_tables_are_those_of_what_is_installed():
    if sys.version_info[:2] == (3, 11):  # others need other packages
        assert tables() == SHOWN, HOW
    assert "psycopg2-binary" in SHOWN
    assert "not stated" not in SHOWN


def test_what_is_copyleft_is_told():
    found = {name for name in everything() if names_copyleft(name)}
    assert found <= COPYLEFT.keys() | NAMED_ONLY.keys(), (
        "say what of these is copyleft, in scripts/licences.py"
    )
    assert {"certifi", "numpy", "opencv-python-headless", "tqdm"} <= found
    assert not COPYLEFT.keys() & NAMED_ONLY.keys()
    assert COPYLEFT.keys() <= everything(), "what is not installed needs no line"
