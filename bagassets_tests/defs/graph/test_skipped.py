"""A recording that takes no part: recorded as skipped by whatever runs, and made as soon as it takes part."""

import json

import dagster as dg
import pytest

from bagassets.base.errors import StoreError
from bagassets.defs.builds.pending_work import find_pending_work
from bagassets.defs.graph import making
from bagassets.defs.graph.own_assets import Versions
from bagassets.defs.graph.sensor_cursor import Cursor
from bagassets.defs.graph.steps import all_recordings, skipped
from bagassets.defs.records.events import Records
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.execute import Skipped
from bagassets.engine.plan import is_skip
from bagassets.engine.targets import Read
from bagassets.formats.dataset_build import datasets_of, first_lock
from bagassets.store.canonical import digest_json
from bagassets_tests.defs.graph.test_sensor import Project, stale
from bagassets_tests.in_process import QUICK
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

LONG, SHORT, BELOW = "a.bag", "short.bag", ("frames", "nuscenes_tables")


@pytest.fixture
def project(tmp_path):
    """A recording that takes part, and one that is too short."""
    write_drive(tmp_path / "bags" / LONG, "ros1", duration_s=1.4)
    write_drive(tmp_path / "bags" / SHORT, "ros1", duration_s=0.9)
    text = QUICK.format(name="test", root="bags")
    (tmp_path / "recipe.yaml").write_text(text.replace("settle_s: 0", "settle_s: 0, min_duration_s: 1.25"))
    with dg.DagsterInstance.ephemeral() as instance:
        yield Project(tmp_path / "recipe.yaml", instance)


def edit(project, old, new):
    text = project.recipe_file.read_text()
    assert old in text
    project.recipe_file.write_text(text.replace(old, new))


def workspace(project):
    return Workspace(recipe_file=str(project.recipe_file))


def records(project, key=SHORT):
    return {name: Records(project.instance, Naming("test")).of(name, key) for name in BELOW}


def states(project, key=SHORT):
    pending = find_pending_work(workspace(project).on(project.instance))
    return {pending.plan.bags[key].assets[name].state for name in BELOW}


def in_dataset(project):
    lock = first_lock(datasets_of(project.recipe)).value
    return [bag["key"] for bag in lock["bags"]], set(lock["skipped"])


def test_it_is_recorded_as_skipped_and_made_once_it_takes_part(project):
    project.build_project()
    before = records(project)
    assert all(record.is_skip for record in before.values())
    assert {record.why_skipped for record in before.values()} == {
        "0.9 s long, bags.min_duration_s asks for 1.25 s"
    }
    assert states(project) == {"skipped"}
    assert stale(project) == set()
    assert in_dataset(project) == ([LONG], {SHORT})

    edit(project, "min_duration_s: 1.25", "min_duration_s: 1.2")  # another reason
    assert states(project) == {"skipped"}
    project.build_project()
    assert records(project)["frames"].data_version != before["frames"].data_version
    assert stale(project) == set()

    edit(project, "min_duration_s: 1.2", "min_duration_s: 0.1")
    assert states(project) == {"unknown"}  # waits for the calibration, which was skipped before
    inputs = find_pending_work(workspace(project).on(project.instance)).inputs
    assert [part.key for part in inputs.parts["nuscenes"]] == [LONG]  # until there is something of it
    project.build_project()
    assert not any(record.is_skip for record in records(project).values())
    assert stale(project) == set()
    assert in_dataset(project) == ([LONG, SHORT], set())

    edit(project, "min_duration_s: 0.1", "min_duration_s: 1.25")
    assert states(project) == {"skipped"}
    project.build_project()
    assert all(record.is_skip for record in records(project).values())
    assert stale(project) == set()
    assert in_dataset(project) == ([LONG], {SHORT})


def test_where_nothing_was_recorded_of_it_that_is_done_once_and_nothing_is_made(project, monkeypatch):
    """As with a project that an older version built."""
    execute = making.execute

    def not_skipped(graph):
        return (result for result in execute(graph) if not isinstance(result, Skipped))

    monkeypatch.setattr(making, "execute", not_skipped)
    project.build_project()
    assert records(project) == dict.fromkeys(BELOW)
    monkeypatch.undo()
    lock = project.recipe.nuscenes.output.joinpath("v1.0-test", "dataset.lock.json").read_bytes()
    project.cursor = Cursor()
    (request,) = project.scan().values()
    assert project.execute(request).success
    assert (request.partition_key, project.scan()) == (SHORT, {})
    assert all(record.is_skip for record in records(project).values())
    assert project.recipe.nuscenes.output.joinpath("v1.0-test", "dataset.lock.json").read_bytes() == lock
    assert stale(project) == set()


def test_steps_of_ones_own_pass_it_on_and_leave_it_out(project):
    project.build_project()

    @dg.asset(partitions_def=dg.DynamicPartitionsDefinition(name=Naming("test").partitions), deps=["frames"])
    def step(context: dg.AssetExecutionContext, workspace: Workspace) -> dg.MaterializeResult[None]:
        if (passed_on := skipped(context, workspace, "frames")) is not None:
            with pytest.raises(StoreError, match="has no artifact, as this recording is skipped"):
                workspace.artifact(context, "frames")
            return passed_on
        assert sorted(all_recordings(context, workspace, "frames")) == [LONG]
        return dg.MaterializeResult(metadata={"frames": workspace.artifact(context, "frames").digest})

    for key in (LONG, SHORT):
        resources = {"workspace": workspace(project)}
        assert dg.materialize(
            [step], instance=project.instance, partition_key=key, resources=resources
        ).success
    about = dg.AssetRecordsFilter(asset_key=dg.AssetKey("step"), asset_partitions=[SHORT])
    (record,) = project.instance.fetch_materializations(about, limit=1).records
    said = record.asset_materialization
    assert is_skip(said.tags["dagster/data_version"])
    assert json.loads(json.dumps({name: value.value for name, value in said.metadata.items()})) == {
        "skipped": True,
        "reason": "0.9 s long, bags.min_duration_s asks for 1.25 s",
    }
    # A step about all recordings does not become stale because one of them is skipped.
    made = records(project, LONG)["frames"].data_version
    of_all = Versions(Records(project.instance, Naming("test"))).of(Read("frames", "all"), "")
    assert of_all == digest_json({LONG: made})
