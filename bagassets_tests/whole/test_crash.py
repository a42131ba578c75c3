"""Simulated crashes and failures of the disk: a sample of what `make crash` tries in full."""

import errno
import gc
import os
import random
import re
import shutil
import socket
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from functools import partial
from itertools import product
from pathlib import Path

import dagster as dg
import numpy as np
import pytest
from sqlalchemy.exc import OperationalError

from bagassets.assets.pictures.canvas import read_image
from bagassets.base import files
from bagassets.base.errors import StoreError
from bagassets.formats import after_crash
from bagassets.formats.lerobot.recording_part import _Camera
from bagassets.recipe import load_recipe
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store
from bagassets_tests import crash_project
from bagassets_tests.crash_disk import (
    Disk,
    Recording,
    crashed,
    databases,
    lay_out,
    take,
    without_last_commit,
)
from bagassets_tests.crash_project import (
    SCENARIOS,
    STEPS,
    Crash,
    Histories,
    Project,
    crashes,
    fail,
    failures,
    recorded,
    replay,
)
from bagassets_tests.in_process import build, make_project, states, survey

pytestmark = pytest.mark.once

SEED = 3
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    crash_project.warm_up(tmp_path_factory.mktemp("warm"))
    yield Project(tmp_path_factory.mktemp("crash"))
    gc.unfreeze()


# Each is recorded by one worker: that takes as long as a test of it.
@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=pytest.mark.xdist_group(f"crash: {name}")) for name in SCENARIOS],
)
def scenario(request, project):
    found = recorded(project, request.param)
    crash_project.import_what_was_needed()
    return found


@pytest.mark.long
def test_after_a_crash_the_next_build_gives_what_a_build_from_nothing_gives(project, scenario):
    chosen = random.Random(SEED).sample(list(crashes(scenario, SEED)), 3)
    found = {crash: replay(project, scenario, crash) for crash in chosen}
    assert {crash: problem for crash, problem in found.items() if problem} == {}


@pytest.mark.long
def test_a_change_that_fails_ends_in_a_sentence_and_the_next_build_is_right(project, scenario):
    chosen = random.Random(SEED).sample(list(failures(scenario)), 2)
    found = {failure: fail(project, scenario, failure) for failure in chosen}
    assert {failure: problem for failure, problem in found.items() if problem} == {}


@pytest.mark.long
@pytest.mark.skipif(shutil.which("cc") is None, reason="the library that has reads fail is compiled")
@pytest.mark.parametrize("command", ["change", "LeRobot: change"])
def test_a_read_that_fails_ends_in_a_sentence_and_the_next_build_is_right(command):
    options = [
        "--only",
        "read",
        "--command",
        command,
        "--share",
        "0.007",
        "--seed",
        str(SEED),
        "--workers",
        "1",
    ]
    crash = [sys.executable, "-m", "benchmarks.crash", *options]
    done = subprocess.run(crash, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    tried, good = re.search(rf"reads that fail once: {command} \| (\d+) \| (\d+) ", done.stdout).groups()
    assert int(tried) == int(good) > 3


@pytest.mark.long
def test_a_build_that_does_not_look_for_torn_files_is_found_out(project, monkeypatch):
    scenario = recorded(project, "change")
    # Where the records of actions are torn as well, all is made again anyway.
    lost = [Crash(len(scenario.recording.changes), power=True, how="any", seed=seed) for seed in range(3)]
    assert [replay(project, scenario, crash) for crash in lost] == [""] * 3
    monkeypatch.setattr(after_crash, "repair_last_writes", lambda *_: [])
    assert any(replay(project, scenario, crash) for crash in lost)


@pytest.mark.long
def test_what_was_removed_from_a_dataset_does_not_come_back(project):
    scenario = recorded(project, "removal")
    changes = scenario.recording.changes
    removed = [
        number
        for number, change in enumerate(changes)
        if change.kind == "remove" and change.paths[0].endswith((".jpg", ".bin"))
    ]
    assert len(removed) == 6
    crashes = [Crash(len(changes), power=True, lost=(number,)) for number in removed[::2]]
    assert [replay(project, scenario, crash) for crash in crashes] == ["", "", ""]


@pytest.mark.long
def test_whatever_happened_before_the_dataset_is_that_of_a_project_built_from_nothing(tmp_path):
    histories = Histories(tmp_path)
    chosen = random.Random(SEED).sample(list(product(STEPS, repeat=3)), 5)
    found = {steps: histories.run(steps, SEED) for steps in chosen}
    assert {steps: problem for steps, problem in found.items() if problem} == {}


# --- the disk that forgets ------------------------------------------------------------------------


@pytest.fixture
def disk(tmp_path, monkeypatch):
    """A disk that records, and what it recorded."""
    for name in ("os", "shutil", "ioctl", "_rename"):
        monkeypatch.setattr(files, name, getattr(files, name))
    monkeypatch.setattr(files, "open", open, raising=False)
    (tmp_path / "top").mkdir()
    recording = Recording(take(tmp_path, ["top"]))
    recording.rename = files._rename
    Disk(tmp_path, recording=recording).install()
    return recording


def contents(node, path=""):
    if node.data is not None:
        return {path: node.data}
    return {
        name: data
        for key, one in node.entries.items()
        for name, data in contents(one, f"{path}/{key}").items()
    }


def change_much(top):
    files.make_folder(top / "a" / "b")
    files.write_atomically(top / "a" / "one", b"first")
    files.write_atomically(top / "a" / "one", b"second")
    files.create_atomically(top / "a" / "b" / "two", b"two")
    files.link(top / "a" / "one", top / "three")
    files.swap_in(top / "a" / "b", top / "c")
    files.make_folder(top / "a" / "d")
    with files.writer(top / "a" / "d" / "four") as stream:
        stream.write(b"fo")
        stream.write(b"ur")
    files.swap_in(top / "a" / "d", top / "c")
    files.copy(top / "three", top / "five")
    files.remove_all(top / "a" / "d")
    files.remove(top / "a" / "one")


def test_all_changes_together_give_what_is_there(disk, tmp_path):
    change_much(tmp_path / "top")
    disk.databases.append({})
    there = contents(take(tmp_path, ["top"]))
    assert there == {"/top/three": b"second", "/top/c/four": b"four", "/top/five": b"second"}
    assert contents(crashed(disk, len(disk.changes))) == there


@pytest.mark.parametrize(("how", "left"), [("empty", b""), ("zeros", bytes(4)), ("half", b"fo")])
def test_what_is_not_synced_may_be_lost(disk, tmp_path, how, left):
    change_much(tmp_path / "top")
    disk.databases.append({})
    assert contents(crashed(disk, len(disk.changes), how=how))["/top/c/four"] == left


@pytest.mark.parametrize("is_synced", [True, False])
def test_a_lost_change_takes_along_what_rests_on_it_unless_its_folder_was_synced(disk, tmp_path, is_synced):
    top = tmp_path / "top"
    files.write(top / "one", b"1")
    files.move(top / "one", top / "two")
    if is_synced:
        files.sync_folder(top)
    disk.databases.append({})
    left = contents(crashed(disk, len(disk.changes), lost=(0,)))
    assert left == ({"/top/two": b"1"} if is_synced else {})


def rows_in(folder):
    with sqlite3.connect(folder / "a.db") as connection:
        return [row for (row,) in connection.execute("SELECT x FROM t ORDER BY x")]


def test_the_last_commit_of_a_log_is_taken_away_and_no_other(tmp_path):
    with closing(sqlite3.connect(tmp_path / "a.db", isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("CREATE TABLE t (x)")
        for number in range(3):
            connection.execute("INSERT INTO t VALUES (?), (?)", (2 * number, 2 * number + 1))
        connection.execute("PRAGMA wal_checkpoint(RESTART)")  # the next frames are written over the first
        connection.execute("INSERT INTO t VALUES (6)")
        connection.execute("INSERT INTO t VALUES (7)")
        crashed_at = databases(tmp_path, "")
    for taken, rows in ((0, [*range(8)]), (1, [*range(7)]), (2, [*range(6)]), (3, [*range(6)])):
        folder = tmp_path / str(taken)
        folder.mkdir()
        left = dict(crashed_at)
        for _ in range(taken):
            left["a.db-wal"] = without_last_commit(left["a.db-wal"])
        for name, data in left.items():
            (folder / name).write_bytes(data)
        assert rows_in(folder) == rows


def test_files_that_others_wrote_are_recorded_when_their_folder_gets_its_name(disk, tmp_path):
    top = tmp_path / "top"
    files.make_folder(top / "new")
    (top / "new" / "video").write_bytes(b"by PyAV")
    files.move(top / "new", top / "there")
    disk.databases.append({})
    assert contents(crashed(disk, len(disk.changes))) == {"/top/there/video": b"by PyAV"}
    assert contents(crashed(disk, len(disk.changes), how="half")) == {"/top/there/video": b"by "}


def test_a_reflink_may_be_torn_as_a_copy_may(tmp_path, monkeypatch):
    for name in ("os", "shutil", "ioctl", "_rename"):
        monkeypatch.setattr(files, name, getattr(files, name))
    monkeypatch.setattr(files, "open", open, raising=False)
    (tmp_path / "top").mkdir()
    (tmp_path / "top" / "one").write_bytes(b"whole")
    recording = Recording(take(tmp_path, ["top"]))
    Disk(tmp_path, recording=recording, links="reflinks").install()
    assert files.clone(tmp_path / "top" / "one", tmp_path / "top" / "two")
    recording.databases.append({})
    left = contents(crashed(recording, len(recording.changes), how="half"))
    assert left == {"/top/one": b"whole", "/top/two": b"wh"}


def test_what_is_laid_out_has_its_links_and_seems_to_have_its_times(disk, tmp_path, monkeypatch):
    from bagassets.base import fingerprints

    monkeypatch.setattr(fingerprints, "signature_of", fingerprints.signature_of)
    top = tmp_path / "top"
    files.write_atomically(top / "one", b"1")
    files.link(top / "one", top / "two")
    before = fingerprints.signature(top / "one")
    lay_out(take(tmp_path, ["top"]), tmp_path)
    assert (top / "one").samefile(top / "two")
    assert fingerprints.signature(top / "one") == before
    (top / "one").write_bytes(b"1")
    assert fingerprints.signature(top / "one") != before


@pytest.mark.parametrize("error", [errno.EIO, errno.ENOSPC])
def test_each_change_fails_once(disk, tmp_path, error):
    rename, failed = Disk.exchange, []
    for number in range(1, 100):
        top = tmp_path / str(number)
        top.mkdir()
        failing = Disk(tmp_path, fails_at=number, error=error)
        files.os = files.shutil = failing
        files.open, files._rename = failing.open_writer, partial(rename, failing)
        failing._rename = disk.rename
        try:
            change_much(top)
        except OSError as err:
            failed.append(err.errno)
        if not failing.failed:
            break
    assert number > 20
    assert set(failed) == {error}


# --- the report -----------------------------------------------------------------------------------


@pytest.mark.parametrize("torn", [b"", bytes(100), b"<!doctype html><html><body>", None])
def test_a_report_that_a_power_loss_tore_or_that_is_gone_is_written_anew(built, monkeypatch, torn):
    report = built.parent / ".bagassets" / "report.html"
    whole = report.read_bytes()
    if torn is None:
        report.unlink()
    else:
        report.write_bytes(torn)
    monkeypatch.setattr(after_crash, "boot_id", lambda: "another one")
    build(built, monkeypatch)
    assert report.read_bytes() == whole


def test_what_a_killed_worker_had_begun_is_removed_by_the_next_build(built, monkeypatch):
    scratch = load_recipe(built).store_path / "tmp"
    with subprocess.Popen(["true"]) as dead:
        dead.wait()
    host = socket.gethostname()
    places = {
        "old": f"{host}-{dead.pid}-1",
        "new": f"{host}-{dead.pid}-2",
        "alive": f"{host}-{os.getpid()}-3",
    }
    for name, place in places.items():
        (scratch / place / "files").mkdir(parents=True)
        (scratch / place / "files" / "half").write_bytes(b"ha")
        if name != "new":  # whose process may be alive in another container
            for path in (scratch / place / "files" / "half", scratch / place / "files", scratch / place):
                os.utime(path, (0, time.time() - 301))
    build(built, monkeypatch)
    assert {one.name for one in scratch.iterdir()} == {places["new"], places["alive"]}
    for one in scratch.iterdir():
        shutil.rmtree(one)


def test_an_image_on_a_disk_that_fails_is_not_said_to_be_none(tmp_path):
    artifact = Artifact("0" * 64, tmp_path)
    (artifact.files / "a.jpg").mkdir(parents=True)  # reading it fails, which is no fault of what was recorded
    with pytest.raises(OSError, match=r"a\.jpg"):
        read_image(artifact.path("a.jpg"))
    with pytest.raises(OSError, match=r"a\.jpg"):
        _Camera("CAM", artifact, ["a.jpg"], np.zeros((1, 2), np.int32)).image(0)


def test_a_run_that_cannot_even_be_said_to_start_fails_and_the_build_ends(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path)
    instance = dg.DagsterInstance
    with monkeypatch.context() as failing:
        err = sqlite3.OperationalError("attempt to write a readonly database")
        sentence = "its run could not be launched: .*: Dagster's database cannot be used"

        def launch_run(*_):
            raise OperationalError("INSERT INTO event_logs", {}, err)

        failing.setattr(instance, "launch_run", launch_run)
        report, _ = build(recipe_file, failing)
    assert report.outcomes["a.bag"].result == "failed"
    assert re.search(sentence, report.outcomes["a.bag"].reason)
    report, _ = build(recipe_file, monkeypatch)
    assert report.outcomes["a.bag"].result == "built"


@pytest.mark.parametrize(("times", "state"), [(1, "fresh"), (2, "failed")])
def test_what_cannot_be_read_while_it_is_planned_is_asked_for_once_more(built, monkeypatch, times, state):
    (load_recipe(built).state / "freshness.sqlite").unlink()
    lookup, failed = Store.lookup, []

    def failing(store, action):
        if action.step == "nuscenes_tables" and len(failed) < times:
            failed.append(action)
            raise StoreError("the store cannot be read (Input/output error)")
        return lookup(store, action)

    monkeypatch.setattr(Store, "lookup", failing)
    assert states(survey(built), "a.bag")["nuscenes_tables"] == state


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    recipe_file = make_project(tmp_path_factory.mktemp("project"))
    with pytest.MonkeyPatch.context() as monkeypatch:
        build(recipe_file, monkeypatch)
    return recipe_file
