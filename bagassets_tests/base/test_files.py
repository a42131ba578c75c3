"""Files appear whole or not at all."""

import ast
import errno
import os
import threading
from pathlib import Path

import pytest

import bagassets
from bagassets.base import files
from bagassets.base.files import create_atomically, replacing, write_atomically


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
        monkeypatch.setattr(files, "_rename", lambda *_: False)
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


CHANGES = {
    "TemporaryDirectory", "NamedTemporaryFile", "TemporaryFile", "mkdtemp", "mkstemp", "write_text", "write_bytes", "touch",
    "rename", "renames", "link", "hardlink_to", "symlink", "symlink_to", "unlink", "mkdir", "makedirs", "rmdir", "rmtree",
    "truncate", "ftruncate", "pwrite", "fsync", "fdatasync", "utime", "chmod", "fchmod", "copyfile", "copytree", "copyfileobj",
}  # fmt: skip
# Modules that change files by themselves -> why that needs no replay of crashes.
DIRECT = {
    "assets/grey_survey.py": "an unnamed file",
    "base/cache.py": "SQLite writes it; each entry has a digest, and whatever is lost is found out again",
    "base/lock_files.py": "nothing is read from a lock file but the name of a holder that is alive",
    "base/trace.py": "a diary that a user asked for",
    "base/unread_pipe.py": "/dev/null",
    "cli/convert.py": "a dataset and its recipe where a user wants it, moved there when complete",
    "cli/inspect.py": "scratch",
    "cli/main.py": "a log of a crash of ours",
    "cli/on_server.py": "logs, and standard streams",
    "cli/rebuild_process.py": "scratch",
    "cli/sample.py": "a recipe for a sample, where a user wants it",
    "cli/terminal.py": "/dev/null",
    "cli/remote.py": "folders of a project that is thrown away",
    "cli/throw_away.py": "a project that is thrown away",
    "defs/builds/old_runs.py": "Dagster's database",
    "defs/launchers/slurm/spool.py": "one byte more for each try",
    "defs/records/databases.py": "Dagster's databases, which are created whole, and synced",
    "defs/runs/code_server.py": "logs",
    "defs/ui/dev.py": "scratch",
    "engine/recordings_check.py": "scratch",
    "engine/trace_file.py": "a diary that a user asked for",
    "forkserver/__main__.py": "logs",
    "forkserver/client.py": "logs",
    "forkserver/server.py": "sockets",
    "forkserver/server_files.py": "sockets and logs, which end with their server",
    "forkserver/worker.py": "logs",
    "formats/lerobot/video.py": "FFmpeg writes it, below a folder that is swapped in, or into an artifact by its digest",
    "recordings/decompress.py": "scratch",
    "recordings/digest_record.py": "SQLite writes it; a recording without a digest is hashed again",
    "recordings/journals.py": "scratch",
    "recordings/salvage/copy.py": "a mended copy where a user wants it, moved there when complete",
    "recordings/salvage/examine.py": "likewise",
    "recordings/salvage/unpack.py": "scratch",
    "sample/demo.py": "sample recordings",
    "sample/recorder.py": "sample recordings",
    "store/artifact.py": "rights of its folders, which nothing rests on",
    "view/mcap_scene.py": "a scene where a user wants it, moved there when complete",
}  # fmt: skip


def is_change(call):
    """Tell whether a call changes a file: by its name, or by the mode or the flags with which it opens one."""
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    owner = ast.unparse(call.func.value) if isinstance(call.func, ast.Attribute) else ""
    if name == "replace":  # of a path: with one argument, unlike that of text and of data classes
        return owner == "os" or (len(call.args) == 1 and not call.keywords)
    if name == "open":
        given = [*call.args, *(keyword.value for keyword in call.keywords)]
        modes = [one.value for one in given if isinstance(one, ast.Constant) and isinstance(one.value, str)]
        flags = ast.unparse(call)
        writes = any(len(mode) < 4 and set("wxa+") & set(mode) for mode in modes)
        return writes or any(flag in flags for flag in ("O_CREAT", "O_WRONLY", "O_RDWR"))
    return (owner != "files" and name in CHANGES) or (
        owner in ("os", "shutil") and name in {"remove", "move", "copy", "copy2"}
    )


def changes_files(path):
    return any(
        isinstance(node, ast.Call) and is_change(node)
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
    )


def test_no_other_module_changes_files_by_itself_without_a_reason():
    root = Path(bagassets.__file__).parent
    found = {path.relative_to(root).as_posix() for path in root.rglob("*.py") if changes_files(path)}
    assert found - {"base/files.py"} == DIRECT.keys()


@pytest.mark.parametrize(
    "text",
    ["path.write_text('x')", "open(path, 'ab')", "path.open('x')", "os.replace(one, other)", "one.replace(other)",
     "os.open(path, os.O_RDWR)", "shutil.rmtree(path)", "os.remove(path)", "mkdir(path)"],
)  # fmt: skip
def test_a_change_by_any_name_is_seen(text):
    assert is_change(ast.parse(text, mode="eval").body)
    for other in (
        "text.replace('a', 'b')",
        "replace(one, name=2)",
        "path.open('rb')",
        "files.link(a, b)",
        "names.remove(a)",
    ):
        assert not is_change(ast.parse(other, mode="eval").body)
