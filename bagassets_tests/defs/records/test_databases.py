"""Dagster's SQLite files: whatever a kill or a failing disk made of them, a build works or says what to do."""

import json
import os
import re
import shlex
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from uuid import uuid4

import dagster as dg
import pytest
from alembic.config import Config
from alembic.script import ScriptDirectory
from sqlalchemy import create_engine, text
from sqlalchemy.exc import DatabaseError

from bagassets.base.errors import StoreError
from bagassets.defs.records import databases
from bagassets.defs.records.databases import database_errors_explained, make_whole
from bagassets.defs.records.events import event_database
from bagassets.defs.records.instances import open_instance
from bagassets.defs.runs.exclusive import exclusive
from bagassets.forkserver.client import Client
from bagassets.recipe import load_recipe
from bagassets_tests.in_process import build, make_project, survey

BUSY_S = 10.0
DATABASES = ["history/runs.db", "history/runs/index.db", "schedules/schedules.db"]


@pytest.fixture
def home(tmp_path):
    """The folder of a Dagster instance that was never opened."""
    return write_home(tmp_path)


@pytest.fixture(scope="module")
def opened_home(tmp_path_factory):
    """The folder of one that was opened once."""
    folder = write_home(tmp_path_factory.mktemp("opened"))
    with open_instance(str(folder)):
        pass
    return folder


@pytest.fixture
def new_home(home, opened_home):
    """The folder of one in which nothing is recorded."""
    shutil.copytree(storage_of(opened_home), storage_of(home))
    return home


def write_home(folder):
    storage = folder / "state" / "dagster"
    ours = {
        "module": "bagassets.defs.sqlite_storage",
        "class": "ProjectStorage",
        "config": {"base_dir": str(storage)},
    }
    (folder / "dagster.yaml").write_text(json.dumps({"storage": {"custom": ours}}))
    return folder


def storage_of(home):
    return home / "state" / "dagster"


def works(home):
    """Whether partitions, events, runs and ticks can be written and read."""
    with open_instance(str(home)) as instance:
        instance.add_dynamic_partitions("bags", ["a"])
        instance.report_runless_asset_event(dg.AssetMaterialization("asset", partition="a"))
        event = instance.get_latest_materialization_event(dg.AssetKey("asset"))
        assert instance.get_runs() == []
        assert instance.schedule_storage.all_instigator_state() == []
        return instance.get_dynamic_partitions("bags") == ["a"] and event is not None


def marks(path):
    """Which migrations a database is marked with."""
    with closing(sqlite3.connect(path)) as connection:
        rows = connection.execute("SELECT name FROM secondary_indexes").fetchall()
        return sorted(name for (name,) in rows), connection.execute("PRAGMA journal_mode").fetchone()


def empty(path):
    path.write_bytes(b"")


def headless(path):
    """As when the process dies after the first table."""
    path.unlink()
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE secondary_indexes (id INTEGER PRIMARY KEY)")
        connection.commit()


def without_version(path):
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("DROP TABLE alembic_version")
        connection.commit()


def without_stamp(path):
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("DELETE FROM alembic_version")
        connection.commit()


def without_marks(path):
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("DELETE FROM secondary_indexes")
        connection.commit()


def without_one_table(path):
    name = {"runs": "kvs", "index": "dynamic_partitions", "schedules": "instigators"}[path.stem]
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"DROP TABLE {name}")
        connection.commit()


def in_its_log(path):
    """As when the process dies before anything of the log (WAL) got into the file."""
    path.unlink()
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("CREATE TABLE secondary_indexes (id INTEGER PRIMARY KEY)")
    connection.commit()
    copies = [(other, other.read_bytes()) for other in path.parent.glob(f"{path.name}*")]
    connection.close()
    for other, content in copies:
        other.write_bytes(content)


@pytest.mark.parametrize(
    "leave",
    [
        empty,
        headless,
        without_version,
        without_stamp,
        without_marks,
        without_one_table,
        in_its_log,
        Path.unlink,
    ],
)
@pytest.mark.parametrize("name", DATABASES)
def test_a_database_that_was_left_unfinished_is_made_anew(new_home, name, leave):
    path = storage_of(new_home) / name
    whole = marks(path)
    others = {other: (storage_of(new_home) / other).stat().st_ino for other in DATABASES if other != name}
    leave(path)
    assert works(new_home)
    assert marks(path) == whole
    assert {other: (storage_of(new_home) / other).stat().st_ino for other in others} == others, (
        "they were whole"
    )


@pytest.mark.parametrize("leave", [without_marks, without_version])
def test_a_database_that_holds_something_is_left_alone(home, leave):
    assert works(home)
    path = storage_of(home) / "history/runs/index.db"
    leave(path)
    inode = path.stat().st_ino
    with open_instance(str(home)) as instance:
        assert instance.get_dynamic_partitions("bags") == ["a"]
        assert instance.get_latest_materialization_event(dg.AssetKey("asset")) is not None
    assert path.stat().st_ino == inode


def test_databases_appear_whole_or_not_at_all(home):
    """What stands under the final name at any moment of their making is whole."""
    code = (
        f"from bagassets.defs.records.instances import open_instance\nwith open_instance({str(home)!r}): pass"
    )
    code += "\ninput()"  # it stays until it was looked at, however busy the machine is
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE)
    looked_at = set()
    while process.poll() is None:
        time.sleep(0.0002)
        for name in DATABASES:
            path = storage_of(home) / name
            if path.exists():
                looked_at.add(name)
                with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as connection:
                    assert connection.execute("SELECT count(*) FROM secondary_indexes").fetchone()[0] > 1
                    assert connection.execute("SELECT count(*) FROM alembic_version").fetchone()[0] == 1
        if len(looked_at) == len(DATABASES) and not process.stdin.closed:
            process.communicate(b"\n")
    assert process.returncode == 0
    assert looked_at == {*DATABASES}
    assert not list(storage_of(home).glob("new-*"))


def test_many_that_open_a_new_instance_at_once_agree(home):
    # Each a partition of its own: Dagster's way to add one fails if another process adds the same in between.
    code = (
        "import sys\nfrom bagassets.defs.records.instances import open_instance\n"
        f"with open_instance({str(home)!r}) as instance: instance.add_dynamic_partitions('p', sys.argv[1:])"
    )
    with ThreadPoolExecutor(3) as pool:
        ends = list(
            pool.map(
                lambda key: subprocess.run(
                    [sys.executable, "-c", code, key], capture_output=True, text=True, check=False
                ),
                "abc",
            )
        )
    assert [end.returncode for end in ends] == [0] * 3, [end.stderr for end in ends]
    with open_instance(str(home)) as instance:
        assert sorted(instance.get_dynamic_partitions("p")) == ["a", "b", "c"]


def test_what_a_killed_maker_left_is_removed(home):
    leftover = storage_of(home) / "new-feed"
    leftover.mkdir(parents=True)
    (leftover / "half").touch()
    assert works(home)
    assert not leftover.exists()


@pytest.mark.once
@pytest.mark.parametrize("name", DATABASES)
def test_garbage_is_named_with_the_way_out_which_works(tmp_path, monkeypatch, name):
    recipe = make_project(tmp_path)
    build(recipe, monkeypatch)
    path = tmp_path / ".bagassets/dagster" / name
    path.write_bytes(os.urandom(5000))
    with pytest.raises(StoreError, match="is damaged") as output:
        survey(recipe)
    assert str(output.value).startswith(f"{path}: ")
    aside = re.search(r"`(mv .*?)`", str(output.value))[1]
    subprocess.run(shlex.split(aside), check=True)
    report, _ = build(recipe, monkeypatch)
    assert report.counts()["hit" if name.endswith("index.db") else "fresh"] == 1
    assert not report.having("built", "failed")


def test_damage_within_a_file_is_named_when_it_is_met(home):
    with open_instance(str(home)) as instance:
        for number in range(200):
            instance.report_runless_asset_event(dg.AssetMaterialization("asset", partition=str(number)))
    path = storage_of(home) / "history/runs/index.db"
    content = bytearray(path.read_bytes())
    for page in range(4096 * 8, len(content), 4096):
        content[page : page + 100] = b"\xa5" * 100
    path.write_bytes(content)
    with pytest.raises(StoreError, match=re.escape(f"{path}: this database")):
        _read_everything(home)


def test_a_disk_that_fails_below_a_database_of_ours_is_a_sentence(home):
    # What SQLite says of it depends on where it was reading.
    for err in (sqlite3.DatabaseError("disk image is malformed"), sqlite3.OperationalError("disk I/O error")):
        said = "a database of this project cannot be used"
        with pytest.raises(StoreError, match=said), database_errors_explained(str(home)):
            raise err


def test_a_read_of_dagsters_database_that_failed_is_not_called_damage(home):
    works(home)
    failed = DatabaseError("SELECT 1", {}, sqlite3.DatabaseError("database disk image is malformed"))
    with (
        pytest.raises(StoreError, match="is whole when it is read again; check its disk"),
        database_errors_explained(str(home)),
    ):
        raise failed


def _read_everything(home):
    with open_instance(str(home)) as instance:
        instance.get_latest_materialization_event(dg.AssetKey("asset"))
        instance.event_log_storage.get_latest_storage_id_by_partition(
            dg.AssetKey("asset"), dg.DagsterEventType.ASSET_MATERIALIZATION
        )


def test_a_folder_that_cannot_be_made_is_reported(home):
    (home / "state").write_text("a file")
    with pytest.raises(StoreError, match="cannot be created"):
        make_whole(storage_of(home))


# --- kills, by the command ---------------------------------------------------------------


def processes_with(mark):
    """The processes that have a variable in their environment."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (entry / "environ").read_bytes():
                found.append(int(entry.name))
        except OSError:
            continue
    return found


def kill_all(mark):
    """Kill everything that has the mark, at once, as a power loss or a container's end does."""
    while pids := processes_with(mark):
        for number in (signal.SIGSTOP, signal.SIGKILL):  # stopped first, so that none tidies up after another
            for pid in pids:
                try:
                    os.kill(pid, number)
                except ProcessLookupError:
                    continue


MOMENTS = {
    "the server serves": lambda state: any(p.read_text() for p in (state / "forkserver").glob("*.lock")),
    "databases are begun": lambda state: any((state / "dagster").glob("**/*.db*")),
    "the index is there": lambda state: (state / "dagster/history/runs/index.db").exists(),
    "an artifact is there": lambda state: any((state / "store/artifacts").glob("*/*")),
}


@pytest.mark.once
@pytest.mark.parametrize(
    ("moment", "delay_s"),
    [
        pytest.param("the server serves", 0.0, marks=pytest.mark.long),
        ("databases are begun", 0.0),
        pytest.param("databases are begun", 0.05, marks=pytest.mark.long),
        pytest.param("the index is there", 0.01, marks=pytest.mark.long),
        pytest.param("an artifact is there", 0.0, marks=pytest.mark.long),
    ],
)
def test_a_build_killed_in_its_first_second_is_no_obstacle_to_the_next(tmp_path, moment, delay_s):
    recipe = make_project(tmp_path)
    state, mark = tmp_path / ".bagassets", f"BAGASSETS_TEST_MARK={uuid4()}"
    command = [sys.executable, "-m", "bagassets", "build", "--recipe", str(recipe), "--json"]
    surroundings = os.environ | dict([mark.split("=")])
    # While this process holds the recording, its run cannot end, however late the kill comes.
    with exclusive(load_recipe(recipe).state / "locks", "a.bag", keep_waiting=lambda _asked: True) as held:
        assert held
        process = subprocess.Popen(
            command, env=surroundings, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            while process.poll() is None and not MOMENTS[moment](state):
                time.sleep(0.0005)
            time.sleep(delay_s)
        finally:
            kill_all(mark)
            process.wait()
    assert process.returncode == -signal.SIGKILL, "the build was over before"
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    for client in Client.all_of(state):
        client.shutdown(grace_s=0.0)
    assert done.returncode == 0, done.stderr
    counts = json.loads(done.stdout)["counts"]
    assert counts["built"] + counts["hit"] == 1
    assert json.loads(done.stdout)["dataset"]["state"] == "updated"


@pytest.mark.long
def test_a_build_waits_while_another_program_writes(tmp_path, monkeypatch):
    """As a backup or an analysis might, for ten seconds."""
    recipe_file = make_project(tmp_path, ("a.bag", "b.bag"))
    with open_instance(str(tmp_path)) as instance:
        path = event_database(instance)
    with closing(sqlite3.connect(path, isolation_level=None, check_same_thread=False)) as other:
        other.execute("BEGIN IMMEDIATE")
        release = threading.Timer(BUSY_S, other.execute, ["COMMIT"])
        began = time.monotonic()
        release.start()
        report, _ = build(recipe_file, monkeypatch, jobs=1)
        assert time.monotonic() - began > BUSY_S
        release.join()
    assert {outcome.result for outcome in report.outcomes.values()} == {"built"}
    assert build(recipe_file, monkeypatch, jobs=1)[1] == []


def test_only_databases_that_are_being_created_are_written_without_waiting_for_the_disk(tmp_path):
    def synchronous(path):
        path.parent.mkdir(exist_ok=True)
        with create_engine(f"sqlite:///{path}").connect() as connection:
            return connection.execute(text("PRAGMA synchronous")).scalar()

    usual = synchronous(tmp_path / "other" / "a.db")
    with databases._unsynced(tmp_path / "new"):
        assert synchronous(tmp_path / "new" / "a.db") == 0
        assert synchronous(tmp_path / "other" / "a.db") == usual
    assert synchronous(tmp_path / "new" / "a.db") == usual != 0


def test_the_migrations_are_read_once_for_all_databases(tmp_path, monkeypatch):
    folders, usual = [], ScriptDirectory.__init__

    def made(folder, *args, **options):
        folders.append(folder)
        usual(folder, *args, **options)

    monkeypatch.setattr(ScriptDirectory, "__init__", made)
    make_whole(tmp_path)
    (folder,) = folders
    for name in DATABASES:
        with closing(sqlite3.connect(tmp_path / name)) as connection:
            assert connection.execute("SELECT * FROM alembic_version").fetchall() == [
                (folder.get_current_head(),)
            ]
    config = Config()
    config.set_main_option("script_location", folder.dir)
    assert ScriptDirectory.from_config(config) is not ScriptDirectory.from_config(config), (
        "but by others anew"
    )
