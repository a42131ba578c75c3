"""Files appear whole or not at all."""

import ast
import errno
import os
import threading
from pathlib import Path

import pytest

import bagassets
from bagassets.base import atomic
from bagassets.base.atomic import create_atomically, replacing, write_atomically


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_is_replaced_when_it_is_complete(tmp_path):
    path = tmp_path / "a.json"
    write_atomically(path, b"old")
    with replacing(path) as temporary:
        temporary.write_bytes(b"new, and not yet complete")
        assert path.read_bytes() == b"old"
        assert temporary.name.startswith(".")
    assert path.read_bytes() == b"new, and not yet complete"
    assert names(tmp_path) == ["a.json"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_who_fails_while_writing_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "a.json"
    path.write_bytes(b"old")

    def fail():
        with replacing(path) as temporary:
            temporary.write_bytes(b"ne")
            raise error

    with pytest.raises(error):
        fail()
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a.json"]


def test_what_cannot_be_moved_into_place_is_removed(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(IsADirectoryError):
        write_atomically(tmp_path / "folder", b"x")
    assert names(tmp_path) == ["folder"]


@pytest.fixture(params=[None, errno.EPERM, errno.EMLINK])
def links(request, monkeypatch):
    """Run a test as it is, and where no hard links can be made."""

    def refuse(*_):
        raise OSError(request.param, os.strerror(request.param))

    if request.param is not None:
        monkeypatch.setattr(os, "link", refuse)


@pytest.mark.usefixtures("links")
def test_the_first_who_creates_a_file_wins(tmp_path):
    path = tmp_path / "a.json"
    assert create_atomically(path, b"first")
    assert not create_atomically(path, b"second")
    assert path.read_bytes() == b"first"
    assert names(tmp_path) == ["a.json"]


def test_one_of_many_who_create_a_file_at_once_wins(tmp_path):
    path, won = tmp_path / "a.json", []

    def create(number):
        if create_atomically(path, b"%d" % number):
            won.append(b"%d" % number)

    threads = [threading.Thread(target=create, args=(number,)) for number in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert won == [path.read_bytes()]


@pytest.mark.usefixtures("links")
@pytest.mark.parametrize("renames", [True, False])
def test_nobody_sees_half_of_a_file_that_is_created(tmp_path, monkeypatch, renames):
    if not renames:
        monkeypatch.setattr(atomic, "_rename", lambda *_: False)
    paths, content, seen = [tmp_path / str(number) for number in range(30)], b"x" * 2_000_000, set()

    def read():
        for path in paths:
            while not path.exists():
                pass
            seen.add(path.stat().st_size)

    reader = threading.Thread(target=read)
    reader.start()
    for path in paths:
        assert create_atomically(path, content)
        assert not create_atomically(path, b"second")
    reader.join()
    assert seen == {len(content)}


def test_a_full_disk_is_no_file_that_exists(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "link", full)
    with pytest.raises(OSError, match="No space"):
        create_atomically(tmp_path / "a.json", b"x")
    assert names(tmp_path) == []


def replaces_files(path):
    """Tell whether a module calls `os.replace`, or `replace` of a path: with one argument, unlike that of text."""
    calls = (node for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.Call))
    return any(
        isinstance(call.func, ast.Attribute)
        and call.func.attr == "replace"
        and not call.keywords
        and (len(call.args) == 1 or ast.unparse(call.func) == "os.replace")
        for call in calls
    )


def test_no_other_module_replaces_files_by_itself():
    root = Path(bagassets.__file__).parent
    found = {path.relative_to(root).as_posix() for path in root.rglob("*.py") if replaces_files(path)}
    # What is moved there was made elsewhere: databases, drives, records on their way back.
    moves = {"defs/records/databases.py", "sample/demo.py", "store/collect.py"}
    assert found == {"base/atomic.py"} | moves
