"""Files that others on the machine could hold, or that would hold us."""

import fcntl
import os
import socket
import stat
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from bagassets.bags.discover import discover, find_one
from bagassets.cli.summary import summary_rows
from bagassets.defs import driver
from bagassets.defs.exclusive import exclusive
from bagassets.engine.build_report import BagOutcome, BuildReport
from bagassets.engine.plan_model import Plan
from bagassets.errors import RecipeError, RecordingError
from bagassets.lock_files import open_lock_file
from bagassets.nuscenes.guard import GUARD, guarded
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Bags
from bagassets.store.lease import in_use, in_use_since_s
from bagassets.store.store import Store
from bagassets.store.underway import underway
from bagassets_tests.in_process import build, make_project
from bagassets_tests.small_drive import RECIPE, write_drive

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
        os.close(open_lock_file(tmp_path / name, shared=shared))
        assert mode_of(tmp_path / name) == mode
    old = tmp_path / "own"
    old.chmod(0o644)  # as an earlier version made it
    os.close(open_lock_file(old))
    assert mode_of(old) == 0o600
    os.umask(0o002)
    os.close(open_lock_file(tmp_path / "group", shared=True))
    assert mode_of(tmp_path / "group") == 0o660, "who shares a store shares its locks"


def test_no_lock_of_a_build_can_be_held_by_others(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path)
    assert build(recipe_file, monkeypatch)[0].succeeded
    recipe = load_recipe(recipe_file)
    with ExitStack() as stack:
        stack.enter_context(underway(recipe.store_path, "a" * 64))
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


def test_a_lock_that_another_holds_is_waited_for(tmp_path):
    descriptor = open_lock_file(tmp_path / "x")
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    code = (
        "import fcntl, sys; from pathlib import Path; from bagassets.lock_files import open_lock_file\n"
        "fcntl.flock(open_lock_file(Path(sys.argv[1])), fcntl.LOCK_EX | fcntl.LOCK_NB)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "x")]
    assert b"BlockingIOError" in subprocess.run(command, capture_output=True, check=False).stderr
    os.close(descriptor)
    assert subprocess.run(command, check=False).returncode == 0


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
    begun = time.monotonic()
    with pytest.raises(RecipeError, match=r"recipe\.yaml:\d+: .*aliases stand for more than \d+ values"):
        load_recipe(path)
    assert time.monotonic() - begun < SECONDS


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
        found = discover(Bags(root=tmp_path))
        assert list(found.found) == ["a.bag"]
        assert found.excluded == [("x.mcap", f"this is {what}, no file")]

    @pytest.mark.parametrize("name", ["metadata.yaml", "part_1.mcap"])
    def test_so_is_a_bag_folder_with_one(self, tmp_path, make, what, name):
        folder = tmp_path / "bags" / "drive"
        folder.mkdir(parents=True)
        for other in ("metadata.yaml", "part_0.mcap"):
            (folder / other).touch()
        (folder / name).unlink(missing_ok=True)
        make(folder / name)
        found = discover(Bags(root=tmp_path / "bags"))
        assert (found.found, found.excluded) == ({}, [("drive", f"{name} in it is {what}, no file")])
        with pytest.raises(RecordingError, match=f"{name} in it is {what}"):
            find_one(folder)


# --- a recording that goes ---------------------------------------------------------------


def test_a_recording_removed_before_the_summary_has_a_row(tmp_path):
    report = BuildReport(
        Plan({}, {}, ()), outcomes={"a.bag": BagOutcome("built"), "b.bag": BagOutcome("failed", "Why.")}
    )
    rows = summary_rows(report, Store(tmp_path))
    assert [(row.recording, row.result, row.reason) for row in rows] == [
        ("a.bag", "built", "it was removed meanwhile, so the dataset is without it"),
        ("b.bag", "failed", "Why."),
    ]
    assert rows[0].keyframes is None


def test_a_recording_removed_during_a_build_costs_nothing_but_itself(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path, ["a.bag", "b.mcap"])
    original = driver.build

    def build_and_remove(file, options, _on_event):
        def remove(event):
            if (event.kind, event.key) == ("done", "a.bag"):
                (tmp_path / "bags" / "a.bag").unlink()

        return original(file, options, remove)

    monkeypatch.setattr(driver, "build", build_and_remove)
    report, _ = build(recipe_file, monkeypatch)
    rows = {row.recording: row for row in summary_rows(report, load_recipe(recipe_file).store_path)}
    assert rows["a.bag"].reason == "it was removed meanwhile, so the dataset is without it"
    assert (rows["b.mcap"].result, rows["b.mcap"].reason, report.dataset) == ("built", "", "updated")
