"""Files on their way into a dataset: links, clones, copies, exchanged folders, old names, and what is refused."""

import errno
import fcntl
import json
import os
import subprocess
import sys

import pytest

from bagassets.base import files
from bagassets.base.errors import DatasetError
from bagassets.base.files import swap_in
from bagassets.formats.assembly import remove_files
from bagassets.formats.groups import Piece, write_rows
from bagassets.formats.guard import GUARD, guarded, refuse_unexpected
from bagassets.formats.json_files import TABLE, row_blocks, rows_text
from bagassets.formats.linking import Linker
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.nuscenes.table_file import read_table, table_bytes

pytestmark = pytest.mark.once


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "store" / "a.jpg"
    path.parent.mkdir()
    path.write_bytes(b"picture")
    return path


def refuse_links(monkeypatch, number):
    asked = []

    def refuse(one, other):
        asked.append(other)
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "link", refuse)
    return asked


class TestLinker:
    def test_a_file_is_linked_and_one_that_is_there_is_kept(self, tmp_path, source):
        linker = Linker(tmp_path / "data", tmp_path)
        linker.put(str(source), "samples/CAM/a.jpg")
        linker.put(str(source), "samples/CAM/a.jpg")
        linker.put(str(source), "sweeps/CAM/a.jpg")
        assert dict(linker.counts) == {"linked": 2, "kept": 1}
        assert (tmp_path / "data" / "samples" / "CAM" / "a.jpg").samefile(source)

    @pytest.mark.parametrize("name", ["EXDEV", "EPERM", "EOPNOTSUPP", "ENOSYS", "EACCES"])
    def test_without_hard_links_files_are_copied_and_links_not_tried_again(
        self, tmp_path, source, monkeypatch, name
    ):
        asked = refuse_links(monkeypatch, getattr(errno, name))
        linker = Linker(tmp_path / "data", tmp_path)
        for target in ("a.jpg", "b.jpg", "b.jpg"):
            linker.put(str(source), target)
        assert linker.counts["copied"] + linker.counts["cloned"] == 2
        assert linker.counts["kept"] == 1
        assert len(asked) == 1
        assert sorted(path.name for path in (tmp_path / "data").iterdir()) == ["a.jpg", "b.jpg"]
        assert (tmp_path / "data" / "b.jpg").read_bytes() == b"picture"

    def test_a_file_with_too_many_links_is_copied_and_the_next_linked_again(
        self, tmp_path, source, monkeypatch
    ):
        asked = refuse_links(monkeypatch, errno.EMLINK)
        linker = Linker(tmp_path / "data", tmp_path)
        linker.put(str(source), "a.jpg")
        linker.put(str(source), "b.jpg")
        assert len(asked) == 2
        assert linker.counts["copied"] + linker.counts["cloned"] == 2

    def test_a_file_is_cloned_where_the_file_system_can(self, tmp_path, source, monkeypatch):
        asked = []

        def clone(target, request, original):
            asked.append(request)
            os.write(target, os.pread(original, 99, 0))

        refuse_links(monkeypatch, errno.EXDEV)
        monkeypatch.setattr(files, "ioctl", clone)
        linker = Linker(tmp_path / "data", tmp_path)
        linker.put(str(source), "a.jpg")
        assert dict(linker.counts) == {"cloned": 1}
        assert asked == [0x40049409]
        assert (tmp_path / "data" / "a.jpg").read_bytes() == b"picture"

    def test_a_file_that_is_gone_from_the_store_is_named(self, tmp_path, source):
        source.unlink()
        with pytest.raises(
            DatasetError, match=r"a\.jpg: this file of the store is gone, so s/a.jpg cannot be made"
        ):
            Linker(tmp_path / "data", tmp_path).put(str(source), "s/a.jpg")

    def test_a_dataset_that_cannot_be_written_is_named(self, tmp_path, source, monkeypatch):
        refuse_links(monkeypatch, errno.ENOSPC)
        with pytest.raises(DatasetError, match=r"data/a\.jpg: cannot be written \(No space left on device\)"):
            Linker(tmp_path / "data", tmp_path).put(str(source), "a.jpg")

    def test_a_copy_that_fails_leaves_nothing(self, tmp_path, source, monkeypatch):
        def full(*_args):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        refuse_links(monkeypatch, errno.EXDEV)
        monkeypatch.setattr(files.shutil, "copyfile", full)
        with pytest.raises(DatasetError, match="cannot be written"):
            Linker(tmp_path / "data", tmp_path).put(str(source), "a.jpg")
        assert list((tmp_path / "data").iterdir()) == []

    def test_a_copy_grows_in_the_scratch_folder_which_is_removed_after_a_kill(
        self, tmp_path, source, monkeypatch
    ):
        targets, copyfile = [], files.shutil.copyfile
        refuse_links(monkeypatch, errno.EXDEV)
        monkeypatch.setattr(
            files.shutil, "copyfile", lambda one, other: (targets.append(other), copyfile(one, other))
        )
        (tmp_path / "scratch").mkdir()
        Linker(tmp_path / "data", tmp_path / "scratch").put(str(source), "s/a.jpg")
        assert [target.parent for target in targets] == [tmp_path / "scratch"]
        assert (tmp_path / "data" / "s" / "a.jpg").read_bytes() == b"picture"
        assert list((tmp_path / "scratch").iterdir()) == []

    @pytest.mark.parametrize(
        ("torn_since_s", "content"),
        [(None, b"\0\0\0\0\0\0\0"), (2000.0, b"\0\0\0\0\0\0\0"), (1000.0, b"picture")],
    )
    def test_a_file_that_a_crash_may_have_torn_is_compared(self, tmp_path, source, torn_since_s, content):
        (tmp_path / "data").mkdir()
        target = tmp_path / "data" / "a.jpg"
        target.write_bytes(bytes(7))
        os.utime(target, (1000, 1000))
        Linker(tmp_path / "data", tmp_path, torn_since_s).put(str(source), "a.jpg")
        assert target.read_bytes() == content


class TestSwap:
    @pytest.fixture
    def folders(self, tmp_path):
        for name in ("new", "current"):
            (tmp_path / name).mkdir()
            (tmp_path / name / "which").write_text(name)
        return tmp_path / "new", tmp_path / "current"

    def test_the_first_one_is_moved_in(self, tmp_path):
        (tmp_path / "new").mkdir()
        assert swap_in(tmp_path / "new", tmp_path / "current") is None
        assert [path.name for path in tmp_path.iterdir()] == ["current"]

    def test_two_are_exchanged(self, folders):
        new, current = folders
        inode = current.stat().st_ino
        assert swap_in(new, current) == new
        assert ((current / "which").read_text(), (new / "which").read_text()) == ("new", "current")
        assert new.stat().st_ino == inode

    @pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, None])
    def test_where_they_cannot_be_they_are_renamed(self, folders, monkeypatch, number):
        new, current = folders
        monkeypatch.setattr(files.ctypes, "CDLL", fake_c_library(number))
        old = swap_in(new, current)
        assert old.parent == current.parent
        assert (current / "which").read_text() == "new"
        assert (old / "which").read_text() == "current"
        assert not new.exists()

    def test_any_other_refusal_is_an_error(self, folders, monkeypatch):
        new, current = folders
        monkeypatch.setattr(files.ctypes, "CDLL", fake_c_library(errno.EACCES))
        with pytest.raises(PermissionError, match="Permission denied"):
            swap_in(new, current)
        assert (current / "which").read_text() == "current"


def fake_c_library(number):
    """A C library whose `renameat2` fails with an error, or that has none."""

    class Library:
        def __init__(self, *_args, **_options):
            if number is not None:
                self.renameat2 = lambda *_args: (files.ctypes.set_errno(number), -1)[1]

    return Library


SAMPLE = {"token": "t", "timestamp": 1, "prev": "", "next": "", "scene_token": "s"}


class TestTables:
    def test_a_table_that_is_gone_torn_or_no_list_is_refused(self, tmp_path):
        with pytest.raises(
            DatasetError, match=r"sample\.json: this nuScenes table cannot be read .*build the dataset"
        ):
            read_table(tmp_path, "sample")
        (tmp_path / "sample.json").write_bytes(table_bytes("sample", [SAMPLE])[:-9])
        with pytest.raises(DatasetError, match="cannot be read"):
            read_table(tmp_path, "sample")
        (tmp_path / "sample.json").write_bytes(b"{}")
        with pytest.raises(DatasetError, match="must be a list of rows"):
            read_table(tmp_path, "sample")

    @pytest.mark.parametrize("number", [0, 1, 3])
    def test_rows_are_one_a_line_and_come_back(self, tmp_path, number):
        rows = [SAMPLE | {"token": f"t{i}"} for i in range(number)]
        (tmp_path / "sample.json").write_bytes(table_bytes("sample", rows))
        assert read_table(tmp_path, "sample") == rows
        assert [json.loads(row) for block in row_blocks(tmp_path / "sample.json") for row in block] == rows
        assert rows_text(tmp_path / "sample.json").count(b"\n") == max(0, number - 1)

    def test_joined_tables_count_their_rows(self, tmp_path):
        texts = []
        for number in (2, 0, 1):
            (tmp_path / "sample.json").write_bytes(table_bytes("sample", [SAMPLE] * number))
            texts.append(rows_text(tmp_path / "sample.json"))
        _, found = write_rows(tmp_path / "joined.json", TABLE, [Piece(None, texts)])
        assert [one.number for one in found] == [3]
        assert (tmp_path / "joined.json").read_bytes() == table_bytes("sample", [SAMPLE] * 3)


class TestStale:
    def tables(self, folder, *names):
        folder.mkdir(exist_ok=True)
        rows = [{"token": str(i), "filename": name} for i, name in enumerate(names)]
        lines = [json.dumps(row, separators=(",", ":")) for row in rows]
        (folder / "sample_data.json").write_text("[\n" + ",\n".join(lines) + "\n]\n")
        return folder

    def test_without_tables_no_file_is_named(self, tmp_path):
        assert list(NUSCENES.places.named_in(tmp_path)) == []

    def test_files_go_and_so_do_folders_that_become_empty(self, tmp_path):
        for name in ("samples/CAM/1.jpg", "samples/CAM/2.jpg", "sweeps/CAM/3.jpg"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_bytes(b"")
        assert remove_files(tmp_path, {"samples/CAM/1.jpg", "sweeps/CAM/3.jpg", "sweeps/CAM/gone.jpg"}) == 2
        left = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")}
        assert left == {"samples", "samples/CAM", "samples/CAM/2.jpg", "sweeps"}


class TestGuard:
    def test_others_wait_until_it_is_done(self, tmp_path):
        with (
            guarded(tmp_path / "out"),
            (tmp_path / "out" / GUARD).open() as other,
            pytest.raises(BlockingIOError),
        ):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        with (tmp_path / "out" / GUARD).open() as other:
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def test_it_waits_for_another_process(self, tmp_path):
        script = (
            "import sys, time; from pathlib import Path; from bagassets.formats.guard import guarded\n"
            "with guarded(Path(sys.argv[1])):\n"
            "    print('held', flush=True); sys.stdin.read(); Path(sys.argv[1], 'first').touch()\n"
        )
        command = [sys.executable, "-c", script, str(tmp_path / "out")]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
            assert process.stdout.readline() == b"held\n"
            process.stdin.close()
            with guarded(tmp_path / "out"):
                assert (tmp_path / "out" / "first").exists()

    def test_what_cannot_be_written_is_named(self, tmp_path):
        (tmp_path / "file").write_bytes(b"")
        with (
            pytest.raises(DatasetError, match=r"file/out: the dataset cannot be written \(Not a directory\)"),
            guarded(tmp_path / "file" / "out"),
        ):
            pass
        with (
            pytest.raises(DatasetError, match=r"^/x: the dataset cannot be written"),
            guarded(tmp_path / "out"),
        ):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/x")

    @pytest.mark.parametrize("expected", [None, {"a": "1", "b": "2"}])
    def test_tables_as_expected_stay(self, tmp_path, expected):
        refuse_unexpected(tmp_path, {"a": "1", "b": "2"}, expected)
        assert tmp_path.is_dir()

    @pytest.mark.parametrize(
        ("expected", "named"),
        [({"a": "1", "b": "3"}, "b"), ({"a": "1"}, "b"), ({"a": "1", "b": "2", "c": "4"}, "c"), ({}, "a, b")],
    )
    def test_other_tables_are_removed_and_named(self, tmp_path, expected, named):
        folder = tmp_path / "version"
        folder.mkdir()
        (folder / "a").write_bytes(b"")
        with pytest.raises(DatasetError) as caught:
            refuse_unexpected(folder, {"a": "1", "b": "2"}, expected)
        assert str(caught.value).startswith(f"{tmp_path}: {named} would differ from the lock")
        assert not folder.exists()
