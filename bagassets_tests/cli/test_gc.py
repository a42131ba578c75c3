"""`bagassets gc`: what nobody needs goes, what anybody needs stays, whatever happens meanwhile."""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
import threading
import time
from pathlib import Path

import dagster as dg
import pytest
from click.testing import CliRunner

from bagassets.base import files
from bagassets.base.errors import DatasetError, StoreError
from bagassets.base.lock_files import LockFile
from bagassets.cli.main import root as command_line
from bagassets.defs.builds.garbage import locks_of
from bagassets.defs.records.naming import Naming
from bagassets.engine.run_action import run_action
from bagassets.formats.assembly import assemble
from bagassets.formats.dataset_lock import locked_artifacts
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.propose.project import dagster_home, write_project
from bagassets.recipe import load_recipe
from bagassets.recipe.model_datasets import NamedDataset
from bagassets.store import collect as module
from bagassets.store.action import Step
from bagassets.store.collect import collect, find_garbage
from bagassets.store.lease import action_lock, in_use, in_use_since_s
from bagassets.store.store import Store
from bagassets.store.users import User, forget_user, note_user, users_of
from bagassets_tests import in_process
from bagassets_tests.file_clock import next_tick
from bagassets_tests.nuscenes_checks import check_dataset
from bagassets_tests.store_check import check_store
from bagassets_tests.whole.test_end_to_end import build_all, build_of, make_project

pytestmark = pytest.mark.once

DAY_S = 86400.0


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "store")


def make(store, name, inputs=None, *, days_ago=30.0):
    """Make an artifact with an action, used for the last time some days ago."""
    action = Step(name, 1).action({}, inputs or {})
    outcome = run_action(store, action, lambda out: {"size": out.write("file", name.encode()).size})
    used_s = time.time() - days_ago * DAY_S
    os.utime(store.root / "actions" / action.digest[:2] / f"{action.digest}.json", (used_s, used_s))
    return outcome.artifact.digest


def garbage_of(store, roots=(), *, keep_days=7.0):
    now_s = time.time()
    return {entry.artifact for entry in find_garbage(store, set(roots), now_s - keep_days * DAY_S, now_s)}


def collect_all(store, roots=(), *, keep_days=7.0):
    now_s = time.time()
    return collect(store, find_garbage(store, set(roots), now_s - keep_days * DAY_S, now_s), now_s)


class TestWhatIsGarbage:
    def test_what_nothing_refers_to_goes_and_its_record_with_it(self, store):
        needed, other = make(store, "needed"), make(store, "other")
        assert garbage_of(store, [needed]) == {other}
        done = collect_all(store, [needed])
        assert [entry.artifact for entry in done.removed] == [other]
        assert (done.removed[0].size > 5, done.spared) == (True, 0)
        assert store.has(needed)
        assert not store.has(other)
        assert store.lookup(Step("other", 1).action({}, {})) is None
        assert len(list((store.root / "actions").glob("*/*"))) == 1
        assert list((store.root / "tmp").iterdir()) == []

    def test_what_a_needed_one_was_made_from_stays(self, store):
        first = make(store, "first")
        second = make(store, "second", {"upstream": first})
        third = make(store, "third", {"upstream": second, "topic:/x": "0" * 64})
        unrelated = make(store, "unrelated", {"upstream": first})
        assert garbage_of(store, [third]) == {unrelated}
        assert garbage_of(store, []) == {first, second, third, unrelated}

    def test_what_a_recent_build_made_stays_with_what_it_was_made_from(self, store):
        first = make(store, "first")
        make(store, "second", {"upstream": first}, days_ago=2)
        assert garbage_of(store) == set()
        assert len(garbage_of(store, keep_days=1)) == 2

    def test_a_hit_counts_as_use(self, store):
        digest = make(store, "old")
        store.lookup(Step("old", 1).action({}, {}))
        assert garbage_of(store) == {digest}  # a plan only looks
        store.use(Step("old", 1).action({}, {}))
        assert garbage_of(store) == set()

    def test_one_artifact_of_two_actions(self, store):
        old = make(store, "step")
        action = Step("step", 2).action({}, {})
        store.record(action, store.artifact(old), 0.1)  # new code, same bytes
        assert garbage_of(store) == set()

    def test_references_are_found_in_the_files_of_an_artifact_whose_action_is_not_on_record(self, store):
        image, pose = make(store, "image"), make(store, "pose")

        def write(out):
            out.write_json("channels.json", {"CAM": {"artifact": image}})
            out.write_json("files.json", [{"artifact": pose, "file": "a", "filename": "b"}])
            return {}

        action = Step("tables", 1).action({}, {})
        tables = run_action(store, action, write).artifact.digest
        store.forget(action.digest)
        assert garbage_of(store, [tables]) == set()

    def test_an_artifact_without_record_may_be_about_to_get_one(self, store):
        digest = make(store, "orphan")
        store.forget(Step("orphan", 1).action({}, {}).digest)
        assert garbage_of(store, keep_days=0) == set()
        old_s = time.time() - 2 * DAY_S
        os.utime(store.artifact_folder(digest), (old_s, old_s))
        assert garbage_of(store, keep_days=0) == {digest}

    def test_the_largest_come_first(self, store):
        for name in ("a", "bbb", "cc"):
            make(store, name)
        now_s = time.time()
        assert [g.step for g in find_garbage(store, set(), now_s - DAY_S, now_s)] == ["bbb", "cc", "a"]

    def test_an_empty_store(self, store):
        assert garbage_of(store) == set()
        assert collect_all(store).removed == []


class TestWhileBuildsRun:
    def test_what_is_used_after_it_was_found_is_spared(self, store):
        digest = make(store, "step")
        now_s = time.time()
        found = find_garbage(store, set(), now_s - DAY_S, now_s)
        assert store.use(Step("step", 1).action({}, {})) is not None
        done = collect(store, found, now_s)
        assert (done.removed, done.spared) == ([], 1)
        assert store.use(Step("step", 1).action({}, {})).artifact.digest == digest

    def test_what_is_made_again_after_it_was_found_is_spared(self, store):
        make(store, "step")
        now_s = time.time()
        found = find_garbage(store, set(), now_s - DAY_S, now_s)
        next_tick()
        pending = store.begin(Step("step", 2).action({}, {}))
        pending.out.write("file", b"step")
        outcome = pending.commit({"size": 4})
        assert outcome.artifact.digest == found[0].artifact
        collect(store, found, now_s)
        assert store.has(outcome.artifact.digest)
        assert outcome.artifact.path("file").read_bytes() == b"step"

    def test_a_record_that_vanishes_under_a_build_is_a_miss(self, store, monkeypatch):
        make(store, "step")
        action = Step("step", 1).action({}, {})
        real = os.utime

        def collect_first(path, *args, **options):
            monkeypatch.setattr(os, "utime", real)
            collect_all(store)
            real(path, *args, **options)

        monkeypatch.setattr(os, "utime", collect_first)
        assert store.use(action) is None

    def test_builds_and_collectors_at_once_never_leave_a_build_without_its_artifact(self, store):
        stop = threading.Event()
        problems = []

        def collector():
            while not stop.is_set():
                collect_all(store, keep_days=-1)  # takes whatever is not used this very moment

        def builder(number):
            for i in range(150):
                name = f"step{(i + number) % 5}"
                outcome = run_action(
                    store,
                    Step(name, 1).action({}, {}),
                    lambda out, n=name: {"s": out.write("f", n.encode()).size},
                )
                if store.lookup(Step(name, 1).action({}, {})) is None and outcome.cached:
                    continue  # collected after it was used: with no lease held, that is its right
                outcome.artifact.folder.exists()

        def run(task, *args):
            try:
                task(*args)
            except Exception as err:  # noqa: BLE001  (of any kind)
                problems.append(err)

        threads = [threading.Thread(target=run, args=(builder, i)) for i in range(3)]
        janitor = threading.Thread(target=run, args=(collector,))
        for thread in (janitor, *threads):
            thread.start()
        for thread in threads:
            thread.join()
        stop.set()
        janitor.join()
        assert problems == []
        collect_all(store, keep_days=-1)
        for i in range(5):  # whatever was left is whole and can be used or made again
            outcome = run_action(
                store,
                Step(f"step{i}", 1).action({}, {}),
                lambda out, i=i: {"s": out.write("f", f"step{i}".encode()).size},
            )
            assert outcome.artifact.path("f").read_bytes() == f"step{i}".encode()

    def test_a_lease_says_since_when_the_store_is_in_use(self, store):
        assert in_use_since_s(store.root) is None
        before_s = time.time()
        with in_use(store.root), in_use(store.root):
            since_s = in_use_since_s(store.root)
            assert before_s - 1 <= since_s <= time.time()
        assert in_use_since_s(store.root) is None
        assert list((store.root / "leases").iterdir()) == []

    def test_the_lease_of_a_killed_process_does_not_count(self, store):
        code = (
            "import sys, time; from pathlib import Path; from bagassets.store.lease import in_use\n"
            "with in_use(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
        )
        process = subprocess.Popen([sys.executable, "-c", code, str(store.root)], stdout=subprocess.PIPE)
        process.stdout.readline()
        assert in_use_since_s(store.root) is not None
        process.kill()
        process.wait()
        process.stdout.close()
        assert in_use_since_s(store.root) is None

    def test_a_build_holds_a_lease(self, tmp_path):
        recipe = make_project(tmp_path, mcap="a.mcap")
        build = build_of(recipe, "a.mcap").build()
        next(build)
        assert in_use_since_s(recipe.store_path) is not None
        list(build)
        assert in_use_since_s(recipe.store_path) is None


class TestLeftovers:
    def test_the_lock_of_a_killed_process_goes_and_those_of_live_ones_stay(self, store):
        script = (
            "import os, sys; from pathlib import Path; from bagassets.store.lease import action_lock\n"
            "with action_lock(Path(sys.argv[1]), 'dead'): os.kill(os.getpid(), 9)"
        )
        subprocess.run([sys.executable, "-c", script, str(store.root)], check=False)
        dead = store.root / "underway" / "dead.lock"
        assert dead.exists()
        with action_lock(store.root, "live"):
            assert collect(store, [], time.time()).leftovers == 1
            assert [path.name for path in dead.parent.iterdir()] == ["live.lock"]

    def test_a_lock_that_was_taken_over_meanwhile_stays(self, store, monkeypatch):
        dead = store.root / "underway" / "a.lock"
        dead.parent.mkdir(parents=True)
        dead.touch()
        try_lock = LockFile.try_lock

        def faster(lock):
            if lock.path == dead:  # another process removes it, and has the lock from here on
                dead.unlink()
                dead.touch()
            return try_lock(lock)

        monkeypatch.setattr(LockFile, "try_lock", faster)
        assert collect(store, [], time.time()).leftovers == 0
        assert dead.exists()

    def test_what_killed_processes_left_goes_and_what_live_ones_write_stays(self, store, monkeypatch):
        ours = store.make_temporary_folder()
        dead = ours.with_name(ours.name.replace(f"-{os.getpid()}-", "-999999999-"))
        foreign = ours.with_name("other-host-1-abc")
        for folder in (dead, foreign):
            folder.mkdir()
            (folder / "half").write_bytes(b"half")
        assert collect(store, [], time.time()).leftovers == 0  # perhaps a process of another container
        assert collect(store, [], time.time() + 3600).leftovers == 1
        assert (ours.exists(), dead.exists(), foreign.exists()) == (True, False, True)
        assert collect(store, [], time.time() + 2 * DAY_S).leftovers == 1
        assert (ours.exists(), foreign.exists()) == (True, False)

    def test_a_collector_that_is_killed_loses_nothing_that_is_needed(self, store, monkeypatch):
        needed = make(store, "needed")
        make(store, "other")

        def die(*args):
            raise KeyboardInterrupt

        monkeypatch.setattr(module, "_remove", die)
        with pytest.raises(KeyboardInterrupt):
            collect_all(store, [needed])
        monkeypatch.undo()
        assert store.lookup(Step("needed", 1).action({}, {})) is not None
        outcome = run_action(
            store, Step("other", 1).action({}, {}), lambda out: {"size": out.write("file", b"other").size}
        )
        assert outcome.artifact.path("file").read_bytes() == b"other"

    def test_records_are_gone_for_good_before_the_first_artifact_goes(self, store, monkeypatch):
        """A crash in between could leave a record that leads nowhere."""
        records = {make(store, name): None for name in ("one", "other")}
        calls = []
        for name in ("remove", "sync_folder", "move"):
            real = getattr(files, name)
            monkeypatch.setattr(
                files,
                name,
                lambda path, *to, name=name, real=real: (calls.append((name, path)), real(path, *to))[1],
            )
        assert len(collect_all(store).removed) == len(records)
        kinds = [(name, path.relative_to(store.root).parts[0]) for name, path in calls]
        last_synced = max(index for index, kind in enumerate(kinds) if kind == ("sync_folder", "actions"))
        assert kinds.count(("sync_folder", "actions")) == len(
            {path for name, path in calls if name == "sync_folder"}
        )
        assert all(kind[1] == "actions" for kind in kinds[:last_synced])
        assert kinds[last_synced + 1 :].count(("move", "artifacts")) == len(records)


class TestUsers:
    def test_projects_note_themselves_once(self, tmp_path):
        for _ in range(2):
            note_user(tmp_path, tmp_path / "a" / "recipe.yaml")
        note_user(tmp_path, tmp_path / "b" / "recipe.yaml")
        assert [user.recipe.parent.name for user in users_of(tmp_path)] == ["a", "b"]
        assert all(user.is_here for user in users_of(tmp_path))
        forget_user(tmp_path, users_of(tmp_path)[0])
        assert [user.recipe.parent.name for user in users_of(tmp_path)] == ["b"]

    @pytest.mark.parametrize("torn", [b"", bytes(100), b'{"host": "x'])
    def test_a_note_that_a_power_loss_tore_is_written_anew(self, tmp_path, torn):
        note_user(tmp_path, tmp_path / "a" / "recipe.yaml")
        (note,) = (tmp_path / "users").iterdir()
        note.write_bytes(torn)
        note_user(tmp_path, tmp_path / "a" / "recipe.yaml")
        assert [user.recipe.parent.name for user in users_of(tmp_path)] == ["a"]

    def test_an_unreadable_note_stops_the_collection(self, tmp_path):
        (tmp_path / "users").mkdir()
        (tmp_path / "users" / "x.json").write_bytes(b"{")
        with pytest.raises(StoreError, match="cannot be read"):
            users_of(tmp_path)

    def test_a_note_that_another_collection_removes_meanwhile_is_none(self, tmp_path, monkeypatch):
        for name in "ab":
            note_user(tmp_path, tmp_path / name / "recipe.yaml")
        listed = sorted((tmp_path / "users").iterdir())
        forget_user(tmp_path, users_of(tmp_path)[0])
        monkeypatch.setattr(Path, "glob", lambda *_: listed)
        assert [user.recipe.parent.name for user in users_of(tmp_path)] == ["b"]

    def test_users_of_other_machines(self):
        assert not User("/recipe.yaml", "elsewhere").is_here


class TestLocks:
    def test_locks_of_all_versions_and_those_kept_by_hand(self, tmp_path):
        recipe = make_project(tmp_path, mcap="a.mcap")
        made = build_all(recipe)["a.mcap"]["nuscenes_tables"].artifact.digest
        assemble(
            NUSCENES,
            [Part("a.mcap", "c", made)],
            recipe.nuscenes,
            Store(recipe.store_path),
            recipe.nuscenes.output,
        )
        kept = recipe.state / "kept-locks" / "release" / "1.json"
        kept.parent.mkdir(parents=True)
        kept.write_text('{"bags": [{"artifacts": ["abc", "def"]}]}')
        output = recipe.nuscenes.output
        review = NamedDataset(name="review", version="v1.0-review", output=output)
        recipe = recipe.model_copy(update={"datasets": (review,)})
        assert list(locks_of(recipe)) == [output / "v1.0-test" / "dataset.lock.json", kept]
        assert locked_artifacts(kept) == {"abc", "def"}
        assert made in locked_artifacts(next(locks_of(recipe)))

    def test_a_format_whose_package_cannot_be_used_stops_the_collection(self, tmp_path):
        recipe = make_project(tmp_path, mcap="a.mcap")
        raw = recipe.model_copy(update={"formats": {"broken": {"output": "dataset/broken"}}})
        with pytest.raises(DatasetError, match=r"formats\.broken .* nothing is collected"):
            list(locks_of(raw))

    @pytest.mark.parametrize("content", ["", "[]", "{}", '{"bags": 3}'])
    def test_what_is_no_lock_stops_the_collection(self, tmp_path, content):
        (tmp_path / "lock.json").write_text(content)
        with pytest.raises(DatasetError, match="expected the lock file of a dataset"):
            locked_artifacts(tmp_path / "lock.json")


def artifacts(store):
    """The digests of all artifacts in a store."""
    return {folder.name for folder in (store.root / "artifacts").glob("*/*")}


class TestCommand:
    """In a real Dagster instance."""

    @pytest.fixture(scope="class")
    @classmethod
    def template(cls, tmp_path_factory):
        folder = tmp_path_factory.mktemp("template")
        with pytest.MonkeyPatch.context() as monkeypatch:
            in_process.build(in_process.make_project(folder, drives=("a.bag", "c.mcap")), monkeypatch)
        return folder

    @pytest.fixture
    def recipe_file(self, template, tmp_path):
        """A copy of a built project."""
        folder = shutil.copytree(template, tmp_path / "one")
        write_project(folder, None)
        shutil.rmtree(folder / ".bagassets" / "store" / "users")
        self.age(folder / "recipe.yaml")
        return folder / "recipe.yaml"

    def age(self, recipe_file):
        """Make all that was done so far old."""
        then_s = time.time() - 30 * DAY_S
        for path in (load_recipe(recipe_file).store_path / "actions").glob("*/*.json"):
            os.utime(path, (then_s, then_s))

    def gc(self, recipe_file, *args):
        command = ["gc", "--recipe", str(recipe_file), "--json", *map(str, args)]
        result = CliRunner().invoke(command_line, command, standalone_mode=False)
        if result.exception is not None:
            raise result.exception
        return json.loads(result.stdout)

    def steps(self, found):
        return sorted(entry["step"] for entry in found["artifacts"])

    def test_what_is_current_and_in_the_dataset_stays(self, recipe_file):
        found = self.gc(recipe_file)
        assert self.steps(found) == []
        assert found["projects"] == [str(recipe_file)]
        assert len(found["locks"]) == 1

    def test_a_removed_recording_goes_when_the_dataset_dropped_it(self, recipe_file, monkeypatch):
        away = (recipe_file.parent / "bags" / "a.bag").rename(recipe_file.parent / "a.bag")
        assert self.gc(recipe_file, "-n")["artifacts"] == []  # nobody has noticed yet
        release = recipe_file.parent / "release.json"
        shutil.copy(next(locks_of(load_recipe(recipe_file))), release)
        in_process.build(recipe_file, monkeypatch)
        store = Store(load_recipe(recipe_file).store_path)
        found = self.gc(recipe_file, "--dry-run")
        # What both recordings have in common stays.
        own = ["frames_index", "inventory", "nuscenes_tables", "sweeps_index"]
        assert self.steps(found) == own
        assert found["bytes"] == sum(entry["size"] for entry in found["artifacts"]) > 0
        assert all(store.has(entry["artifact"]) for entry in found["artifacts"])
        locked = self.gc(recipe_file, "-n", "--lock", release)
        assert "nuscenes_tables" not in self.steps(locked)
        assert self.steps(self.gc(recipe_file)) == own
        assert not any(store.has(entry["artifact"]) for entry in found["artifacts"])
        assert list(check_store(store)) == []
        # The recording comes back: what was collected is made again.
        away.rename(recipe_file.parent / "bags" / "a.bag")
        _, ran = in_process.build(recipe_file, monkeypatch)
        assert [key for key, _ in ran] == ["a.bag", None]
        assert check_dataset(load_recipe(recipe_file).nuscenes.output, "v1.0-test") == []

    def test_another_project_on_the_store_keeps_its_own(self, recipe_file, tmp_path):
        store = Store(load_recipe(recipe_file).store_path)
        other_file = in_process.make_project(
            tmp_path / "two", drives=(), text=in_process.QUICK + f"store: {store.root}\n"
        )
        other = load_recipe(other_file)
        note_user(other.store_path, other_file)
        current, removed = make(store, "current"), make(store, "removed")
        with dg.DagsterInstance.from_config(str(dagster_home(other_file, other))) as instance:
            instance.add_dynamic_partitions(Naming(other.name).partitions, ["b.bag"])
            for key, digest in (("b.bag", current), ("gone.bag", removed)):
                tags = {"dagster/data_version": digest}
                instance.report_runless_asset_event(dg.AssetMaterialization("bag", partition=key, tags=tags))
                instance.report_runless_asset_event(
                    dg.AssetMaterialization("frames", partition=key, tags=tags)
                )
        found = self.gc(recipe_file)
        assert self.steps(found) == ["removed"]
        assert sorted(found["projects"]) == sorted([str(recipe_file), str(other_file)])
        shutil.rmtree(other_file.parent)
        with pytest.raises(StoreError, match="--forget"):
            self.gc(recipe_file)
        assert self.steps(self.gc(recipe_file, "--forget", other_file)) == ["current"]
        assert self.gc(recipe_file)["projects"] == [str(recipe_file)]

    def second_project(self, recipe_file, folder, more=""):
        """A project on the same store, which has noted itself there from another machine, and its state folder."""
        store, state = load_recipe(recipe_file).store_path, folder / "local" / "state"
        text = f"{in_process.QUICK}store: {store}\nstate: {state}\n{more}"
        other_file = in_process.make_project(folder / "two", drives=(), text=text)
        with pytest.MonkeyPatch.context() as monkeypatch:
            monkeypatch.setattr("socket.gethostname", lambda: "elsewhere")
            note_user(store, other_file)
        return other_file, state

    def test_a_project_whose_state_is_local_to_another_machine_stops_the_collection(
        self, recipe_file, tmp_path
    ):
        other_file, state = self.second_project(recipe_file, tmp_path)
        shutil.rmtree(state, ignore_errors=True)
        old = make(Store(load_recipe(recipe_file).store_path), "old")
        for more in (["-n"], []):
            with pytest.raises(StoreError) as refused:
                self.gc(recipe_file, *more)
            assert str(refused.value) == (
                f"{other_file}: this project on elsewhere uses the store too, but its state folder {state} cannot be reached "
                "from here, so nothing was removed; run gc where it can be reached or, if it no longer exists, pass "
                f"--forget {other_file}."
            )
            assert not state.parent.exists()  # nor is a new one made there
        assert [e["artifact"] for e in self.gc(recipe_file, "--forget", other_file)["artifacts"]] == [old]

    def test_a_database_of_another_user_is_not_even_opened(self, recipe_file, monkeypatch):
        """SQLite makes files beside a database to read it; if they are of another user, its owner cannot write any more."""
        database = load_recipe(recipe_file).state / "dagster" / "history" / "runs.db"
        access, opened = os.access, []
        monkeypatch.setattr(os, "access", lambda path, mode: path != database and access(path, mode))
        connect = sqlite3.connect
        monkeypatch.setattr(
            sqlite3, "connect", lambda *args, **more: opened.append(args) or connect(*args, **more)
        )
        with pytest.raises(
            StoreError, match=f"{database}: .* read-only for this user; run this as its owner"
        ):
            self.gc(recipe_file)
        assert opened == []

    def test_a_state_folder_that_is_not_mounted_makes_nothing_garbage(self, recipe_file, tmp_path):
        recipe = load_recipe(recipe_file)
        store = recipe.store_path.rename(tmp_path / "store")
        recipe_file.write_text(recipe_file.read_text() + f"store: {store}\n")
        note_user(store, recipe_file)
        assert self.gc(recipe_file)["projects"] == [str(recipe_file)]
        recipe.state.rename(tmp_path / "unmounted")
        with pytest.raises(StoreError, match=f"its state folder {recipe.state} cannot be reached"):
            self.gc(recipe_file)

    def test_a_project_of_another_machine_that_has_the_store_elsewhere_is_not_forgotten(
        self, recipe_file, tmp_path
    ):
        other_file, state = self.second_project(recipe_file, tmp_path)
        state.mkdir(parents=True, exist_ok=True)
        store = load_recipe(recipe_file).store_path
        elsewhere = tmp_path / "mnt" / "store"
        for note in (store / "users").iterdir():
            note.write_text(note.read_text().replace(str(store), str(elsewhere)))
        other_file.write_text(other_file.read_text().replace(str(store), str(elsewhere)))
        assert str(other_file) in self.gc(recipe_file)["projects"]
        other_file.write_text(other_file.read_text().replace(str(elsewhere), str(tmp_path / "new")))
        assert self.gc(recipe_file)["projects"] == [str(recipe_file)]

    def test_a_project_that_was_moved_with_its_store_is_not_missed(self, recipe_file, tmp_path):
        note_user(load_recipe(recipe_file).store_path, recipe_file)
        moved = (tmp_path / "one").rename(tmp_path / "moved")
        write_project(moved, None)
        found = self.gc(moved / "recipe.yaml")
        assert found["projects"] == [str(moved / "recipe.yaml")]
        assert found["artifacts"] == []

    def test_assets_of_users_keep_what_they_published(self, recipe_file):
        recipe = load_recipe(recipe_file)
        mine = make(Store(recipe.store_path), "mine")
        theirs = make(Store(recipe.store_path), "theirs")
        gone = make(Store(recipe.store_path), "gone")
        with dg.DagsterInstance.from_config(str(dagster_home(recipe_file, recipe))) as instance:
            for asset, partition, digest in (
                ("mine", None, mine),
                ("theirs", "a.bag", theirs),
                ("theirs", "x.bag", ""),
            ):
                instance.report_runless_asset_event(
                    dg.AssetMaterialization(asset, partition=partition, tags={"dagster/data_version": digest})
                )
        found = self.gc(recipe_file, "-n")
        assert [entry["artifact"] for entry in found["artifacts"]] == [gone]

    def test_what_a_running_build_may_use_stays(self, recipe_file):
        recipe = load_recipe(recipe_file)
        store = Store(recipe.store_path)
        with in_use(store.root):
            used = make(store, "used", days_ago=0)
            assert self.gc(recipe_file, "--keep-days", 0)["artifacts"] == []
            assert store.has(used)
        assert [e["artifact"] for e in self.gc(recipe_file, "--keep-days", 0)["artifacts"]] == [used]

    def test_a_bag_root_that_is_not_mounted_makes_nothing_garbage(self, recipe_file):
        """Roots are Dagster's records and locks; a plan would find no recording there."""
        store = Store(load_recipe(recipe_file).store_path)
        shutil.rmtree(
            load_recipe(recipe_file).nuscenes.output
        )  # nor does the lock of the dataset protect any artifact
        before = artifacts(store)
        (recipe_file.parent / "bags").rename(recipe_file.parent / "unmounted")
        assert self.gc(recipe_file, "--keep-days", 0)["artifacts"] == []
        assert before
        assert artifacts(store) == before

    def test_a_wiped_instance_leaves_what_the_dataset_has(self, recipe_file):
        recipe = load_recipe(recipe_file)
        with dg.DagsterInstance.from_config(str(dagster_home(recipe_file, recipe))) as instance:
            instance.wipe_assets(list(instance.get_asset_keys()))
        assert set(self.steps(self.gc(recipe_file, "-n"))) <= {
            "inventory",
            "calibration",
            "frames_index",
            "sweeps_index",
        }

    def test_it_says_what_it_did(self, recipe_file):
        make(Store(load_recipe(recipe_file).store_path), "old")
        result = CliRunner().invoke(command_line, ["gc", "--recipe", str(recipe_file)])
        assert "1 artifact, 136 B, removed; kept what 1 project and 1 dataset lock refer to." in result.output
        assert "last used 30.0 days ago" in result.output
