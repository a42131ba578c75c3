"""How much of the lists of a dataset's links one look reads."""

import os
from pathlib import Path

import pytest

from bagassets.quick import published
from bagassets.quick.looks import Doubt


@pytest.fixture
def head(tmp_path):
    """Three lists of three links each, and the files that they name."""
    lists = {}
    (tmp_path / "root").mkdir()
    for name in "abc":
        lines = b""
        for number in range(3):
            (tmp_path / "root" / f"{name}{number}").write_bytes(b"x" * number)
            lines += published.line_of(str(tmp_path / "root"), f"{name}{number}")
        (tmp_path / name).write_bytes(lines)
        lists[name] = len(lines)
    assert len(set(lists.values())) == 1
    return {"root": str(tmp_path / "root"), "lists": lists}


def read_of(monkeypatch):
    """(list, how much of it) in the order in which they are read."""
    real, read = published._lines, []

    def lines(path, size, most):
        read.append((Path(path).name, min(size, most)))
        return real(path, size, most)

    monkeypatch.setattr(published, "_lines", lines)
    monkeypatch.setattr(published.random, "shuffle", lambda _lists: None)
    return read


def test_all_are_read_where_nothing_limits_it(tmp_path, head, monkeypatch):
    read = read_of(monkeypatch)
    assert published._links(str(tmp_path), head, None) == set()
    assert read == [(name, head["lists"][name]) for name in "abc"]


@pytest.mark.parametrize(
    ("share", "expected"),
    [(0.5, [0.5]), (1.0, [1.0]), (1.5, [1.0, 0.5]), (2.0, [1.0, 1.0]), (9.0, [1.0] * 3)],
)
def test_no_more_is_read_than_asked_for(tmp_path, head, monkeypatch, share, expected):
    read, size = read_of(monkeypatch), head["lists"]["a"]
    published._links(str(tmp_path), head, int(share * size))
    assert [number for _, number in read] == [int(part * size) for part in expected]


def test_what_differs_is_named(tmp_path, head):
    root = tmp_path / "root"
    (root / "a1").unlink()
    (root / "b2").write_bytes(b"longer than before")
    os.utime(root / "c0", ns=(1, 1))
    assert published._links(str(tmp_path), head, None) == {"a1", "b2", "c0"}


@pytest.mark.parametrize(
    "damage", [lambda path: path.write_bytes(path.read_bytes() + b"x"), lambda path: path.unlink()]
)
def test_a_list_that_is_not_as_it_was_written_is_a_doubt(tmp_path, head, damage):
    damage(tmp_path / "b")
    with pytest.raises(Doubt, match="/b: "):
        published._links(str(tmp_path), head, None)


def test_a_line_that_says_nothing_is_a_doubt(tmp_path, head):
    (tmp_path / "b").write_bytes(b"x" * head["lists"]["b"])
    with pytest.raises(Doubt, match="/b: damaged"):
        published._links(str(tmp_path), head, None)
