"""A recording of which only the time changed is read, and recorded without a run."""

import os
import threading

import dagster as dg
import pytest
from dagster._core.definitions.data_version import CachingStaleStatusResolver, StaleStatus
from dagster._core.loader import LoadingContextForTest

from bagassets.base.errors import ChangedWhileReadError, SelectionError
from bagassets.defs.builds import pending_work
from bagassets.defs.graph.location import build_definitions
from bagassets.defs.records import instance_plan, touched
from bagassets.defs.records.events import DATA_VERSION, MADE_ALONG, STAT, Records
from bagassets.engine import planner
from bagassets.engine.first_pass import first_pass
from bagassets.engine.freshness.plan_cache import PlanCache
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe import load_recipe
from bagassets.recordings import digest
from bagassets.recordings.digest_record import DigestIndex
from bagassets.recordings.discover import discover
from bagassets_tests.in_process import build, make_project, states, survey
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

KEYS = ("a.bag", "b.mcap", "c")


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return make_project(tmp_path_factory.mktemp("project"), KEYS)


@pytest.fixture
def built(project, monkeypatch):
    """A recipe file whose dataset is up to date, but for what a test before may have left."""
    build(project, monkeypatch)
    assert build(project, monkeypatch)[1] == []
    return project


def files_of(recipe_file, key):
    path = recipe_file.parent / "bags" / key
    return sorted(path.iterdir()) if path.is_dir() else [path]


def touch(recipe_file, key):
    for path in files_of(recipe_file, key):
        path.touch()


def change(recipe_file, key):
    """Change a byte in the middle of the largest file."""
    path = max(files_of(recipe_file, key), key=lambda path: path.stat().st_size)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def records(recipe_file, key):
    """Return the records of `bag`, latest first."""
    with pending_work.open_project(recipe_file) as workspace:
        instance = workspace.instance
        wanted = dg.AssetRecordsFilter(asset_key=dg.AssetKey("bag"), asset_partitions=[key])
        return instance.fetch_materializations(wanted, limit=100).records


def test_touched_recordings_have_no_run(built, monkeypatch):
    for key in KEYS:
        touch(built, key)
    report, runs = build(built, monkeypatch)
    assert runs == []
    assert {key: outcome.result for key, outcome in report.outcomes.items()} == dict.fromkeys(KEYS, "hit")
    assert all(set(states(survey(built), key).values()) == {"fresh"} for key in KEYS)
    report, runs = build(built, monkeypatch)
    assert runs == []
    assert {outcome.result for outcome in report.outcomes.values()} == {"fresh"}


@pytest.mark.parametrize("key", KEYS)
def test_it_is_recorded_as_a_run_would_record_it(built, monkeypatch, key):
    touch(built, key)
    build(built, monkeypatch)
    without_run, *before = (record.asset_materialization for record in records(built, key))
    by_run = next(one for one in before if "dagster/code_version" in one.tags and one.description is None)
    own = {"dagster/data_version", "dagster/code_version"}
    assert {name: without_run.tags[name] for name in own} == {name: by_run.tags[name] for name in own}
    # How much was hashed, the times of the files, and that the inventory was made in the same pass, are what differs.
    differs = {"hashed_bytes", STAT, MADE_ALONG}
    assert without_run.metadata.keys() == by_run.metadata.keys() - {MADE_ALONG}
    same = by_run.metadata.keys() - differs
    assert {name: without_run.metadata[name] for name in same} == {
        name: by_run.metadata[name] for name in same
    }


def test_dagster_calls_nothing_stale(built, monkeypatch):
    touch(built, "a.bag")
    build(built, monkeypatch)
    graph = build_definitions(built).resolve_asset_graph()
    with pending_work.open_project(built) as workspace:
        instance = workspace.instance
        resolver = CachingStaleStatusResolver(instance, graph, LoadingContextForTest(instance))
        found = {
            (key.to_user_string(), part): resolver.get_status(key, part)
            for key in graph.materializable_asset_keys
            for part in (["a.bag", "b.mcap"] if graph.get(key).is_partitioned else [None])
        }
    assert {which for which, status in found.items() if status != StaleStatus.FRESH} == set()


def test_one_whose_content_changed_has_a_run_and_the_others_have_none(built, monkeypatch):
    for key in KEYS:
        touch(built, key)
    change(built, "a.bag")
    report, runs = build(built, monkeypatch)
    assert [key for key, _ in runs if key] == ["a.bag"]
    assert {key: report.outcomes[key].result for key in ("b.mcap", "c")} == {"b.mcap": "hit", "c": "hit"}
    change(built, "a.bag")  # back to what it was


def test_content_edited_in_place_is_noticed_after_it_was_hashed(built, monkeypatch):
    """As by a build that was interrupted, or that read the others, too: size and time are those on record again."""
    (path,) = files_of(built, "a.bag")
    before = path.stat()
    change(built, "a.bag")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    recipe = load_recipe(built)
    digest.recording_digest(discover(recipe.bags).recordings["a.bag"], DigestIndex.of(recipe))
    bag = survey(built).plan.bags["a.bag"].assets["bag"]
    assert (bag.state, bag.reason) == ("stale", "content changed")
    touch(built, "b.mcap")
    _, runs = build(built, monkeypatch)
    assert [key for key, _ in runs if key] == ["a.bag"]
    change(built, "a.bag")  # back to what it was


def test_one_that_changes_after_its_run_has_read_it_is_not_said_to_be_built(built, monkeypatch, tmp_path):
    (path,) = files_of(built, "a.bag")
    first, other = path.read_bytes(), write_drive(tmp_path / "a.bag", "ros1", duration_s=1.2).read_bytes()

    def put_back(event):
        if (event.kind, event.key) == ("done", "a.bag"):
            path.write_bytes(first)

    path.write_bytes(other)
    report, runs = build(built, monkeypatch, on_event=put_back)
    assert [key for key, _ in runs if key] == ["a.bag"]
    outcome = report.outcomes["a.bag"]
    assert (outcome.result, outcome.reason) == (
        "stopped",
        "it changed after it had been read; the next build carries on",
    )
    assert not report.succeeded
    report, _ = build(built, monkeypatch)
    assert (report.outcomes["a.bag"].result, report.succeeded) == ("hit", True)


def test_one_that_changes_while_it_is_read_is_left_to_its_run(built, monkeypatch):
    touch(built, "a.bag")
    touch(built, "b.mcap")
    real = touched.recording_digest

    def growing(recording, *args, **options):
        if recording.key == "a.bag":
            raise ChangedWhileReadError("a.bag changed")
        return real(recording, *args, **options)

    monkeypatch.setattr(touched, "recording_digest", growing)
    report, runs = build(built, monkeypatch)
    assert [key for key, _ in runs if key] == ["a.bag"]
    assert report.outcomes["a.bag"].result == "hit"
    assert report.outcomes["b.mcap"].result == "hit"


def test_one_that_is_hashed_ahead_of_the_build_is_not_hashed_again(built, monkeypatch):
    touch(built, "a.bag")
    (file,) = files_of(built, "a.bag")
    recipe = load_recipe(built)
    recording = discover(recipe.bags).recordings["a.bag"]
    hashed, real, begun, waits = [], digest.digest_file, threading.Event(), threading.Event()

    def noted(path, between):
        hashed.append(path)
        begun.set()
        waits.wait(0.5)  # as long as nobody else begins to hash it
        return real(path, between)

    def begins(path, between):
        waits.set()
        return noted(path, between)

    def ahead():
        stat = digest.recording_stat(recording)
        first_pass(recording_assets(recipe), recording, stat)

    monkeypatch.setattr(digest, "digest_file", noted)
    other = threading.Thread(target=ahead)
    other.start()
    assert begun.wait(60)
    monkeypatch.setattr(digest, "digest_file", begins)
    _, runs = build(built, monkeypatch)
    other.join()
    assert (hashed, runs) == ([file], [])


def test_of_all_records_only_that_of_bag_is_fetched_and_nothing_else_is_looked_into(built, monkeypatch):
    touch(built, "a.bag")
    asked, real = [], Records.fetch

    def noted(records, ids, keys):
        keys = list(keys)
        asked.append({asset for asset, by_key in ids.items() for key in keys if key in by_key})
        return real(records, ids, keys)

    monkeypatch.setattr(Records, "fetch", noted)
    monkeypatch.setattr(planner, "plan_recording", None)
    build(built, monkeypatch)
    assert asked == [{"bag"}, {"bag"}]


@pytest.mark.parametrize("change_of", ["recipe", "record"])
def test_what_else_changed_meanwhile_is_looked_into(built, monkeypatch, change_of):
    """The last plan of a recording that was touched holds only if nothing but its time is another."""
    touch(built, "a.bag")
    if change_of == "recipe":
        text = built.read_text()
        built.write_text(text + "# another text\n")
    else:
        with pending_work.open_project(built) as workspace:
            instance = workspace.instance
            instance.report_runless_asset_event(
                dg.AssetMaterialization("inventory", partition="a.bag", tags={DATA_VERSION: "0" * 64})
            )
    looked, real = [], planner.plan_recording

    def noted(graph):
        looked.append((graph.recording.key, sorted(graph.recorded)))
        return real(graph)

    monkeypatch.setattr(planner, "plan_recording", noted)
    report, runs = build(built, monkeypatch)
    assert "a.bag" in {key for key, _ in looked}
    assert report.succeeded
    assert [key for key, _ in runs if key] == ([] if change_of == "recipe" else ["a.bag"])
    assert set(states(survey(built), "a.bag").values()) == {"fresh"}
    if change_of == "recipe":
        built.write_text(text)


def test_the_plan_is_the_same_as_one_that_remembers_nothing(built, monkeypatch):
    for key in KEYS:
        touch(built, key)
    build(built, monkeypatch)
    real, looked = planner.plan_recording, []

    def noted(graph):
        looked.append(graph.recording.key)
        return real(graph)

    monkeypatch.setattr(planner, "plan_recording", noted)
    with pending_work.open_project(built) as workspace:
        remembered = instance_plan.plan_instance(workspace)
        assert looked == []
        monkeypatch.setattr(PlanCache, "load", lambda *_args: {})
        whole = instance_plan.plan_instance(workspace)
    assert sorted(looked) == sorted(KEYS)
    assert remembered == whole


def test_one_that_a_build_is_not_asked_for_is_not_read(built, monkeypatch):
    touch(built, "a.bag")
    touch(built, "b.mcap")
    assert list(build(built, monkeypatch, bags=("b.mcap",))[0].outcomes) == ["b.mcap"]
    assert states(survey(built), "a.bag")["bag"] == "stale"
    with pytest.raises(SelectionError):
        build(built, monkeypatch, select=("no_such_asset",))
    assert states(survey(built), "a.bag")["bag"] == "stale"


def test_an_interrupt_ends_the_reading_and_what_had_been_read_is_on_record(built, monkeypatch):
    touch(built, "a.bag")
    touch(built, "b.mcap")
    real, real_digest, asked = digest.digest_file, touched.recording_digest, []

    def slow_for_one(path, between):
        while path.name == "a.bag":
            between(1)
        return real(path, between)

    def listener(event):
        asked.append(event)
        raise KeyboardInterrupt

    monkeypatch.setattr(digest, "digest_file", slow_for_one)
    before = {key: len(records(built, key)) for key in ("a.bag", "b.mcap")}
    with pending_work.open_project(built) as workspace:
        looking = instance_plan.planner_of(workspace)
        found = {looking.discovery.recordings[key]: one for key, one in looking.touched().items()}
        with pytest.raises(KeyboardInterrupt):
            touched.record_touched(workspace, found, 2, listener)
    (event,) = asked
    assert event.kind == "reading"
    assert event.message.startswith("Reading 2 recordings whose time changed, ")
    assert {key: len(records(built, key)) for key in before} == {
        "a.bag": before["a.bag"],
        "b.mcap": before["b.mcap"] + 1,
    }
    monkeypatch.setattr(digest, "digest_file", real)
    hashed = []
    monkeypatch.setattr(
        touched,
        "recording_digest",
        lambda one, *args, **options: hashed.append(one.key) or real_digest(one, *args, **options),
    )
    assert build(built, monkeypatch)[1] == []
    assert hashed == ["a.bag"]
