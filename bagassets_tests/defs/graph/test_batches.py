"""Small recordings share runs; each is recorded, checked and failed as if it had a run of its own."""

import json

import dagster as dg
import pytest
from dagster._core.definitions.data_version import CachingStaleStatusResolver, StaleStatus
from dagster._core.event_api import PartitionKeyFilter
from dagster._core.loader import LoadingContextForTest
from dagster._core.storage.partition_status_cache import get_and_update_asset_status_cache_value

from bagassets.assets.quality.evidence import Evidence
from bagassets.base.errors import DatasetError, StoreError
from bagassets.defs.builds import made_ahead, pending_work
from bagassets.defs.builds import report as builds_report
from bagassets.defs.graph import making, several
from bagassets.defs.graph.location import build_definitions
from bagassets.defs.records.batches import batch_of
from bagassets.defs.records.events import MADE_ALONG
from bagassets.defs.records.instance_plan import planner_of
from bagassets.defs.runs.execution import failure_of
from bagassets.engine import batches as engine_batches
from bagassets.engine import next_steps
from bagassets.engine.batches import DATASET, batches, without_steps
from bagassets.formats import checking
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest
from bagassets.recordings.digest_record import DigestIndex
from bagassets.recordings.discover import discover
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store
from bagassets_tests.in_process import build, make_project, states, survey
from bagassets_tests.small_drive import RECIPE, write_drive

pytestmark = pytest.mark.once

KEYS = tuple(f"d{number}.bag" for number in range(4))
ASSETS = ("bag", "inventory", "frames", "annotations", "nuscenes_tables")
BROKEN = "d2.bag"
NUSCENES = "nuscenes_dataset"


@pytest.fixture
def project(tmp_path):
    return make(tmp_path, KEYS)


def make(folder, keys):
    """Write a project of small recordings that differ in their duration; return its recipe file."""
    recipe_file = make_project(folder, ())
    for number, key in enumerate(keys):
        write_drive(folder / "bags" / key, "ros1", duration_s=1.0 + number / 10)
    return recipe_file


def batch_runs(instance):
    return [run for run in instance.get_runs() if batch_of(run)]


def partitions(instance, recipe_file, asset, status):
    """Return the partitions of an asset that the web UI shows with a status."""
    definition = build_definitions(recipe_file).get_repository_def().asset_graph.get(dg.AssetKey(asset))
    value = get_and_update_asset_status_cache_value(
        instance, dg.AssetKey(asset), definition.partitions_def, dynamic_partitions_loader=instance
    )
    if status == "made":
        subset = value.deserialize_materialized_partition_subsets(definition.partitions_def)
    elif status == "failed":
        subset = value.deserialize_failed_partition_subsets(definition.partitions_def)
    else:
        subset = value.deserialize_in_progress_partition_subsets(definition.partitions_def)
    return set(subset.get_partition_keys())


def metadata(instance, asset, key):
    """Return the metadata of the latest materialization of an asset of a recording."""
    about = dg.AssetRecordsFilter(asset_key=dg.AssetKey(asset), asset_partitions=[key])
    (record,) = instance.fetch_materializations(about, limit=1).records
    return record.asset_materialization.metadata


def outcomes(report):
    return {key: outcome.result for key, outcome in report.outcomes.items()}


def test_large_recordings_have_a_run_each_and_small_ones_share():
    sizes = {f"s{number}": 1000 + number for number in range(9)} | {"large": 10**9, "larger": 10**10}
    todo = dict.fromkeys(sorted(sizes), ("bag",))
    dealt = [sorted(batch) for batch in batches(todo, sizes, 2)]
    assert dealt[:2] == [["larger"], ["large"]]
    assert sorted(key for keys in dealt[2:] for key in keys) == [f"s{number}" for number in range(9)]
    assert [len(keys) for keys in dealt[2:]] in ([4, 5], [5, 4])
    assert {len(batch) for batch in batches(todo, sizes, 5)} == {1}  # too few for five jobs
    few = {f"s{number}": 27 * 10**6 for number in range(4)}
    assert [len(batch) for batch in batches(dict.fromkeys(few, ("bag",)), few, 2)] == [2, 2]
    few.pop("s0")
    assert {len(batch) for batch in batches(dict.fromkeys(few, ("bag",)), few, 1)} == {1}
    many = {f"s{number}": 2**20 for number in range(1000)}
    shared = batches(dict.fromkeys(many, ("bag",)), many, 2)
    assert max(len(batch) for batch in shared) <= 50
    assert sum(len(batch) for batch in shared) == 1000
    empty = dict.fromkeys(many, 0)
    assert {len(batch) for batch in batches(dict.fromkeys(many, ("bag",)), empty, 2)} == {50}
    # Of thousands there are forty runs, as each of them looks for all recordings, but none with more than 500.
    for number, size in (2_000, 50), (10_000, 250), (100_000, 500):
        keys = dict.fromkeys((f"s{one}" for one in range(number)), ("bag",))
        assert {len(batch) for batch in batches(keys, dict.fromkeys(keys, 0), 2)} == {size}
    # 3.24 GB fill three runs: with four, each of two jobs has as many.
    medium = {f"m{number:02}": 162 * 10**6 for number in range(20)}
    dealt = batches(dict.fromkeys(medium, ("bag",)), medium, 2)
    assert [len(batch) for batch in dealt] == [5, 5, 5, 5]
    assert batches({}, {}, 2) == []


def test_where_runs_wait_in_a_queue_their_number_follows_from_how_many_share_one():
    sizes = {f"s{number:02}": 1000 for number in range(40)} | {"large": 10**9}
    todo = dict.fromkeys(sizes, ("bag",))
    assert [len(batch) for batch in batches(todo, sizes, 1000, 10)] == [1, 10, 10, 10, 10]
    medium = {f"m{number}": 10**8 for number in range(8)}
    assert {len(batch) for batch in batches(dict.fromkeys(medium, ("bag",)), medium, 1000, 10)} == {1}
    assert [len(batch) for batch in batches(dict.fromkeys(medium, ("bag",)), medium, 2)] == [4, 4]
    assert {len(batch) for batch in batches(todo, sizes, 1000, 1)} == {1}
    few = dict.fromkeys(["s00", "s01", "s02"], ("bag",))
    assert {len(batch) for batch in batches(few, sizes, 1000, 10)} == {1}


def test_where_there_are_many_all_but_the_largest_do_without_steps():
    sizes = {f"m{number}": 10**8 for number in range(8)} | {"large": 5 * 10**9}
    assert without_steps(sizes, 2) == sizes.keys() - {"large"}
    assert without_steps(sizes, 5) == frozenset()
    assert without_steps({}, 2) == frozenset()


def test_a_run_without_steps_says_what_one_with_steps_does(project, monkeypatch):
    monkeypatch.setattr(engine_batches, "SMALL_BYTES", 0)
    (project.parent / "bags" / BROKEN).write_bytes(b"no bag at all")
    events = []
    report, _ = build(project, monkeypatch, jobs=1, on_event=events.append)
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        assert sorted(batch_of(run) for run in batch_runs(instance)) == [(key,) for key in KEYS]
    assert outcomes(report) == {key: "failed" if key == BROKEN else "built" for key in KEYS}
    assert sorted(event.key for event in events if event.kind == "started") == ["", *KEYS]
    monkeypatch.setattr(engine_batches, "_FEWEST", 100)
    with_steps, _ = build(project, monkeypatch, jobs=1, retry_failed=True)
    assert with_steps.outcomes[BROKEN].reason == report.outcomes[BROKEN].reason


@pytest.mark.long
def test_recordings_of_a_batch_are_recorded_as_runs_of_their_own_would(project, monkeypatch):
    report, runs = build(project, monkeypatch, jobs=1)
    assert {key for key, _ in runs} == {*KEYS, None}
    assert outcomes(report) == dict.fromkeys(KEYS, "built")
    assert all(set(states(survey(project), key).values()) == {"fresh"} for key in KEYS)
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        (run,) = batch_runs(instance)
        assert set(batch_of(run)) == {*KEYS, DATASET}
        assert run.status == dg.DagsterRunStatus.SUCCESS
        names = ("bag", *workspace.assets.names)
        by_batch = {name: material(instance, name) for name in names}
        found = checks(instance, project)
        logged = instance.all_logs(run.run_id, of_type=dg.DagsterEventType.ASSET_CHECK_EVALUATION)
        assert len(logged) == sum(not passed for _, passed, _ in found.values()) < len(found)
        for asset in ASSETS:
            assert partitions(instance, project, asset, "made") == set(KEYS)
            assert partitions(instance, project, asset, "failed") == set()
            assert partitions(instance, project, asset, "in progress") == set()
        assert stale(instance, project, names) == set()
        for name in names:
            instance.wipe_assets([dg.AssetKey(name)])
    monkeypatch.setattr(engine_batches, "_FEWEST", 100)
    report, runs = build(project, monkeypatch, jobs=1)
    assert {key for key, _ in runs} == set(KEYS)  # the dataset is as it was
    assert outcomes(report) == dict.fromkeys(KEYS, "hit")
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        assert found == checks(instance, project)
        for name in names:
            one = material(instance, name)
            assert [tags(made) for made in one] == [tags(made) for made in by_batch[name]]
            assert [made.metadata.keys() for made in one] == [
                made.metadata.keys() - {MADE_ALONG} for made in by_batch[name]
            ]
        assert stale(instance, project, names) == set()


def test_what_a_batch_has_made_is_told_from_what_it_found(project, monkeypatch):
    """By the log of its run, which the build has followed: no event of an asset is read for that."""
    build(project, monkeypatch, jobs=1)
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        for name in ("bag", *workspace.assets.names):
            instance.wipe_assets([dg.AssetKey(name)])
    changed = project.parent / "bags" / BROKEN
    changed.unlink()
    write_drive(changed, "ros1", duration_s=1.7)
    monkeypatch.setattr(made_ahead, "_submit", lambda *_: None)
    monkeypatch.setattr(builds_report, "recordings_made", None)
    report, _ = build(project, monkeypatch, jobs=1)
    assert outcomes(report) == {key: "built" if key == BROKEN else "hit" for key in KEYS}


def test_what_a_batch_was_checked_for_is_not_checked_again(project, monkeypatch):
    """Unless somebody was at an artifact, also once that has been looked at."""
    build(project, monkeypatch, jobs=1)
    real, checked = checking.check_bag, []

    def check_bag(assets, discovery, bag, **options):
        checked.append(bag.key)
        return real(assets, discovery, bag, **options)

    def look():
        with pending_work.open_project(project) as workspace:
            plan, assets = planner_of(workspace).plan(), workspace.assets
            checked.clear()  # planning makes quick checks
            found = dict(checking.check_bags(assets, plan, plan.bags.values()))
        asked = [*checked]
        for key, verdicts in found.items():
            fresh = real(assets, plan.discovery, plan.bags[key])
            assert json.dumps([one.as_json() for one in verdicts]) == json.dumps(
                [one.as_json() for one in fresh]
            )
        return asked, found

    monkeypatch.setattr(checking, "check_bag", check_bag)
    asked, found = look()
    assert asked == []
    assert found.keys() == set(KEYS)
    assert all(len(verdicts) > 5 for verdicts in found.values())
    store = Store(load_recipe(project).store_path)
    cloud = min(store.root.glob("artifacts/*/*/files/*.bin"))
    cloud.with_name("stranger").touch()
    with pending_work.open_project(project) as workspace:
        planner_of(workspace).plan()
    asked, _ = look()
    assert len(asked) == 1, "it was checked with what was there before"


def test_a_check_that_could_not_read_is_made_again(project, monkeypatch):
    """What a disk refused once is no property of the recording."""
    build(project, monkeypatch, jobs=1)
    store = Store(load_recipe(project).store_path)
    for cloud in store.root.glob("artifacts/*/*/files/*.bin"):
        cloud.with_name("stranger").touch()  # so that each recording is to be checked once more

    def look():
        """Return the problems that checks find, and those that the plan has from quick ones."""
        with pending_work.open_project(project) as workspace:
            plan = planner_of(workspace).plan()
            found = dict(checking.check_bags(workspace.assets, plan, plan.bags.values()))
            quick = [*checking.remarks_on_record(workspace.assets, plan.discovery, plan.bags.values())]
        return [one for verdicts in found.values() for one in verdicts if one.is_error], quick

    def refuse(*_):
        raise StoreError("the disk refuses")

    with monkeypatch.context() as refusing:
        refusing.setattr(Artifact, "read_table", refuse)
        refusing.setattr(Evidence, "channels", refuse)  # planning could read the same file just before
        problems, remarks = look()
        assert problems
        assert "the disk refuses" in str(remarks)
    assert look() == ([], [])


def material(instance, name):
    """Return the latest materialization of each recording."""
    return [
        instance.fetch_materializations(
            dg.AssetRecordsFilter(asset_key=dg.AssetKey(name), asset_partitions=[key]), limit=1
        )
        .records[0]
        .asset_materialization
        for key in KEYS
    ]


def tags(made):
    """Return the tags, but for the versions and records of the inputs: Dagster takes those of any partition."""
    return {name: "input" if "/input_" in name else value for name, value in made.tags.items()}


def checks(instance, recipe_file):
    """Return the latest result of each check of each recording, as the web UI looks it up."""
    keys = build_definitions(recipe_file).get_repository_def().asset_graph.asset_check_keys
    storage = instance.event_log_storage
    counted = {
        (info.check_key, info.partition_key) for info in storage.get_asset_check_partition_info(list(keys))
    }
    found = {}
    for partition in KEYS:
        latest = storage.get_latest_asset_check_execution_by_key(
            list(keys), PartitionKeyFilter(key=partition)
        )
        for key, record in latest.items():
            target = record.evaluation.target_materialization_data
            assert target.run_id == record.run_id
            assert (key, partition) in counted
            found[key, partition] = record.status, record.evaluation.passed, record.evaluation.severity
    return found


def stale(instance, recipe_file, names, partitions=KEYS):
    """Return the assets that Dagster marks as stale, with the recordings for which it does."""
    graph = build_definitions(recipe_file).get_repository_def().asset_graph
    resolver = CachingStaleStatusResolver(instance, graph, LoadingContextForTest(instance))
    return {
        (name, key)
        for name in names
        for key in partitions
        if resolver.get_status(dg.AssetKey(name), key) != StaleStatus.FRESH
    }


@pytest.mark.long
def test_a_change_upstream_makes_those_downstream_stale_for_dagster(project, monkeypatch):
    build(project, monkeypatch, jobs=1)
    (project.parent / "bags" / KEYS[0]).unlink()
    write_drive(project.parent / "bags" / KEYS[0], "ros1", duration_s=1.5)
    build(project, monkeypatch, jobs=1, select=("bag", "inventory"))
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        found = stale(instance, project, workspace.assets.names)
    assert ("frames", KEYS[0]) in found
    assert {key for _, key in found} == {KEYS[0]}


@pytest.mark.long
def test_one_failing_recording_fails_alone(project, monkeypatch):
    whole = (project.parent / "bags" / BROKEN).read_bytes()
    (project.parent / "bags" / BROKEN).write_bytes(b"no bag at all")
    report, _ = build(project, monkeypatch, jobs=1)
    assert outcomes(report) == {key: "failed" if key == BROKEN else "built" for key in KEYS}
    assert BROKEN in report.outcomes[BROKEN].reason
    assert report.dataset == "updated"  # of the others
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        (run,) = batch_runs(instance)
        assert run.status == dg.DagsterRunStatus.FAILURE
        assert partitions(instance, project, "frames", "made") == set(KEYS) - {BROKEN}
        assert partitions(instance, project, "frames", "failed") == {BROKEN}
        assert partitions(instance, project, "bag", "failed") == set()
    assert "failed before" in build(project, monkeypatch, jobs=1)[0].outcomes[BROKEN].reason
    (project.parent / "bags" / BROKEN).write_bytes(whole)
    assert outcomes(build(project, monkeypatch, jobs=1)[0])[BROKEN] == "built"


def test_nothing_is_failed_for_dagster_once_a_damaged_recording_is_as_before(project, monkeypatch):
    build(project, monkeypatch, jobs=1)
    file = project.parent / "bags" / BROKEN
    whole = file.read_bytes()
    file.write_bytes(b"no bag at all")
    assert outcomes(build(project, monkeypatch, jobs=1)[0])[BROKEN] == "failed"
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        names = workspace.assets.names
        assert partitions(instance, project, "frames", "failed") == {BROKEN}
    file.write_bytes(whole)
    recipe = load_recipe(
        project
    )  # hashed, as by a server ahead of the build, so that the plan knows all results
    recording_digest(discover(recipe.bags).recordings[BROKEN], DigestIndex.of(recipe))
    assert outcomes(build(project, monkeypatch, jobs=1)[0])[BROKEN] == "hit"
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        assert [name for name in names if partitions(instance, project, name, "failed")] == []


@pytest.mark.long
def test_a_recording_that_is_skipped_is_not_failed_where_another_one_is(project, monkeypatch):
    (project.parent / "bags" / BROKEN).write_bytes(b"no bag at all")
    (project.parent / "bags" / KEYS[0]).unlink()
    write_drive(project.parent / "bags" / KEYS[0], "ros1", duration_s=0.4)
    project.write_text(project.read_text().replace("settle_s: 0", "settle_s: 0, min_duration_s: 0.8"))
    report, _ = build(project, monkeypatch, jobs=1)
    expected = {KEYS[0]: "skipped", BROKEN: "failed"}
    assert outcomes(report) == {key: expected.get(key, "built") for key in KEYS}
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        assert partitions(instance, project, "frames", "failed") == {BROKEN}
        # A materialization without files, or Dagster would take it as failed in a backfill.
        assert partitions(instance, project, "frames", "made") == set(KEYS) - {BROKEN}
        for asset in ("frames", "nuscenes_tables"):
            said = metadata(instance, asset, KEYS[0])
            assert list(said)[:2] == ["skipped", "reason"]
            assert said["reason"].value == report.outcomes[KEYS[0]].reason


def test_an_unexpected_error_is_one_recordings_own(project, monkeypatch):
    real = making.read_bag

    def read_bag(recorder, recording):
        if recording.key == BROKEN:
            raise ZeroDivisionError("by chance")
        return real(recorder, recording)

    monkeypatch.setattr("bagassets.defs.graph.making.read_bag", read_bag)
    report, _ = build(project, monkeypatch, jobs=1)
    assert outcomes(report) == {key: "failed" if key == BROKEN else "built" for key in KEYS}
    assert report.outcomes[BROKEN].reason == "ZeroDivisionError: by chance"


@pytest.mark.long
def test_what_a_worker_left_when_it_died_gets_another_run(project, monkeypatch):
    real = making.read_bag
    died = []

    def read_bag(recorder, recording):
        if recording.key == BROKEN and not died:
            died.append(recording.key)
            raise SystemExit("killed")
        return real(recorder, recording)

    monkeypatch.setattr("bagassets.defs.graph.making.read_bag", read_bag)
    report, _ = build(project, monkeypatch, jobs=1)
    assert outcomes(report) == {key: "failed" if key == BROKEN else "built" for key in KEYS}
    assert report.dataset == "updated"  # of the others, by a run of its own


def dataset_records(instance, recipe_file):
    """Return the tags and the metadata of the latest record of the dataset, and the latest result of each check of it."""
    made = instance.get_latest_materialization_event(dg.AssetKey(NUSCENES)).asset_materialization
    graph = build_definitions(recipe_file).get_repository_def().asset_graph
    keys = [key for key in graph.asset_check_keys if key.asset_key == dg.AssetKey(NUSCENES)]
    latest = instance.event_log_storage.get_latest_asset_check_execution_by_key(keys)
    results = {key.name: (one.status, one.evaluation.severity) for key, one in latest.items()}
    runs = {one.run_id for one in latest.values()}
    described = {name: value for name, value in made.tags.items() if "/input_event_pointer/" not in name}
    return described, made.metadata.keys() - {"moved"}, results, runs


def test_the_run_of_a_changed_recording_makes_the_dataset_too(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path, ("a.bag", "b.bag"))
    build(recipe_file, monkeypatch, jobs=1)
    (tmp_path / "bags" / "a.bag").unlink()
    write_drive(tmp_path / "bags" / "a.bag", "ros1", duration_s=1.2)
    report, _ = build(recipe_file, monkeypatch, jobs=1)
    assert outcomes(report) == {"a.bag": "built", "b.bag": "fresh"}
    assert report.dataset == "updated"
    assert survey(recipe_file).is_settled
    with pending_work.open_project(recipe_file) as workspace:
        instance = workspace.instance
        latest = instance.get_runs(limit=1)[0]
        assert set(batch_of(latest)) == {"a.bag", DATASET}
        *in_one_run, check_runs = dataset_records(instance, recipe_file)
        assert check_runs == {latest.run_id}
        assert in_one_run[2], "there are checks of the dataset"
        assert stale(instance, recipe_file, [NUSCENES, "dataset_inputs"], [None]) == set()
        instance.wipe_assets([dg.AssetKey(NUSCENES)])
    report, runs = build(recipe_file, monkeypatch, jobs=1)
    assert [key for key, _ in runs] == [None]
    with pending_work.open_project(recipe_file) as workspace:
        instance = workspace.instance
        *in_its_own, _ = dataset_records(instance, recipe_file)
        assert in_one_run == in_its_own


@pytest.mark.parametrize("is_large", [False, True])
def test_a_single_recording_has_steps_and_the_dataset_a_run_only_if_it_is_large(
    tmp_path, monkeypatch, is_large
):
    recipe_file = make_project(tmp_path, ("a.bag",))
    if is_large:
        monkeypatch.setattr(next_steps, "WORTH_STEPS_BYTES", 1000)
    report, _ = build(recipe_file, monkeypatch, jobs=1)
    assert (outcomes(report), report.dataset) == ({"a.bag": "built"}, "updated")
    with pending_work.open_project(recipe_file) as workspace:
        instance = workspace.instance
        batches = [set(batch_of(run)) for run in instance.get_runs()]
    assert batches == ([set(), set()] if is_large else [{"a.bag", DATASET}])


def test_a_dataset_that_fails_beside_its_recording_is_reported_once(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path, text=RECIPE)
    real = several.make_dataset

    def make_dataset(workspace, plan, inputs, asset, run_id):
        if asset == NUSCENES:
            raise DatasetError("nuscenes: somebody else's folder.")
        return real(workspace, plan, inputs, asset, run_id)

    monkeypatch.setattr(several, "make_dataset", make_dataset)
    report, runs = build(recipe_file, monkeypatch, jobs=1)
    assert outcomes(report) == {"a.bag": "built"}
    assert (report.dataset, report.dataset_problem) == ("failed", "nuscenes: somebody else's folder.")
    assert [key for key, _ in runs] == ["a.bag", None], "it was not tried again at once"
    with pending_work.open_project(recipe_file) as workspace:
        instance = workspace.instance
        assert instance.get_runs(limit=1)[0].status == dg.DagsterRunStatus.FAILURE
        assert instance.get_latest_materialization_event(dg.AssetKey("trajectory_map")) is not None
    report, _ = build(recipe_file, monkeypatch, jobs=1)
    assert report.dataset == "updated"


def test_the_failure_of_a_run_about_one_recording_is_the_sentence_about_it(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path, ())
    (tmp_path / "bags").mkdir()
    (tmp_path / "bags" / "a.bag").write_bytes(b"no bag at all")
    build(recipe_file, monkeypatch, jobs=1)
    with pending_work.open_project(recipe_file) as workspace:
        instance = workspace.instance
        (run,) = batch_runs(instance)
        assert (failure_of(instance, run) or "").startswith("a.bag: ")
