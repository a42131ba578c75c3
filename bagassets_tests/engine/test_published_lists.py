"""How much of the lists of a dataset's links one look reads, and what is left of a list that changes."""

import os

import pytest

from bagassets.base.cache import Cache, Changes
from bagassets.base.fingerprints import PlanNeeded
from bagassets.engine.freshness import published
from bagassets.engine.freshness.published import Publication
from bagassets_tests.file_clock import next_tick

pytestmark = pytest.mark.once

PARTS = ("a", "b", "c")


@pytest.fixture
def root(tmp_path):
    """The files of three parts of three links each."""
    (tmp_path / "root").mkdir()
    for part in PARTS:
        for number in range(3):
            (tmp_path / "root" / f"{part}{number}").write_bytes(b"x" * number)
    return tmp_path / "root"


@pytest.fixture
def publication(tmp_path, root, monkeypatch):
    """What is on record of them, each link in a piece of its own."""
    monkeypatch.setattr(published, "_PIECE_BYTES", 1)
    made = Publication(tmp_path, "dataset")
    made.write(root, {}, links_of(*PARTS), None)
    return made


def links_of(*parts, number=3):
    return {part: lambda part=part: [f"{part}{index}" for index in range(number)] for part in parts}


def keys(tmp_path):
    return set(Cache(tmp_path).all("links"))


def looked_at(monkeypatch):
    """Keys of the pieces that are read, as a list that grows."""
    real, read = Cache.get, []

    def get(self, kind, *names):
        if kind == "links":
            read.extend(names)
        return real(self, kind, *names)

    monkeypatch.setattr(Cache, "get", get)
    return read


@pytest.mark.parametrize(
    ("most", "pieces"), [(0, 0), (0.5, 1), (1.0, 1), (1.5, 2), (9.0, 9), (99, 9), (None, 9)]
)
def test_no_more_is_read_than_asked_for(publication, monkeypatch, most, pieces):
    head, read = publication._head(), looked_at(monkeypatch)
    size = head["lists"]["a"][0]
    assert {one for sizes in head["lists"].values() for one in sizes} == {size}
    assert publication._changed_links(head, None if most is None else int(most * size)) == set()
    assert len(read) == len(set(read)) == pieces


def test_another_time_it_reads_others(publication, monkeypatch):
    head, read = publication._head(), looked_at(monkeypatch)
    for _ in range(200):
        publication._changed_links(head, 1)
    assert len(set(read)) == 9


def test_what_differs_is_named(publication, root):
    next_tick()
    (root / "a1").unlink()
    (root / "b2").write_bytes(b"longer than before")
    os.utime(root / "c0", ns=(1, 1))
    assert publication.changed_files(root) == {"a1", "b2", "c0"}
    assert publication.changed_files(root.parent) is None


def test_a_piece_that_is_lost_needs_a_plan(publication, root, tmp_path):
    changes = Changes()
    changes.drop("links", "dataset/b/1")
    Cache(tmp_path).write(changes)
    with pytest.raises(PlanNeeded, match="links"):
        publication._changed_links(publication._head(), None)
    next_tick()
    (root / "mine").write_bytes(b"")  # a folder that changed has all links looked at
    assert publication.changed_files(root) is None


def test_of_a_shorter_list_and_of_parts_that_went_nothing_is_left(publication, root, tmp_path):
    assert len(keys(tmp_path)) == 9
    publication.write(root, {}, links_of("a", "b", number=2), frozenset({"a1"}))
    assert keys(tmp_path) == {"dataset/a/0", "dataset/a/1", "dataset/b/0", "dataset/b/1", "dataset/b/2"}
    publication.check()


def test_where_nothing_is_on_record_old_lists_are_removed(publication, root, tmp_path):
    other = Publication(tmp_path, "dataset0")
    other.write(root, {}, links_of("c"), None)
    changes = Changes()
    changes.drop("published", "dataset")
    Cache(tmp_path).write(changes)
    publication.write(root, {}, links_of("a"), None)
    assert keys(tmp_path) == {f"{name}/{n}" for name in ("dataset/a", "dataset0/c") for n in range(3)}
    other.check()


def test_a_list_in_several_pieces_comes_back_whole(root, tmp_path, monkeypatch):
    monkeypatch.setattr(published, "_PIECE_BYTES", 40)
    made = Publication(tmp_path, "dataset")
    made.write(root, {}, links_of("a"), None)
    sizes = made._head()["lists"]["a"]
    assert 1 < len(sizes) < 3
    assert [published._name_in(line) for line in made._lines("a", sizes)] == ["a0", "a1", "a2"]


def test_a_file_that_goes_meanwhile_leaves_nothing_on_record(publication, root):
    (root / "a1").unlink()
    publication.write(root, {}, links_of("a"), None)
    with pytest.raises(PlanNeeded, match="there is no published dataset"):
        publication.check()


def test_what_is_distrusted_does_not_hold_even_where_it_is_not_there(root, tmp_path):
    made = Publication(tmp_path, "dataset")
    made.write(root, {"a0": "digest of a0", "a1": "digest of a1"}, links_of("b"), None)
    made.check()
    (root / "a1").unlink()
    made.distrust(0.0, links=False)
    assert made.changed_files(root) >= {"a0", "a1"}
    assert not made.is_as_published(
        root, lambda path: f"digest of {path.rpartition('/')[2]}" if "a0" in path else ""
    )
    with pytest.raises(PlanNeeded):
        made.check()


def test_what_a_crash_may_have_torn_is_distrusted_until_the_dataset_is_published_again(root, tmp_path):
    made = Publication(tmp_path, "dataset")
    made.write(root, {"a0": "digest of a0"}, links_of("b"), None)
    assert made.torn_since_s is None
    made.distrust(200.0, links=True)
    made.distrust(300.0, links=True)  # after another crash, before anything was published
    assert made.torn_since_s == 200.0
    assert made.is_as_published(root, lambda path: f"digest of {path.rpartition('/')[2]}") is False
    assert Publication(tmp_path, "dataset").torn_since_s == 200.0
    made.write(root, {"a0": "digest of a0"}, links_of("b"), None)
    assert made.torn_since_s is None


def test_a_file_that_is_gone_when_it_is_recorded_does_not_hold(root, tmp_path):
    made = Publication(tmp_path, "dataset")
    made.write(root, {"nothing": "digest"}, {}, None)
    assert made.changed_files(root) == {"nothing"}
