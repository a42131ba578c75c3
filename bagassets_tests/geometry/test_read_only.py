"""A project folder that cannot be written: each command ends with one sentence, none with a traceback."""

import os
import sqlite3
from pathlib import Path

import pytest

from bagassets.base.errors import StoreError
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.main import main
from bagassets.defs.records.databases import database_errors_explained
from bagassets.store.writable import require_writable
from bagassets_tests.in_process import make_project

pytestmark = pytest.mark.once


@pytest.fixture
def read_only(tmp_path, monkeypatch):
    """A project that only root could write; tests may run as root."""
    recipe = make_project(tmp_path)
    access = os.access

    def asked(path, mode, **options):
        is_inside = Path(path).is_relative_to(tmp_path)
        return access(path, mode, **options) and not (is_inside and mode & os.W_OK)

    monkeypatch.setattr(os, "access", asked)
    return recipe


@pytest.mark.parametrize("command", ["status", "build", "check", "report"])
def test_a_read_only_project_is_reported_in_one_sentence(read_only, command, capsys):
    assert main([command, "--recipe", str(read_only)]) == ExitStatus.FAILED
    (line,) = capsys.readouterr().err.splitlines()
    state = read_only.parent / ".bagassets"
    assert line.startswith(f"error: {state}: this state folder cannot be written ({state} is read-only")
    assert "set `state` in the recipe" in line


def test_a_state_folder_that_is_not_there_yet_needs_a_place_to_be_made_in(tmp_path):
    require_writable(tmp_path / "not" / "yet")


def test_a_file_that_somebody_else_made_is_named(tmp_path, monkeypatch):
    lock = tmp_path / "dagster" / "opening.lock"
    lock.parent.mkdir()
    lock.touch()
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: path != lock and access(path, mode))
    with pytest.raises(StoreError, match=rf"\({lock} is read-only for this user\)"):
        require_writable(tmp_path)


def test_a_database_of_our_own_that_cannot_be_opened_is_reported_in_a_sentence(tmp_path):
    with (
        pytest.raises(
            StoreError, match=r"cannot be used \(unable to open database file\); free disk space, or fix"
        ),
        database_errors_explained(str(tmp_path)),
    ):
        sqlite3.connect(tmp_path / "missing" / "digests.sqlite")
