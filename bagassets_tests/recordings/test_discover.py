import os
import time
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bagassets.base.errors import RecordingError
from bagassets.recipe.model import Bags
from bagassets.recordings.discover import _key, bags_of_one, discover, find_one
from bagassets.recordings.globs import literal_glob, matches, may_match_within
from bagassets.recordings.join_parts import FOR_NOW
from bagassets_tests.recorded_bags import NOON_NS, text, write_ros1


def touch(root, *names):
    for name in names:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x" * 10)


def relatives(root, **options):
    return sorted(
        recording.relative for recording in discover(Bags(root=root, **options)).recordings.values()
    )


def test_formats(tmp_path):
    touch(tmp_path, "a.bag", "b.mcap", "c.db3", "d/metadata.yaml", "d/d_0.mcap", "d/d_1.mcap", "notes.txt")
    recordings = {f.relative: f for f in discover(Bags(root=tmp_path)).recordings.values()}
    assert {name: f.format for name, f in recordings.items()} == {
        "a.bag": "ros1", "b.mcap": "mcap", "c.db3": "ros2", "d": "ros2",
    }  # fmt: skip
    assert [path.name for path in recordings["d"].files] == ["d_0.mcap", "d_1.mcap", "metadata.yaml"]
    assert (recordings["d"].size, recordings["a.bag"].size) == (30, 10)
    assert recordings["a.bag"].mtime_ns == (tmp_path / "a.bag").stat().st_mtime_ns


def test_compressed_and_foreign_files_of_a_ros2_folder(tmp_path):
    touch(tmp_path, "d/metadata.yaml", "d/d_0.db3.zstd", "d/._d_0.db3", "d/readme.md")
    (recording,) = discover(Bags(root=tmp_path)).recordings.values()
    assert [path.name for path in recording.files] == ["d_0.db3.zstd", "metadata.yaml"]


def test_the_root_may_itself_be_a_ros2_folder(tmp_path):
    touch(tmp_path, "drive/metadata.yaml", "drive/x_0.db3")
    (recording,) = discover(Bags(root=tmp_path / "drive")).recordings.values()
    assert (recording.key, recording.path) == ("drive", tmp_path / "drive")


def test_metadata_without_storage_is_a_plain_folder(tmp_path):
    touch(tmp_path, "d/metadata.yaml", "d/sub/a.bag")
    assert relatives(tmp_path) == ["d/sub/a.bag"]


def test_hidden_and_unfinished_files_are_no_recordings(tmp_path):
    touch(tmp_path, "a.bag.active", "b.bag.part", "c.mcap.tmp", ".d.bag", ".trash/e.bag", "lost+found/f.bag")
    assert relatives(tmp_path) == []


def test_globs_and_reasons(tmp_path):
    touch(tmp_path, "day1/a.bag", "day1/calib/b.bag", "day2/c.bag", "other.bag")
    discovery = discover(Bags(root=tmp_path, include=("day*/**",), exclude=("**/calib/**",)))
    assert sorted(f.relative for f in discovery.recordings.values()) == ["day1/a.bag", "day2/c.bag"]
    assert discovery.excluded == [
        ("day1/calib/b.bag", "excluded by bags.exclude (**/calib/**)"),
        ("other.bag", "not matched by bags.include"),
    ]


@pytest.mark.parametrize(
    ("pattern", "relative", "expected"),
    [
        ("**", "a/b.bag", True),
        ("*.bag", "a.bag", True),
        ("*.bag", "d/a.bag", False),
        ("**/*.bag", "a.bag", True),
        ("**/*.bag", "d/e/a.bag", True),
        ("d/**/a.bag", "d/a.bag", True),
        ("d/**", "d/e/a.bag", True),
        ("d/**", "d", True),
        ("d/**", "de/a.bag", False),
        ("a?.bag", "ab.bag", True),
        ("a?.bag", "a/.bag", False),
        ("[ab].bag", "b.bag", True),
        ("[!ab].bag", "b.bag", False),
        ("run[1].bag", "run1.bag", True),
        ("a.bag", "axbag", False),
        ("a+(b).bag", "a+(b).bag", True),
    ],
)
def test_matches(pattern, relative, expected):
    assert matches(pattern, relative) is expected


@pytest.mark.parametrize(
    ("pattern", "folder", "expected"),
    [
        ("**", "a/b", True),
        ("**/*.bag", "a", True),
        ("a.bag", "a", False),
        ("a.bag", "other", False),
        ("run", "run", True),
        ("d/e/a.bag", "d", True),
        ("d/e/a.bag", "d/e", True),
        ("d/e/a.bag", "d/f", False),
        ("d/**", "d", True),
        ("d/**", "d/e", True),
        ("d/**", "e", False),
        ("d?/a.bag", "dx", True),
        ("run[[]1]/a.bag", "run[1]", True),
        ("run[[]1]/a.bag", "run1", False),
    ],
)
def test_which_folders_a_glob_needs(pattern, folder, expected):
    assert may_match_within(pattern, folder) is expected


@given(pattern=st.text("ab/*?[].", max_size=8), relative=st.text("ab/.[*", min_size=1, max_size=6))
def test_no_folder_of_a_match_is_passed_over(pattern, relative):
    if matches(pattern, relative):
        parts = relative.split("/")
        assert all(may_match_within(pattern, "/".join(parts[:n])) for n in range(1, len(parts) + 1))


@given(name=st.text("ab/.[]*?!", min_size=1, max_size=8), other=st.text("ab/.[]*?!", min_size=1, max_size=8))
def test_a_literal_glob_matches_just_its_path(name, other):
    assert matches(literal_glob(name), name)
    assert matches(literal_glob(name), other) is (name == other)


def test_the_bags_of_one_recording(tmp_path):
    touch(tmp_path, "a[1].bag", "b.bag", "ros2/metadata.yaml", "ros2/ros2_0.db3", "deep/er/c.bag")
    assert list(discover(bags_of_one(tmp_path / "a[1].bag")).recordings.values()) == [
        find_one(tmp_path / "a[1].bag")
    ]
    for path in (tmp_path / "ros2", tmp_path / "ros2" / "ros2_0.db3"):
        assert [one.path for one in discover(bags_of_one(path)).recordings.values()] == [tmp_path / "ros2"]
    for path in (tmp_path / "deep", tmp_path / "no.bag"):
        with pytest.raises(RecordingError):
            bags_of_one(path)


def test_one_recording_costs_no_walk_through_other_folders(tmp_path, monkeypatch):
    touch(tmp_path, "a.bag", "other/b.bag")
    forbid(monkeypatch, tmp_path / "other")
    assert discover(Bags(root=tmp_path)).unreadable
    discovery = discover(bags_of_one(tmp_path / "a.bag"))
    assert list(discovery.recordings) == ["a.bag"]
    assert not discovery.unreadable


def test_missing_root(tmp_path):
    with pytest.raises(RecordingError, match=r"no such folder; correct bags\.root"):
        discover(Bags(root=tmp_path / "nowhere"))


def test_links_are_followed_but_not_in_circles(tmp_path):
    touch(tmp_path, "real/a.bag")
    (tmp_path / "real" / "up").symlink_to(tmp_path)
    (tmp_path / "again").symlink_to(tmp_path / "real")
    (tmp_path / "b.bag").symlink_to(tmp_path / "real" / "a.bag")
    (tmp_path / "self").symlink_to(tmp_path / "self")
    (tmp_path / "self.bag").symlink_to(tmp_path / "self.bag")
    (tmp_path / "broken.bag").symlink_to(tmp_path / "nothing")
    assert relatives(tmp_path) == ["again/a.bag", "b.bag", "real/a.bag"]
    nowhere = "a link that leads nowhere"
    assert discover(Bags(root=tmp_path)).excluded == [("broken.bag", nowhere), ("self.bag", nowhere)]


def test_a_name_in_capitals_is_listed(tmp_path):
    """Some file systems of cameras and memory cards write names so; a folder with that name is none."""
    touch(tmp_path, "a.bag", "B.BAG", "folder.BAG/c.Mcap", "notes.TXT")
    found = discover(Bags(root=tmp_path))
    assert list(found.recordings) == ["a.bag"]
    assert sorted(found.excluded) == [
        ("B.BAG", "the name of a recording ends in .bag; rename it so"),
        ("folder.BAG/c.Mcap", "the name of a recording ends in .mcap; rename it so"),
    ]


def test_a_link_to_a_folder_that_holds_the_bag_root_is_not_walked(tmp_path):
    touch(tmp_path, "outside/a.bag", "x/root/b.bag")
    root = tmp_path / "x" / "root"
    for name, target in (
        ("top", tmp_path),
        ("up", tmp_path / "x"),
        ("all", "/"),
        ("aside", tmp_path / "outside"),
    ):
        (root / name).symlink_to(target)
    (tmp_path / "by_link").symlink_to(root)
    for one in (root, tmp_path / "by_link"):
        assert relatives(one) == ["aside/a.bag", "b.bag"]


def forbid(monkeypatch, folder):
    """Make a folder unreadable; chmod would not stop tests that run as root."""
    scandir = os.scandir

    def guarded(path):
        if Path(path) == folder:
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", guarded)


def test_an_unreadable_folder_is_left_out_with_a_reason(tmp_path, monkeypatch):
    touch(tmp_path, "a.bag", "private/b.bag", "z/c.bag")
    forbid(monkeypatch, tmp_path / "private")
    discovery = discover(Bags(root=tmp_path))
    assert list(discovery.recordings) == ["a.bag", "z__c.bag"]
    reason = "cannot be read: permissions; correct that, or name it in bags.exclude"
    assert discovery.excluded == [("private", reason)]
    assert discovery.unreadable == {"private": f"{tmp_path / 'private'}: {reason}."}


def test_an_unreadable_folder_may_be_excluded_by_name(tmp_path, monkeypatch):
    touch(tmp_path, "a.bag", "private/b.bag")
    forbid(monkeypatch, tmp_path / "private")
    discovery = discover(Bags(root=tmp_path, exclude=("private/**",)))
    assert list(discovery.recordings) == ["a.bag"]
    assert discovery.excluded == [("private", "cannot be read, and excluded by bags.exclude (private/**)")]
    assert discovery.unreadable == {}
    assert discovery.removed(["private__b.bag"]) == ("private__b.bag",)


def test_an_unreadable_root_is_refused(tmp_path, monkeypatch):
    forbid(monkeypatch, tmp_path)
    with pytest.raises(RecordingError, match=r"cannot be read: permissions; correct that or bags\.root"):
        discover(Bags(root=tmp_path))


@pytest.mark.parametrize("folder", ["private", "Tür 1/x", "東京", "_a_", "x" * 120, "a/metadata"])
def test_recordings_in_an_unreadable_folder_are_not_removed(tmp_path, monkeypatch, folder):
    # Names are UTF-8 on disk, whatever the encoding of this process.
    folder, last = (os.fsdecode(name.encode()) for name in (folder, "京.db3"))
    names = ["b.bag", "sub/c.bag", "my drive.mcap", last]
    touch(tmp_path / folder, *names)
    touch(tmp_path, "other/d.bag")
    before = discover(Bags(root=tmp_path)).recordings
    assert len(before) == 5
    forbid(monkeypatch, tmp_path / folder)
    discovery = discover(Bags(root=tmp_path))
    assert list(discovery.recordings) == ["other__d.bag"]
    assert discovery.unseen(before) == before.keys() - {"other__d.bag"}
    assert discovery.removed([*before, "other__e.bag"]) == ("other__e.bag",)


def test_a_bag_folder_that_cannot_be_read_is_not_removed(tmp_path, monkeypatch):
    touch(tmp_path, "my d/metadata.yaml", "my d/d.mcap")
    (key,) = discover(Bags(root=tmp_path)).recordings
    forbid(monkeypatch, tmp_path / "my d")
    assert discover(Bags(root=tmp_path)).unseen([key, "my-dog.bag"]) == {key}


def test_a_name_that_is_no_utf8_is_reported(tmp_path):
    Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9.bag")).write_bytes(b"")
    discovery = discover(Bags(root=tmp_path))
    assert discovery.recordings == {}
    assert discovery.excluded == [("caf\\udce9.bag", "its name is not UTF-8; rename it")]


def test_keys_are_readable():
    assert _key("drive.bag") == "drive.bag"
    assert _key("2024/munich/drive-1.bag") == "2024__munich__drive-1.bag"
    assert _key("my drive.bag").startswith("my-drive.bag-")
    assert _key("Tür.bag").startswith("Tur.bag-")
    assert _key("東京.bag").startswith("bag-")
    assert len(_key("x" * 250 + ".bag")) < 120


@pytest.mark.parametrize(
    ("one", "other"),
    [("a/b.bag", "a__b.bag"), ("a_/b.bag", "a/_b.bag"), ("a b.bag", "a-b.bag"), ("a...b.bag", "a.b.bag"),
     ("ä.bag", "a.bag"), ("x" * 120 + "1.bag", "x" * 120 + "2.bag"), ("a.bag", "a.mcap")],
)  # fmt: skip
def test_keys_differ(one, other):
    assert _key(one) != _key(other)


@given(
    st.lists(st.text(alphabet="ab_-. é|\n/", min_size=1, max_size=8), min_size=2, max_size=30, unique=True)
)
def test_keys_are_unique_and_fit_for_dagster(names):
    keys = [_key(name) for name in names]
    assert len(set(keys)) == len(names)
    for key in keys:
        assert key
        assert key.isascii()
        assert key.isprintable()
        assert "..." not in key
        assert not set(key) & set("|/ ")


def test_a_key_does_not_hang_on_neighbours(tmp_path):
    touch(tmp_path, "a/b c.bag")
    before = set(discover(Bags(root=tmp_path)).recordings)
    touch(tmp_path, "a/b-c.bag", "a__b c.bag", "a/b c.mcap", "a/b c/metadata.yaml", "a/b c/x.db3")
    after = discover(Bags(root=tmp_path)).recordings
    assert before < set(after)
    assert len(after) == 5
    assert list(after) == sorted(after)


def test_find_one(tmp_path, monkeypatch):
    touch(tmp_path, "a.bag", "d/metadata.yaml", "d/d.mcap", "empty/x.txt", "notes.txt")
    assert find_one(tmp_path / "a.bag").key == "a.bag"
    assert find_one(tmp_path / "d").format == "ros2"
    monkeypatch.chdir(tmp_path)
    assert find_one(Path("d")).path == tmp_path / "d"
    for name, told in [
        ("nothing.bag", "no such file"),
        ("empty", "metadata.yaml"),
        ("notes.txt", "expected a rec"),
    ]:
        with pytest.raises(RecordingError, match=told):
            find_one(tmp_path / name)


def test_thousands_of_files_take_no_time(tmp_path):
    for day in range(20):
        (tmp_path / str(day)).mkdir()
        for number in range(100):
            (tmp_path / str(day) / f"{number}.bag").touch()
    start = time.process_time()
    assert len(discover(Bags(root=tmp_path)).recordings) == 2000
    assert time.process_time() - start < 0.5


class TestUnfinished:
    """What recorders leave that were stopped is seen, and listed with what it is."""

    def old(self, root, *names):
        for name in names:
            touch(root, name)
            (root / name).write_bytes(b"12345" * 20)
            os.utime(root / name, (1_700_000_000, 1_700_000_000))

    def test_a_bag_that_its_recorder_did_not_finish_has_the_key_of_the_finished_one(self, tmp_path):
        self.old(tmp_path, "a/x.bag.active")
        (found,) = discover(Bags(root=tmp_path)).recordings.values()
        (finished,) = (tmp_path / "a" / "x.bag.active").parent.glob("*")
        assert (found.key, found.relative, found.path, found.files) == (
            "a__x.bag",
            "a/x.bag",
            finished,
            (finished,),
        )
        assert find_one(finished) == replace(found, key="x.bag", relative="x.bag")
        (alone,) = discover(bags_of_one(finished)).recordings.values()
        assert alone.path == finished
        finished.rename(tmp_path / "a" / "x.bag")
        (found,) = discover(Bags(root=tmp_path)).recordings.values()
        assert (found.key, found.path.name) == ("a__x.bag", "x.bag")

    def test_it_gives_way_to_the_finished_one(self, tmp_path):
        self.old(tmp_path, "x.bag.active", "x.bag")
        discovery = discover(Bags(root=tmp_path))
        assert [one.path.name for one in discovery.recordings.values()] == ["x.bag"]
        assert discovery.excluded == [
            ("x.bag.active", "unfinished, and x.bag lies beside it, which is taken")
        ]

    def test_while_it_grows_it_is_no_recording(self, tmp_path):
        touch(tmp_path, "x.bag.active")
        discovery = discover(Bags(root=tmp_path, settle_s=0))
        assert not discovery.recordings
        ((name, reason),) = discovery.excluded
        assert name == "x.bag.active"
        assert FOR_NOW in reason  # by which a build knows that it has to look again without a change
        with pytest.raises(RecordingError, match="its recorder may be at work"):
            bags_of_one(tmp_path / "x.bag.active")
        then_s = time.time() - 601
        os.utime(tmp_path / "x.bag.active", (then_s, then_s))
        assert list(discover(Bags(root=tmp_path)).recordings) == ["x.bag"]

    def test_globs_are_about_the_finished_name(self, tmp_path):
        self.old(tmp_path, "x.bag.active", "y.bag.active", "z.db3.zstd")
        discovery = discover(Bags(root=tmp_path, include=("*.bag",), exclude=("y.bag",)))
        assert list(discovery.recordings) == ["x.bag"]

    def test_other_remains_are_listed_with_what_they_are(self, tmp_path):
        self.old(
            tmp_path,
            "a_0.db3.zstd",
            "b.mcap.zstd",
            "b.mcap",
            "c.db3-wal",
            "d.db3-journal",
            "d.db3",
            "e.zstd",
            "f.active",
        )
        touch(tmp_path, "g.db3-wal")
        discovery = discover(Bags(root=tmp_path))
        assert list(discovery.recordings) == ["b.mcap", "d.db3"]
        told = dict(discovery.excluded)
        assert sorted(told) == ["a_0.db3.zstd", "b.mcap.zstd", "c.db3-wal"]
        assert "bagassets doctor" in told["a_0.db3.zstd"]
        assert told["b.mcap.zstd"] == "b.mcap was being compressed into it, which is the recording"
        assert told["c.db3-wal"].startswith("the last messages of c.db3, which is not here")

    def test_recordings_that_somebody_has_packed_are_listed(self, tmp_path):
        self.old(tmp_path, "a.bag.zst", "b.mcap.gz", "b.mcap", "c.bag.zstd", "notes.txt.gz", "d.db3.xz")
        discovery = discover(Bags(root=tmp_path))
        assert list(discovery.recordings) == ["b.mcap"]
        assert dict(discovery.excluded) == {
            "a.bag.zst": "compressed as a whole; decompress it to a.bag",
            "b.mcap.gz": "compressed as a whole; b.mcap lies beside it, which is taken",
            "c.bag.zstd": "compressed as a whole; decompress it to c.bag",
            "d.db3.xz": "compressed as a whole; decompress it to d.db3",
        }

    def test_the_last_part_of_a_drive_may_be_unfinished(self, tmp_path):
        for number, name in enumerate(("d_0.bag", "d_1.bag", "d_2.bag.active")):
            write_ros1(tmp_path / name, [text(NOON_NS + (number * 100 + i) * 10**8) for i in range(100)])
        os.utime(tmp_path / "d_2.bag.active", (1_700_000_000, 1_700_000_000))
        (one,) = discover(Bags(root=tmp_path)).recordings.values()
        assert (one.key, one.path, [part.path.name for part in one.parts]) == (
            "d.bag", tmp_path / "d.bag", ["d_0.bag", "d_1.bag", "d_2.bag.active"],
        )  # fmt: skip
