"""A build with nothing to do is decided without Dagster, and never wrongly."""

import os
import shutil
import sqlite3
import subprocess
import sys
import time

import dagster as dg
import pytest

from bagassets.base import fingerprints
from bagassets.base.cache import NAME, Cache, Changes
from bagassets.base.fingerprints import PlanNeeded
from bagassets.defs.records.events import event_database
from bagassets.defs.records.instances import open_instance
from bagassets.engine.freshness import artifacts, decide
from bagassets.engine.freshness.artifacts import are_unchanged, folders_of, groups_to_check, note_of
from bagassets.engine.freshness.decide import nothing_to_do
from bagassets.engine.freshness.plan_cache import CachedPlan, PlanCache, RecordingFingerprint
from bagassets.recipe import load_recipe
from bagassets_tests.file_clock import next_tick
from bagassets_tests.in_process import build, make_project, states, survey

pytestmark = pytest.mark.once

KEY = "a.bag"


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return make_project(tmp_path_factory.mktemp("project"), [KEY], duration_s=2.0)


@pytest.fixture
def fresh(project, monkeypatch):
    """A recipe file whose dataset is up to date, and a snapshot that says so."""
    report, _ = build(project, monkeypatch)
    assert report.succeeded, report.as_json()
    assert is_quick(project), "a build leaves a snapshot"
    return project


def is_quick(recipe_file):
    return nothing_to_do(["build", "--recipe", str(recipe_file)]) is not None


def recording(recipe_file):
    return recipe_file.parent / "bags" / KEY


def a_file_of(recipe_file, name):
    """Return the file `name` of an artifact that is current."""
    root = load_recipe(recipe_file).store_path / "artifacts"
    folders = [root / digest[:2] / digest for digest in survey(recipe_file).plan.bags[KEY].artifacts]
    return next(f / "files" / name for f in folders if (f / "files" / name).is_file())


# --- what it costs, and what it says ------------------------------------------------------


def test_it_says_what_is_fresh_and_where_the_dataset_is(fresh):
    lines = nothing_to_do(["build", "--recipe", str(fresh)])
    assert lines[0] == "1 fresh: nothing to do"
    assert str(load_recipe(fresh).nuscenes.output) in lines[1]


def test_the_command_imports_nothing_that_takes_time(fresh):
    code = (
        "import sys; sys.argv = ['bagassets', 'build']; from bagassets.__main__ import main; status = main(); "
        "heavy = {'dagster', 'click', 'yaml', 'pydantic', 'numpy', 'rich', 'asyncio'} & set(sys.modules); "
        "sys.exit(f'imported {heavy}' if heavy else status)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=fresh.parent, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "nothing to do" in done.stdout


def test_handing_a_build_over_imports_nothing_that_takes_time():
    code = (
        "import sys; import bagassets.engine.freshness.decide, bagassets.cli.early; "
        "heavy = {'click', 'yaml', 'dataclasses', 'inspect', 'subprocess', 'tempfile', 'uuid'} & set(sys.modules); "
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ["status"],
        [],
        ["build", "--retry-failed"],
        ["build", "--json"],
        ["build", "--help"],
        ["build", "--jobs", "0x1"],
        ["build", "--recipe"],
        ["build", "extra"],
    ],
)
def test_everything_but_a_plain_build_takes_the_full_path(fresh, monkeypatch, arguments):
    monkeypatch.chdir(fresh.parent)
    assert nothing_to_do(["build"]) is not None
    assert nothing_to_do(["build", "--jobs", "2", f"--recipe={fresh}"]) is not None
    assert nothing_to_do(["build", "-j", "2", "--recipe", str(fresh)]) is not None
    assert nothing_to_do(arguments) is None


# --- adversaries --------------------------------------------------------------------------


def test_content_edited_in_place_with_size_and_time_put_back_is_built(fresh, monkeypatch):
    path = recording(fresh)
    before = path.stat()
    with path.open("r+b") as stream:
        stream.seek(before.st_size // 2)
        byte = stream.read(1)
        stream.seek(-1, os.SEEK_CUR)
        stream.write(bytes([byte[0] ^ 1]))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert (path.stat().st_size, path.stat().st_mtime_ns) == (before.st_size, before.st_mtime_ns)
    assert not is_quick(fresh)
    bag = survey(fresh).plan.bags[KEY].assets["bag"]
    assert bag.state == "stale"
    assert "touched" in bag.reason
    _, runs = build(fresh, monkeypatch)
    assert runs, "the full path sees it too"
    with path.open("r+b") as stream:
        stream.seek(before.st_size // 2)
        stream.write(byte)


def test_a_file_that_was_only_touched_is_recorded_again_and_nothing_runs(fresh, monkeypatch):
    recording(fresh).touch()
    assert not is_quick(fresh)
    report, _ = build(fresh, monkeypatch)
    assert report.outcomes[KEY].result == "hit"
    assert is_quick(fresh)


def test_a_recording_that_comes_or_goes_is_seen(fresh):
    other = recording(fresh).with_name("b.bag")
    shutil.copy2(recording(fresh), other)
    assert not is_quick(fresh)
    other.unlink()
    assert is_quick(fresh), "all is as it was"
    hidden = recording(fresh).rename(recording(fresh).with_name(".a.bag"))
    assert not is_quick(fresh)
    hidden.rename(recording(fresh))
    assert not is_quick(fresh), "renaming changes ctime: a needless plan, and no harm"


def test_a_recipe_edited_and_reverted_is_as_before_unless_it_was_built_between(fresh, monkeypatch):
    text = fresh.read_text()
    fresh.write_text(text.replace("version: v1.0-test", "version: v1.0-other"))
    assert not is_quick(fresh)
    fresh.write_text(text)
    assert is_quick(fresh)
    fresh.write_text(text.replace("topic: /cam/image_raw", "topic: /cam/image_raw, quality: 40"))
    build(fresh, monkeypatch)
    fresh.write_text(text)
    assert not is_quick(fresh), "the dataset is that of the other recipe"
    report, _ = build(fresh, monkeypatch)
    assert report.outcomes[KEY].result == "hit"
    assert report.dataset == "updated"


@pytest.mark.parametrize("name", ["index.parquet", "scene.json"])
def test_a_file_that_is_missing_from_the_store_is_made_again(fresh, monkeypatch, name):
    path = a_file_of(fresh, name)
    path.unlink()
    assert not is_quick(fresh)
    report, _ = build(fresh, monkeypatch)
    assert report.outcomes[KEY].result == "built"
    assert path.is_file()


def test_many_artifacts_and_the_datasets_are_looked_at_beside_the_rest(fresh, monkeypatch):
    monkeypatch.setattr(decide, "_WORTH_A_FORK", 0)
    assert is_quick(fresh)
    recipe = load_recipe(fresh)
    for file in (
        a_file_of(fresh, "channels.json"),
        recipe.nuscenes.output / recipe.nuscenes.version / "sample.json",
    ):
        file.rename(file.with_name("aside"))
        assert not is_quick(fresh)
        file.with_name("aside").rename(file)
        build(fresh, monkeypatch)
        assert is_quick(fresh)
    os.utime(recording(fresh))
    assert not is_quick(fresh)


def test_an_artifact_that_is_missing_from_the_store_is_made_again(fresh, monkeypatch):
    artifact = a_file_of(fresh, "channels.json").parents[1]
    shutil.rmtree(artifact)
    assert not is_quick(fresh)
    report, _ = build(fresh, monkeypatch)
    assert report.outcomes[KEY].result == "built"
    assert artifact.is_dir()


def test_a_file_that_is_missing_from_the_dataset_is_seen(fresh):
    recipe = load_recipe(fresh)
    table = recipe.nuscenes.output / recipe.nuscenes.version / "sample.json"
    aside = table.rename(fresh.parent / "aside.json")
    assert not is_quick(fresh)
    aside.rename(table)
    image = next(recipe.nuscenes.output.glob("samples/CAM_FRONT/*"))
    image.unlink()
    assert not is_quick(fresh)
    shutil.rmtree(recipe.nuscenes.output)


def test_a_map_that_is_missing_is_seen(tmp_path, monkeypatch):
    from bagassets.formats.report_data import map_path
    from bagassets_tests.small_drive import RECIPE

    recipe_file = make_project(tmp_path, [KEY], text=RECIPE, duration_s=1.0)
    report, _ = build(recipe_file, monkeypatch)
    assert report.succeeded
    assert is_quick(recipe_file)
    map_path(load_recipe(recipe_file)).unlink()
    assert not is_quick(recipe_file)
    report, runs = build(recipe_file, monkeypatch)
    assert report.dataset == "updated"
    assert [key for key, _ in runs] == [None]


def instance_of(recipe_file):
    return open_instance(str(recipe_file.parent))


def test_an_asset_wiped_in_the_ui_is_seen(fresh, monkeypatch):
    with instance_of(fresh) as instance:
        instance.wipe_assets([dg.AssetKey("frames")])
    assert not is_quick(fresh)
    assert states(survey(fresh), KEY)["frames"] == "record-only"
    report, _ = build(fresh, monkeypatch)
    assert report.outcomes[KEY].result == "hit"


def test_a_run_deleted_in_the_ui_is_seen_even_if_ids_come_again(fresh, monkeypatch):
    with instance_of(fresh) as instance:
        # Whatever tests ran here before: the run that the current record is from.
        instance.delete_run(instance.get_latest_materialization_event(dg.AssetKey("frames")).run_id)
        assert not is_quick(fresh)
        # SQLite gives the ids away again; as many other events hide the deletion from whoever counts.
        with sqlite3.connect(event_database(instance)) as connection:
            newest = connection.execute("SELECT max(id) FROM event_logs").fetchone()[0]
        for _ in range(40):
            instance.report_runless_asset_event(dg.AssetMaterialization("unrelated"))
        with sqlite3.connect(event_database(instance)) as connection:
            assert connection.execute("SELECT max(id) FROM event_logs").fetchone()[0] > newest
    assert not is_quick(fresh)
    assert survey(fresh).todo.keys() == {KEY}


def test_a_partition_deleted_in_the_ui_is_seen(fresh, monkeypatch):
    recipe = load_recipe(fresh)
    with instance_of(fresh) as instance:
        instance.delete_dynamic_partition(f"{recipe.name}_recordings", KEY)
    assert not is_quick(fresh)
    assert set(states(survey(fresh), KEY).values()) <= {"missing", "record-only"}
    report, _ = build(fresh, monkeypatch)
    assert report.outcomes[KEY].result == "hit"


def test_a_fresh_database_is_seen(fresh, monkeypatch):
    shutil.rmtree(load_recipe(fresh).state / "dagster")
    (load_recipe(fresh).state / "dagster").mkdir()
    assert not is_quick(fresh)
    report, _ = build(fresh, monkeypatch)
    assert report.outcomes[KEY].result == "hit", "a wiped instance over a full store decodes nothing"


def test_a_package_that_was_upgraded_is_seen(fresh, monkeypatch, tmp_path):
    folder = tmp_path / "site"
    (folder / "numpy-2.0.dist-info").mkdir(parents=True)
    monkeypatch.setattr(fingerprints, "site_folders", lambda: (str(folder),))
    assert not is_quick(fresh)


def test_code_that_was_edited_is_seen(fresh, monkeypatch):
    lines = fingerprints._source_lines
    monkeypatch.setattr(fingerprints, "_source_lines", lambda root: [*lines(root), "assets/frames.py 1 2"])
    assert not is_quick(fresh)


def test_a_clock_that_was_stepped_back_hides_nothing(fresh):
    path = recording(fresh)
    data = path.read_bytes()
    path.write_bytes(data)
    past = time.time_ns() - 10**18
    os.utime(path, ns=(past, past))
    assert not is_quick(fresh)


def test_a_database_named_by_a_variable_leaves_no_snapshot(fresh, monkeypatch):
    config = fresh.with_name("dagster.yaml")
    text = config.read_text()
    try:
        config.write_text(text + "\n# env: SOMEWHERE\n")
        assert not is_quick(fresh), "another configuration may mean another database"
        build(fresh, monkeypatch)
        assert not is_quick(fresh)
    finally:
        config.write_text(text)


@pytest.mark.parametrize("damage", [b"", b"{}\n", b"no database " * 1000, None])
def test_a_damaged_cache_file_needs_a_plan_and_is_replaced(fresh, monkeypatch, damage):
    path = load_recipe(fresh).state / NAME
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if damage is None else damage)
    assert not is_quick(fresh)
    path.write_bytes(whole)
    assert is_quick(fresh)
    path.write_bytes(b"" if damage is None else damage)
    assert build(fresh, monkeypatch)[0].succeeded
    assert is_quick(fresh)


@pytest.mark.parametrize("kind", ["settled", "artifacts", "last", "published"])
def test_what_is_missing_or_torn_in_the_cache_file_needs_a_plan(fresh, kind):
    cache = Cache(load_recipe(fresh).state)
    path = load_recipe(fresh).state / NAME
    whole = path.read_bytes()
    ((key, content),) = cache.all(kind).items()
    changes = Changes()
    changes.drop(kind, key)
    cache.write(changes)
    assert not is_quick(fresh)
    path.write_bytes(whole)
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE entries SET content = ? WHERE kind = ?", (b"0" * len(content), kind))
    connection.close()
    assert not is_quick(fresh)
    path.write_bytes(whole)
    assert is_quick(fresh)


def test_a_failed_recording_takes_the_full_path(project, monkeypatch):
    broken = recording(project).with_name("broken.bag")
    broken.write_bytes(b"#ROSBAG V2.0\n" + b"x" * 100)
    report, _ = build(project, monkeypatch)
    assert report.outcomes["broken.bag"].result == "failed"
    again, runs = build(project, monkeypatch)
    assert again.outcomes["broken.bag"].result == "failed"
    assert runs == [], "it is not tried again by itself"
    assert not is_quick(project)
    _, runs = build(project, monkeypatch, retry_failed=True)
    assert "broken.bag" in {key for key, _ in runs}
    broken.unlink()


# --- fingerprints -------------------------------------------------------------------------


def test_a_look_at_a_tree_follows_links_and_stops_at_loops(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "a.bag").write_bytes(b"1")
    root = tmp_path / "root"
    root.mkdir()
    (root / "link").symlink_to(tmp_path / "real")
    (root / "loop").symlink_to(root)
    (root / "broken").symlink_to(tmp_path / "nothing")
    before = fingerprints.tree_fingerprint(str(root))
    assert fingerprints.tree_fingerprint(str(root)) == before
    (tmp_path / "real" / "a.bag").write_bytes(b"22")
    assert fingerprints.tree_fingerprint(str(root)) != before
    with pytest.raises(PlanNeeded):
        fingerprints.tree_fingerprint(str(tmp_path / "nothing"))


@pytest.mark.parametrize("content", [None, b"", b"no database at all" * 100])
def test_another_schema_needs_a_plan(tmp_path, content):
    path = tmp_path / "index.db"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(PlanNeeded):
        fingerprints.records_fingerprint(str(path), "x")


def artifact(root, digest):
    folder = root / digest[:2] / digest
    (folder / "files").mkdir(parents=True)
    (folder / "manifest.json").write_text("{}")
    (folder / "files" / "x").write_text("x")
    return folder


def noted(root, names):
    """Note artifacts, and return a function that tells whether they are unchanged."""
    folders, note = folders_of(str(root)), note_of(str(root), names)
    return lambda: are_unchanged(str(root), note, groups_to_check(folders, folders_of(str(root)), len(names)))


def test_of_a_large_store_only_changed_groups_and_some_others_are_looked_at(tmp_path, monkeypatch):
    names = sorted(f"{group:02x}{number:062x}" for group in range(8) for number in range(4))
    folders = {name: artifact(tmp_path, name) for name in names}
    is_unchanged = noted(tmp_path, names)
    assert is_unchanged()
    monkeypatch.setattr(artifacts, "MOST_CHECKED", 4)
    monkeypatch.setattr(artifacts.random, "random", lambda: 1.0)
    next_tick()
    (folders[names[0]] / "files" / "x").unlink()
    assert is_unchanged(), "inside an artifact: not seen at once"
    monkeypatch.setattr(artifacts.random, "random", lambda: 0.0)
    assert not is_unchanged()
    monkeypatch.setattr(artifacts.random, "random", lambda: 1.0)
    shutil.rmtree(folders[names[9]])
    assert not is_unchanged(), "an artifact that went is seen at once"
    artifact(tmp_path, "07" + "f" * 62)
    artifact(tmp_path, names[9])


def test_a_run_between_two_looks_checks_what_changed_alone(tmp_path):
    root, names = tmp_path / "artifacts", ["aa" + "0" * 62, "bb" + "0" * 62]
    folders = [artifact(root, name) for name in names]
    cache = PlanCache(tmp_path, root)
    cache.load()
    plan = CachedPlan(RecordingFingerprint("", 1, ""), note_of(str(root), names), b"")
    cache.save({"a.bag": plan}, ())

    def holds(checked):
        looking = PlanCache(tmp_path, root, checked)
        return looking.holds(looking.load()["a.bag"].made)

    next_tick()
    (folders[0] / "files" / "x").unlink()
    assert {one: holds(one) for one in ("all", "sample", "changed", "fewest")} == {
        "all": False,
        "sample": False,
        "changed": False,
        "fewest": True,
    }
    artifact(root, "bb" + "1" * 62)
    assert holds("fewest"), "nothing is wrong in this folder"
    artifact(root, "aa" + "1" * 62)
    assert not holds("fewest")


def test_a_stranger_in_a_shared_store_needs_no_plan(tmp_path, monkeypatch):
    names = ["aa" + "0" * 62, "bb" + "0" * 62]
    for name in names:
        artifact(tmp_path, name)
    is_unchanged = noted(tmp_path, names)
    monkeypatch.setattr(artifacts, "MOST_CHECKED", 0)
    artifact(tmp_path, "aa" + "1" * 62)
    assert is_unchanged()
