"""Files that others on the machine could hold, or that would hold us."""

import os
import socket
import stat
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from bagassets.base import lock_files
from bagassets.base.errors import RecipeError, RecordingError
from bagassets.base.lock_files import LockFile, is_locked
from bagassets.defs.builds import project_build
from bagassets.defs.runs.exclusive import exclusive
from bagassets.engine.build_report import BagOutcome, BuildReport
from bagassets.engine.plan import Plan
from bagassets.engine.summary_rows import summary_rows
from bagassets.formats.catalogue import recording_assets
from bagassets.formats.guard import GUARD, guarded
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Bags
from bagassets.recordings.discover import discover, find_one
from bagassets.store.lease import action_lock, in_use, in_use_since_s
from bagassets_tests.in_process import build, make_project
from bagassets_tests.recording_build import ASSETS
from bagassets_tests.small_drive import RECIPE, write_drive

pytestmark = pytest.mark.once

SECONDS = 20


def mode_of(path):
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture(autouse=True)
def usual_umask():
    before = os.umask(0o022)
    yield
    os.umask(before)


# --- lock files --------------------------------------------------------------------------


def test_a_lock_file_is_its_owners_or_its_groups_alone(tmp_path):
    for name, shared, mode in (("own", False, 0o600), ("shared", True, 0o640)):
        LockFile.open(tmp_path / name, shared=shared).close()
        assert mode_of(tmp_path / name) == mode
    old = tmp_path / "own"
    old.chmod(0o644)  # as an earlier version made it
    LockFile.open(old).close()
    assert mode_of(old) == 0o600
    os.umask(0o002)
    LockFile.open(tmp_path / "group", shared=True).close()
    assert mode_of(tmp_path / "group") == 0o660, "who shares a store shares its locks"


def test_no_lock_of_a_build_can_be_held_by_others(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path)
    assert build(recipe_file, monkeypatch)[0].succeeded
    recipe = load_recipe(recipe_file)
    with ExitStack() as stack:
        stack.enter_context(action_lock(recipe.store_path, "a" * 64))
        stack.enter_context(in_use(recipe.store_path))
        stack.enter_context(exclusive(recipe.state / "locks", "key", keep_waiting=lambda _: False))
        stack.enter_context(guarded(recipe.nuscenes.output))
        leases = list((recipe.store_path / "leases").iterdir())
        locks = [*recipe.state.rglob("*.lock"), *leases, recipe.nuscenes.output / GUARD]
        assert len(locks) >= 5
        assert {str(path): oct(mode_of(path)) for path in locks if mode_of(path) & 0o007} == {}


def test_a_lease_of_another_user_of_a_shared_store_counts(tmp_path, monkeypatch):
    with in_use(tmp_path):
        (lease,) = (tmp_path / "leases").iterdir()
        begun_s = lease.stat().st_mtime
        opened = os.open

        def only_read(path, flags, *mode):
            if Path(path) == lease and flags & os.O_RDWR:
                raise PermissionError(13, "Permission denied", str(path))
            return opened(path, flags, *mode)

        monkeypatch.setattr(os, "open", only_read)
        assert in_use_since_s(tmp_path) == begun_s
    lease.touch()  # its process is no more
    assert in_use_since_s(tmp_path) is None
    assert not lease.exists()


HOLDER = """
import sys, time
from pathlib import Path
from bagassets.base.lock_files import LockFile
lock = LockFile.open(Path(sys.argv[1]))
lock.lock()
print("held", flush=True)
time.sleep(60)
"""


@contextmanager
def held_elsewhere(path):
    """Have another process hold a lock; yields the process."""
    command = [sys.executable, "-c", HOLDER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout.readline() == b"held\n"
            yield process
        finally:
            process.kill()


def test_a_lock_is_for_one_process_until_that_is_killed(tmp_path):
    path = tmp_path / "x"
    with held_elsewhere(path) as other, LockFile.open(path) as lock:
        assert is_locked(path)
        assert not lock.try_lock()
        other.kill()
        other.wait()
        assert not is_locked(path)
        assert lock.try_lock()
        assert is_locked(path)
    assert not is_locked(path)


def test_a_lock_is_waited_for(tmp_path):
    path = tmp_path / "x"
    with held_elsewhere(path) as other, LockFile.open(path) as lock:
        killer = threading.Timer(0.3, other.kill)
        began = time.monotonic()
        killer.start()
        lock.lock()
        assert time.monotonic() - began >= 0.3
        assert is_locked(path)


def test_a_lock_file_that_was_replaced_is_not_in_place(tmp_path):
    path = tmp_path / "x"
    with LockFile.open(path) as old:
        assert old.is_in_place
        path.unlink()
        assert not old.is_in_place
        with LockFile.open(path) as new:
            assert new.is_in_place
            assert not old.is_in_place


def test_what_is_written_in_a_lock_file_is_read_by_those_who_may_not_lock_it(tmp_path):
    with LockFile.open(tmp_path / "x") as holder, LockFile.open(tmp_path / "x") as other:
        assert holder.try_lock()
        assert not other.try_lock()
        holder.write("a long text")
        holder.write("örtlich")
        assert other.read() == "örtlich"
        holder.remove()
        holder.close()  # once more does no harm
        assert other.try_lock()
    assert not (tmp_path / "x").exists()


def test_a_lock_file_that_must_be_new_is_not_taken_over(tmp_path):
    LockFile.open(tmp_path / "x", new=True).close()
    with pytest.raises(FileExistsError):
        LockFile.open(tmp_path / "x", new=True)


def test_a_link_in_the_place_of_a_lock_file_is_refused(tmp_path):
    secret = tmp_path / "secret"
    secret.touch(0o644)
    (tmp_path / "x").symlink_to(secret)
    for refused in (LockFile.open, is_locked):
        with pytest.raises(OSError, match="symbolic links"):
            refused(tmp_path / "x")
    assert mode_of(secret) == 0o644


def test_locks_are_taken_in_one_module():
    root = Path(lock_files.__file__).parent
    users = {
        path.relative_to(root).as_posix()
        for path in root.rglob("*.py")
        if "flock(" in path.read_text("utf-8")
    }
    assert users == {"lock_files.py"}


# --- recipes -----------------------------------------------------------------------------


def bomb(levels, of):
    lines = [f"a0: &a0 [{', '.join(['x'] * of)}]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * of)}]" for n in range(1, levels)]
    return "\n".join(lines)


def merge_bomb(levels, of):
    lines = ["a0: &a0 {x: 1}"]
    lines += [f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * of)}]}}" for n in range(1, levels)]
    return "\n".join(lines)


@pytest.mark.parametrize("text", [bomb(9, 10), bomb(30, 2), merge_bomb(9, 10), merge_bomb(28, 2)])
def test_a_recipe_of_aliases_of_aliases_is_refused_at_once(tmp_path, text):
    path = tmp_path / "recipe.yaml"
    path.write_text(RECIPE.format(name="test", root="bags") + text)
    begun_s = time.process_time()
    with pytest.raises(RecipeError, match=r"recipe\.yaml:\d+: .*aliases stand for more than \d+ values"):
        load_recipe(path)
    assert time.process_time() - begun_s < SECONDS


def test_aliases_that_spare_some_lines_are_fine(tmp_path):
    path = tmp_path / "recipe.yaml"
    text = RECIPE.format(name="test", root="bags")
    text = text.replace("CAM_FRONT: {", "CAM_FRONT: &camera {").rstrip("\n")
    path.write_text(text + "\n      CAM_BACK: {<<: *camera, topic: /back}\n")
    assert load_recipe(path).rigs[0].channels["CAM_BACK"].topic == "/back"


# --- what is no file ---------------------------------------------------------------------


def a_pipe(path):
    os.mkfifo(path)


def a_device(path):
    path.symlink_to("/dev/zero")


def a_socket(path):
    here = Path.cwd()
    os.chdir(path.parent)  # its name may be too long otherwise
    try:
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(path.name)
    finally:
        os.chdir(here)


@pytest.mark.parametrize(
    ("make", "what"), [(a_pipe, "a named pipe"), (a_device, "a device"), (a_socket, "a socket")]
)
class TestSpecialFiles:
    def test_inspect_says_what_it_is(self, tmp_path, make, what):
        make(tmp_path / "x.bag")
        command = [sys.executable, "-m", "bagassets", "inspect", str(tmp_path / "x.bag")]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
        assert done.returncode == 1
        assert (
            done.stderr
            == f"error: {tmp_path}/x.bag: expected a recording, but this is {what}; name a file or folder.\n"
        )

    def test_below_the_bag_root_it_is_left_out_and_named(self, tmp_path, make, what):
        write_drive(tmp_path / "a.bag", "ros1", duration_s=0.5)
        make(tmp_path / "x.mcap")
        discovery = discover(Bags(root=tmp_path))
        assert list(discovery.recordings) == ["a.bag"]
        assert discovery.excluded == [("x.mcap", f"this is {what}, no file")]

    @pytest.mark.parametrize("name", ["metadata.yaml", "part_1.mcap"])
    def test_so_is_a_bag_folder_with_one(self, tmp_path, make, what, name):
        folder = tmp_path / "bags" / "drive"
        folder.mkdir(parents=True)
        for other in ("metadata.yaml", "part_0.mcap"):
            (folder / other).touch()
        (folder / name).unlink(missing_ok=True)
        make(folder / name)
        discovery = discover(Bags(root=tmp_path / "bags"))
        assert (discovery.recordings, discovery.excluded) == (
            {},
            [("drive", f"{name} in it is {what}, no file")],
        )
        with pytest.raises(RecordingError, match=f"{name} in it is {what}"):
            find_one(folder)


# --- a recording that goes ---------------------------------------------------------------


def test_a_recording_removed_before_the_summary_has_a_row(tmp_path):
    report = BuildReport(
        Plan({}, {}, ()), outcomes={"a.bag": BagOutcome("built"), "b.bag": BagOutcome("failed", "Why.")}
    )
    rows = summary_rows(report, ASSETS)
    assert [(row.recording, row.result, row.reason) for row in rows] == [
        ("a.bag", "built", "it was removed meanwhile, so the dataset is without it"),
        ("b.bag", "failed", "Why."),
    ]
    assert rows[0].keyframes is None


def test_a_recording_removed_during_a_build_costs_nothing_but_itself(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path, ["a.bag", "b.mcap"])
    original = project_build.build_project

    def build_and_remove(file, options, _on_event):
        def remove(event):
            if (event.kind, event.key) == ("done", "a.bag"):
                (tmp_path / "bags" / "a.bag").unlink()

        return original(file, options, remove)

    monkeypatch.setattr(project_build, "build_project", build_and_remove)
    report, _ = build(recipe_file, monkeypatch)
    rows = {row.recording: row for row in summary_rows(report, recording_assets(load_recipe(recipe_file)))}
    assert rows["a.bag"].reason == "it was removed meanwhile, so the dataset is without it"
    assert (rows["b.mcap"].result, rows["b.mcap"].reason, report.dataset) == ("built", "", "updated")
