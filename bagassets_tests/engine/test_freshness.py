"""What freshness rests on: the cache file, fingerprints, the cache of plans, and where the state folder is."""

import os
import shutil
import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from bagassets.base import fingerprints
from bagassets.base.cache import NAME, Cache, Changes
from bagassets.base.fingerprints import PlanNeeded, project_fingerprint, recipe_fingerprint, signature
from bagassets.engine.freshness import decide
from bagassets.engine.freshness.artifacts import note_of
from bagassets.engine.freshness.decide import BuildLog, state_folder
from bagassets.engine.freshness.plan_cache import (
    CachedPlan,
    PlanCache,
    RecordingFingerprint,
    recording_fingerprint,
)
from bagassets.engine.plan import AssetState, BagPlan, KeptPlan
from bagassets.engine.run_action import run_action
from bagassets.store.action import Action
from bagassets.store.store import Store
from bagassets_tests.file_clock import next_tick

pytestmark = pytest.mark.once


def changes(*put, drop=()):
    made = Changes()
    for kind, key, content in put:
        made.put(kind, key, content)
    for kind, key in drop:
        made.drop(kind, key)
    return made


ONE, OTHER = ("letter", "a", b"content"), ("letter", "ünder/b", b"\0" * 5)


class TestCache:
    def test_what_is_kept_comes_back(self, tmp_path):
        cache = Cache(tmp_path / "state")
        assert cache.write(changes(ONE, OTHER, ("number", "a", b"1")))
        assert cache.all("letter") == {"a": b"content", "ünder/b": b"\0" * 5}
        assert cache.get("letter", "ünder/b", "a") == [b"\0" * 5, b"content"]
        assert cache.get("letter") == []
        assert cache.all("nothing") == {}

    def test_it_is_its_owners_alone(self, tmp_path):
        Cache(tmp_path).write(changes(ONE))
        assert (tmp_path / NAME).stat().st_mode & 0o077 == 0, "the URL of a database may hold a password"

    def test_the_newest_counts_and_what_is_dropped_is_gone(self, tmp_path):
        cache = Cache(tmp_path)
        cache.write(changes(ONE, OTHER))
        cache.write(changes(("letter", "a", b"newer"), drop=[("letter", "ünder/b"), ("letter", "never")]))
        assert cache.all("letter") == {"a": b"newer"}
        below = Changes()
        below.drop_below("letter", "x")
        below.put("letter", "x/1", b"new")
        cache.write(changes(*[("letter", key, b"") for key in ("x", "x/1", "x/2", "x0", "xy/1")]))
        cache.write(below)
        assert cache.all("letter") == {"a": b"newer", "x": b"", "x/1": b"new", "x0": b"", "xy/1": b""}

    def test_with_nothing_to_change_nothing_is_written(self, tmp_path):
        assert Cache(tmp_path / "state").write(Changes())
        assert not (tmp_path / "state").exists()

    def test_what_is_not_there_needs_a_plan(self, tmp_path):
        with pytest.raises(PlanNeeded):
            Cache(tmp_path / "state").all("letter")
        Cache(tmp_path).write(changes(ONE))
        for keys in (("b",), ("a", "b"), ("b", "a")):
            with pytest.raises(PlanNeeded, match="there is no letter"):
                Cache(tmp_path).get("letter", *keys)

    @pytest.mark.parametrize(
        "damage",
        [
            b"",
            b"short",
            b"no database at all, but long enough to be one " * 300,
            "another format",
            "half",
            "of a later SQLite",
            "without its table",
            "with a name that is no text",
        ],
    )
    def test_a_damaged_one_raises_and_is_replaced(self, tmp_path, damage):
        cache, path = Cache(tmp_path), tmp_path / NAME
        cache.write(changes(*[("letter", str(number), bytes(1000)) for number in range(20)]))
        if damage == "another format":
            with sqlite3.connect(path) as connection:
                connection.execute("PRAGMA user_version = 99")
            connection.close()
        elif damage == "half":
            path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        elif damage == "of a later SQLite":
            path.write_bytes(path.read_bytes()[:18] + b"\x09\x09" + path.read_bytes()[20:])
        elif damage == "without its table":
            with sqlite3.connect(path) as connection:
                connection.execute("DROP TABLE entries")
            connection.close()
        elif damage == "with a name that is no text":
            data = path.read_bytes().replace(b"CREATE TABLE", b"CREATE TALBE")
            path.write_bytes(data.replace(b"entries", b"ent\x91ies"))
        else:
            path.write_bytes(damage)
        with pytest.raises(PlanNeeded):
            cache.all("letter")
        assert cache.write(changes(*[("letter", str(number), b"new") for number in range(20)]))
        assert set(cache.all("letter").values()) == {b"new"}

    def test_a_torn_file_is_removed_and_an_intact_one_kept(self, tmp_path):
        cache = Cache(tmp_path)
        cache.remove_if_damaged()
        cache.write(changes(*[("letter", str(number), bytes(1000)) for number in range(200)]))
        whole = Path(cache.path).read_bytes()
        cache.remove_if_damaged()
        assert len(cache.all("letter")) == 200
        for start in range(0, len(whole), 4096):
            torn = bytearray(whole)
            torn[start : start + 4096] = bytes(4096)
            Path(cache.path).write_bytes(torn)
            cache.remove_if_damaged()
            assert not Path(cache.path).exists(), f"page {start // 4096}"

    @pytest.mark.parametrize("column", ["content", "digest", "key", "kind"])
    def test_an_entry_that_a_power_loss_tore_is_as_good_as_none(self, tmp_path, column):
        cache = Cache(tmp_path)
        cache.write(changes(ONE, OTHER))
        torn = {"content": b"c0ntent", "digest": b"", "key": "c", "kind": "number"}[column]
        with sqlite3.connect(cache.path) as connection:
            connection.execute(f"UPDATE entries SET {column} = ? WHERE key = 'a'", (torn,))
        connection.close()
        assert cache.all("letter") == {OTHER[1]: OTHER[2]}
        assert cache.all("number") == {}
        with pytest.raises(PlanNeeded):
            cache.get("letter", "a")

    def test_a_folder_that_cannot_be_written_is_no_error(self, tmp_path):
        (tmp_path / "file").write_bytes(b"")
        assert not Cache(tmp_path / "file" / "state").write(changes(ONE))

    def test_a_full_disk_keeps_what_was_known(self, tmp_path, monkeypatch):
        cache = Cache(tmp_path)
        cache.write(changes(ONE))

        def full(_self, connection):
            connection.execute("DELETE FROM entries")
            connection.execute("PRAGMA max_page_count = 1")
            with pytest.raises(sqlite3.OperationalError, match="disk is full") as caught:
                connection.execute("INSERT INTO entries VALUES ('letter', 'b', zeroblob(1000000), '')")
            raise caught.value

        monkeypatch.setattr(Changes, "apply", full)
        assert not cache.write(changes(OTHER))
        assert cache.all("letter") == {"a": b"content"}


class TestMarkOfARecording:
    @pytest.fixture
    def folder(self, tmp_path):
        (tmp_path / "a.bag").write_bytes(b"content")
        (tmp_path / "a.json").write_bytes(b"labels")
        return tmp_path

    def of(self, folder, project="p", relative="a.bag", beside=(), records=None):
        records = {"inventory": 3} if records is None else records
        return recording_fingerprint(project, relative, (folder / "a.bag",), beside, records)

    def test_all_that_counts_is_in_it(self, folder):
        labels = (folder / "a.json",)
        found = {
            self.of(folder), self.of(folder, "q"), self.of(folder, relative="b.bag"), self.of(folder, beside=labels),
            self.of(folder, records={"inventory": 4}), self.of(folder, records={"frames": 3}), self.of(folder, records={}),
            self.of(folder, records={"inventory": 3, "bag": 3}),
        }  # fmt: skip
        assert len(found) == 8
        before = self.of(folder, beside=labels)
        (folder / "a.json").write_bytes(b"other labels")
        assert self.of(folder, beside=labels) != before
        assert self.of(folder) in found

    def test_any_change_of_a_file_changes_it(self, folder):
        path, found = folder / "a.bag", [self.of(folder)]
        stat = path.stat()
        path.write_bytes(b"longer content")
        found.append(self.of(folder))
        next_tick()
        path.write_bytes(b"c0ntent")
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        found.append(self.of(folder))  # size and time as before, another time of change
        os.utime(path, ns=(1, 2))
        found.append(self.of(folder))
        path.rename(folder / "b.bag")
        found.append(self.of(folder))
        assert len(set(found)) == 5
        assert self.of(folder) == found[-1]


class TestMarkOfTheProject:
    @pytest.fixture
    def recipe(self, tmp_path):
        (tmp_path / "definitions" / "pkg" / "msg").mkdir(parents=True)
        (tmp_path / "recipe.yaml").write_text("name: x\n")
        return tmp_path / "recipe.yaml"

    def of(self, recipe, code="c"):
        folder = recipe.parent
        return project_fingerprint(
            code, recipe_fingerprint(recipe), [str(folder / "car.urdf")], [str(folder / "definitions")]
        )

    def test_all_that_counts_is_in_it(self, recipe):
        found = [self.of(recipe), self.of(recipe, "other")]
        for path, text in (
            ("recipe.yaml", "name: y\n"),
            (".env", "A=1\n"),
            ("car.urdf", "<robot/>"),
            ("definitions/pkg/msg/New.msg", "int8 x"),
            ("definitions/pkg/msg/.hidden.msg", "int8 x"),
        ):
            (recipe.parent / path).write_text(text)
            found.append(self.of(recipe))
        (recipe.parent / "definitions/pkg/msg/New.msg").unlink()
        found.append(self.of(recipe))
        assert len(set(found)) == len(found)
        recipe.write_text("name: y\n")
        assert self.of(recipe) == found[-1], "a recipe that was only written again"

    def test_folders_that_cannot_be_read_need_a_plan(self, recipe, tmp_path):
        with pytest.raises(PlanNeeded):
            project_fingerprint("c", str(recipe), [], [str(tmp_path / "nowhere")])


class TestMarkOfCode:
    def test_all_that_counts_is_in_it(self, tmp_path, monkeypatch):
        package, site = tmp_path / "package", tmp_path / "site"
        for folder in (package / "inner", site / "numpy-2.0.dist-info"):
            folder.mkdir(parents=True)
        (package / "one.py").write_text("1")
        monkeypatch.setattr(fingerprints, "site_folders", lambda: (str(site),))
        monkeypatch.delenv("PYTHONPATH", raising=False)
        found = [fingerprints.code_fingerprint((str(package),))]

        def note():
            found.append(fingerprints.code_fingerprint((str(package),)))

        (package / "inner" / "two.so").write_text("2")
        note()
        (package / "one.py").write_text("11")
        note()
        os.utime(package / "one.py", (1, 1))
        note()
        (site / "numpy-2.0.dist-info").rename(site / "numpy-2.1.dist-info")
        note()
        os.utime(site / "numpy-2.1.dist-info", (1, 1))
        note()
        (tmp_path / "beside" / "plugin-1.egg-info").mkdir(parents=True)
        monkeypatch.setenv("PYTHONPATH", str(tmp_path / "beside"))
        note()
        monkeypatch.setattr(sys, "version", "4.0")
        note()
        assert len(set(found)) == len(found)
        for path in ("inner/notes.txt", ".hidden.py", "__pycache__/one.pyc"):
            (package / path).parent.mkdir(exist_ok=True)
            (package / path).write_text("")
        assert fingerprints.code_fingerprint((str(package),)) == found[-1]

    def test_what_a_process_decides_with_is_the_code_that_it_began_with(self, monkeypatch):
        fingerprints.loaded_code_fingerprint.cache_clear()
        before = fingerprints.loaded_code_fingerprint()
        assert before == fingerprints.code_fingerprint()
        monkeypatch.setattr(fingerprints, "_source_lines", lambda _root: ["edited"])
        assert fingerprints.code_fingerprint() != before
        assert fingerprints.loaded_code_fingerprint() == before
        fingerprints.loaded_code_fingerprint.cache_clear()

    def test_a_single_module_is_looked_at_too(self, tmp_path):
        module = tmp_path / "module.py"
        module.write_text("1")
        before = fingerprints.code_fingerprint((str(module),))
        module.write_text("22")
        assert fingerprints.code_fingerprint((str(module),)) != before


def test_a_place_is_marked_by_where_it_leads(tmp_path):
    for name in ("disk1", "disk2"):
        (tmp_path / name).mkdir()
    link, place = tmp_path / "data", [str(tmp_path / "data" / "bags")]
    link.symlink_to(tmp_path / "disk1")
    before = fingerprints.paths_fingerprint(place)
    link.unlink()
    link.symlink_to(tmp_path / "disk2")
    assert fingerprints.paths_fingerprint(place) != before


class TestArtifacts:
    @pytest.fixture
    def artifact(self, tmp_path):
        def write(out):
            out.write("one", b"1")
            out.write("two", b"2")
            return {}

        return run_action(Store(tmp_path / "store"), Action("a", 1), write).artifact

    def of(self, artifact):
        return note_of(str(artifact.folder.parents[1]), [artifact.digest])

    def test_files_that_come_or_go_are_seen(self, artifact):
        before = self.of(artifact)
        assert self.of(artifact) == before
        next_tick()
        artifact.path("one").unlink()
        without = self.of(artifact)
        next_tick()
        artifact.path("one").write_bytes(b"1")
        assert len({before, without, self.of(artifact)}) == 3

    def test_another_manifest_is_seen(self, artifact):
        before = self.of(artifact)
        next_tick()
        (artifact.folder / "manifest.json").write_bytes(b"{}")
        assert self.of(artifact) != before
        (artifact.folder / "manifest.json").unlink()
        with pytest.raises(PlanNeeded):
            self.of(artifact)


def plan_of(key, **states):
    assets = {"bag": AssetState("fresh", "as it was", "b" * 64)}
    assets |= {
        name: AssetState(state, f"why {name}", "ab" * 32 if state == "fresh" else None)
        for name, state in states.items()
    }
    recorded, channels = {"inventory": "i" * 64}, ("c1" * 32, "c2" * 32)
    return BagPlan(key, assets, "ros2", recorded, channels, frozenset({"preview"}), "car")


FINGERPRINT = RecordingFingerprint("files", 7, "rest")
PLAN = plan_of("a.bag", inventory="fresh", frames="skipped")


def test_a_recording_rests_on_its_assets_and_the_channels():
    assert PLAN.artifacts == ("ab" * 32, "c1" * 32, "c2" * 32)


class TestPlanCache:
    @pytest.fixture
    def store(self, tmp_path):
        """A store with the artifacts of `PLAN`."""
        for digest in PLAN.artifacts:
            folder = tmp_path / "artifacts" / digest[:2] / digest
            (folder / "files").mkdir(parents=True)
            (folder / "manifest.json").write_text("{}")
        self.root = tmp_path / "artifacts"
        return self.root

    def save(self, cache, *plans, gone=()):
        made = {plan.key: note_of(str(self.root), plan.artifacts) for plan in plans}
        cache.save({one.key: CachedPlan(FINGERPRINT, made[one.key], one.as_row()) for one in plans}, gone)

    def test_what_was_saved_is_loaded(self, tmp_path, store):
        other = replace(PLAN, key="ünder/b.bag", format="mcap")
        cache = PlanCache(tmp_path / "state", store)
        self.save(cache, PLAN, other)
        found = PlanCache(tmp_path / "state", store).load()
        assert {key: BagPlan.from_row(key, entry.row) for key, entry in found.items()} == {
            "a.bag": PLAN,
            "ünder/b.bag": other,
        }
        assert {entry.fingerprint for entry in found.values()} == {FINGERPRINT}
        assert cache.holds(found["a.bag"].made)
        self.save(cache, gone=["a.bag"])
        assert cache.load().keys() == {"ünder/b.bag"}

    def test_it_does_not_hold_once_an_artifact_changed(self, tmp_path, store):
        cache = PlanCache(tmp_path / "state", store)
        self.save(cache, PLAN)
        (entry,) = cache.load().values()
        next_tick()
        path = store / "c1" / ("c1" * 32) / "files" / "new"
        path.write_text("")
        assert not cache.holds(entry.made)
        path.parents[1].joinpath("manifest.json").unlink()
        assert not cache.holds(entry.made)

    def test_what_is_stored_or_dropped_leaves_the_others_of_its_group_alone(self, tmp_path, store):
        cache = PlanCache(tmp_path / "state", store)
        keys = [f"{number}.bag" for number in range(600)]  # two in each group, or more
        self.save(cache, *(replace(PLAN, key=key) for key in keys))
        cache = PlanCache(tmp_path / "state", store)  # knows nothing of them
        self.save(cache, replace(PLAN, key="7.bag", rig="another"), gone=["8.bag", "never there.bag"])
        found = cache.load()
        assert found.keys() == {*keys} - {"8.bag"}
        plans = {key: BagPlan.from_row(key, entry.row) for key, entry in found.items()}
        assert plans.pop("7.bag") == replace(PLAN, key="7.bag", rig="another")
        assert plans == {key: replace(PLAN, key=key) for key in plans}
        assert cache.load(["7.bag", "8.bag"]) == {"7.bag": found["7.bag"]}

    def test_of_many_artifacts_it_looks_where_the_store_changed(self, tmp_path, store, monkeypatch):
        monkeypatch.setattr("bagassets.engine.freshness.artifacts.MOST_CHECKED", 0)
        cache = PlanCache(tmp_path / "state", store)
        cache.load()
        self.save(cache, PLAN)

        def holds(checked):
            cache = PlanCache(tmp_path / "state", store, checked)
            return cache.holds(cache.load()[PLAN.key].made)

        assert holds("sample")
        next_tick()
        (store / "c1" / ("c2" * 32)).mkdir()  # another one in the folder of one of them
        assert holds("sample")
        file = store / "ab" / ("ab" * 32) / "files" / "new"
        file.write_text("")
        assert holds("sample"), "within an artifact nobody looks, where there are so many"
        assert not holds("all")
        monkeypatch.setattr("bagassets.engine.freshness.artifacts.MOST_CHECKED", 10**6)
        assert not holds("sample"), "but where there are few"
        monkeypatch.setattr("bagassets.engine.freshness.artifacts.MOST_CHECKED", 0)
        (store / "ab" / ("c2" * 32)).mkdir()
        assert not holds("sample"), "and where others came beside it"
        shutil.rmtree(store / "c2" / ("c2" * 32))
        assert not holds("sample"), "or it went"

    @pytest.mark.parametrize(("checked", "is_seen"), [("all", True), ("sample", True), ("changed", False)])
    def test_a_sample_of_many_artifacts_is_checked_where_nobody_has_just_done_so(
        self, tmp_path, store, monkeypatch, checked, is_seen
    ):
        monkeypatch.setattr("bagassets.engine.freshness.artifacts.MOST_CHECKED", 1)
        monkeypatch.setattr("random.random", lambda: 0.0)
        cache = PlanCache(tmp_path / "state", store)
        cache.load()
        self.save(cache, PLAN)
        next_tick()
        (store / "ab" / ("ab" * 32) / "files" / "new").write_text("")
        cache = PlanCache(tmp_path / "state", store, checked)
        assert cache.holds(cache.load()[PLAN.key].made) != is_seen

    def test_a_kept_plan_is_the_plan(self):
        whole = replace(
            PLAN, recorded={"bag": "b" * 64}, findings=(("warn", "check", "problem"),), damage="half"
        )
        for plan in (PLAN, whole):
            kept = KeptPlan(
                plan.key,
                plan.as_row(),
                b"".join(bytes.fromhex(one) + bytes(8) for one in plan.artifacts),
            )
            assert kept == plan
            assert plan == kept
            assert kept != replace(plan, rig="another")
            told = ("settled", "skipped", "failed", "unusable", "can_be_retried", "artifacts", "format", "channels",
                    "optional", "rig", "touched", "outdated", "findings", "damage", "recorded")  # fmt: skip
            assert [getattr(kept, name) for name in told] == [getattr(plan, name) for name in told]
            assert list(kept.names) == list(plan.names)
            for asset in ("bag", "inventory", "frames"):
                assert kept.version(asset) == plan.version(asset) == plan.recorded.get(asset)
            assert kept.to_run(retry_failed=True) == plan.to_run(retry_failed=True) == ()

    def test_nothing_is_loaded_where_there_is_no_file(self, tmp_path, store):
        assert PlanCache(tmp_path / "state", store).load() == {}


class TestStateFolder:
    def recipe(self, folder, text):
        folder.mkdir(exist_ok=True)
        (folder / "recipe.yaml").write_text(text)
        return str(folder / "recipe.yaml")

    @pytest.mark.parametrize(
        ("text", "state"),
        [
            ("name: x\n", ".bagassets"),
            ("state: elsewhere\n", "elsewhere"),
            ("state: 'two words'  # why\n", "two words"),
            ('"state": >-\n  folded\n  text\n', "folded text"),
            ("{name: x, state: /there/state}\n", "/there/state"),
            ("note: |\n  state: no\nstate: 2024-05-01\n", "2024-05-01"),
            ("rigs: [{state: no}]\n", ".bagassets"),
            ("rigs: {state: no}\nstate: yes\n", "yes"),
            ("a: b\nc: [d, {e: f}]\nstate: g\nstate: h\n", "g"),
        ],
    )
    def test_it_is_what_the_recipe_says(self, tmp_path, text, state):
        assert state_folder(self.recipe(tmp_path, text)) == os.path.join(tmp_path, state)  # noqa: PTH118

    @pytest.mark.parametrize(
        "text",
        [
            "- a\n",
            "state: [a]\n",
            "state: {a: b}\n",
            "a: [\n",
            "\0",
            "",
            'state: "a\\0b"\n',
            "? [d]\n: e\n",
            "a: &b c\nstate: *b\n",
            f"a: {'[' * 40_000}\n",
        ],
    )
    def test_what_the_recipe_does_not_say_needs_a_plan(self, tmp_path, text):
        with pytest.raises(PlanNeeded):
            state_folder(self.recipe(tmp_path, text))

    def test_one_that_was_built_there_is_known_without_reading_yaml(self, tmp_path, monkeypatch):
        recipe = self.recipe(tmp_path, "name: x\n")
        BuildLog(tmp_path / ".bagassets").begin("process", recipe)
        monkeypatch.setattr(decide, "_named_state", pytest.fail)
        assert state_folder(recipe) == str(tmp_path / ".bagassets")

    def test_another_text_is_read(self, tmp_path):
        recipe = self.recipe(tmp_path, "name: x\n")
        BuildLog(tmp_path / ".bagassets").begin("process", recipe)
        Path(recipe).write_text("state: elsewhere\n")
        assert state_folder(recipe) == str(tmp_path / "elsewhere")


class TestBuildLog:
    def test_one_at_work_is_unfinished_until_its_end(self, tmp_path):
        builds = BuildLog(tmp_path)
        with pytest.raises(PlanNeeded):
            builds.last_boot_id()
        builds.begin("one", tmp_path / "recipe.yaml")
        builds.begin("two", tmp_path / "recipe.yaml")
        assert set(builds.unfinished()) == {"one", "two"}
        assert builds.last_boot_id() == fingerprints.boot_id()
        builds.end("one")
        assert builds.unfinished() == ["two"]
        builds.begin("three", tmp_path / "recipe.yaml", over=["two"])
        builds.end("three")
        assert builds.unfinished() == []


def test_nothing_but_the_standard_library_is_imported():
    code = (
        "import sys; before = set(sys.modules); import bagassets.engine.freshness.decide, bagassets.engine.freshness.plan_cache; "
        "print(*{name.partition('.')[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names) - {'_sysconfigdata'}); "
        "print(*sorted(name for name in sys.modules if name.startswith('bagassets.') and 'freshness' not in name))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [
        "bagassets",
        "bagassets.base",
        "bagassets.base.cache",
        "bagassets.base.fingerprints",
        "bagassets.engine",
    ]


def test_a_file_that_is_not_there_has_no_signature(tmp_path):
    assert signature(tmp_path / "nothing") == []
    (tmp_path / "a").write_bytes(b"123")
    stat = (tmp_path / "a").stat()
    assert signature(tmp_path / "a") == [3, stat.st_mtime_ns, stat.st_ino, stat.st_ctime_ns]
