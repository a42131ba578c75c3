"""Why an asset of a recording was not made stands on the page of its partition, and nothing else changes by it."""

import dagster as dg
import pytest

from bagassets.base.errors import RecordingError
from bagassets.defs.builds import pending_work
from bagassets.defs.graph import making
from bagassets.defs.graph.making import make_recording
from bagassets.defs.records.recorder import Recorder
from bagassets.engine.execute import BuildFailure
from bagassets_tests.defs.graph.test_batches import KEYS, batch_runs, partitions, stale
from bagassets_tests.in_process import build, make_project, states, survey
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

GOOD, BROKEN = KEYS[0], KEYS[2]


@pytest.fixture
def project(tmp_path):
    return make_project(tmp_path, (GOOD, BROKEN))


def observed(instance, key):
    """Return asset -> what the latest observation of a recording's partition says."""
    found = {}
    for name in (
        "bag",
        "inventory",
        "calibration",
        "frames",
        "sweeps",
        "annotations",
        "ego_poses",
        "nuscenes_tables",
    ):
        records = instance.fetch_observations(
            dg.AssetRecordsFilter(asset_key=dg.AssetKey(name), asset_partitions=[key]), limit=10
        ).records
        if records:
            observation = records[0].asset_observation
            assert observation.metadata["not_made"].value == observation.description
            found[name] = observation.description
    return found


def events(instance):
    return [entry for run in instance.get_runs() for entry in instance.all_logs(run.run_id)]


@pytest.mark.long
def test_each_asset_of_a_broken_recording_says_why_it_was_not_made(project, monkeypatch):
    whole = (project.parent / "bags" / BROKEN).read_bytes()
    (project.parent / "bags" / BROKEN).write_bytes(b"no bag at all")
    report, runs = build(project, monkeypatch, jobs=1)
    assert {key for key, _ in runs} == {GOOD, BROKEN, None}
    assert report.dataset == "updated"  # of the other one
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        why = observed(instance, BROKEN)
        assert {"inventory", "frames", "annotations", "nuscenes_tables"} <= why.keys()
        assert "bag" not in why  # it was read, and has a digest
        assert BROKEN in why["inventory"]
        assert why["nuscenes_tables"] == f"inventory failed: {why['inventory']}"
        assert observed(instance, GOOD) == {}
        assert GOOD not in {key for _, key in stale(instance, project, workspace.assets.names)}
        assert partitions(instance, project, "frames", "failed") == {BROKEN}
    assert set(states(survey(project), GOOD).values()) == {"fresh"}
    again, _ = build(project, monkeypatch, jobs=1)
    assert "failed before" in again.outcomes[BROKEN].reason
    (project.parent / "bags" / BROKEN).write_bytes(whole)
    build(project, monkeypatch, jobs=1)
    assert set(states(survey(project), BROKEN).values()) == {"fresh"}
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        made = instance.get_latest_materialization_event(dg.AssetKey("frames"))
        assert made.asset_materialization.partition == BROKEN
        markers = stale(instance, project, workspace.assets.names)
        assert not {GOOD, BROKEN} & {key for _, key in markers}


def test_a_recording_of_a_batch_says_why_too(tmp_path, monkeypatch):
    project = make_project(tmp_path, ())
    for number, key in enumerate(KEYS):
        write_drive(tmp_path / "bags" / key, "ros1", duration_s=1.0 + number / 10)
    (tmp_path / "bags" / BROKEN).write_bytes(b"no bag at all")
    build(project, monkeypatch, jobs=1)
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        (run,) = batch_runs(instance)
        why = observed(instance, BROKEN)
        assert why["nuscenes_tables"] == f"inventory failed: {why['inventory']}"
        assert all(observed(instance, key) == {} for key in set(KEYS) - {BROKEN})
        kinds = [entry.dagster_event_type for entry in instance.all_logs(run.run_id)]
        assert kinds.count(dg.DagsterEventType.ASSET_OBSERVATION) == kinds.count(
            dg.DagsterEventType.ASSET_MATERIALIZATION_PLANNED
        )


# What a recording lacks -> the asset that fails, and what its sentence is about.
CAUSES = {
    "/odom": ("ego_poses", "the recording has no messages on /odom, which ego_pose reads"),
    "/tf_static": ("calibration", "no transform from cam to base_link"),
    "/cam/camera_info": ("calibration", "no CameraInfo on /cam/camera_info, which undistortion needs"),
}


# One recording has a run without steps, two have runs with a step for each asset, and more share a run without steps.
@pytest.mark.parametrize(
    "lacking",
    [
        ["/odom"],
        pytest.param(["/odom", "/tf_static"], marks=pytest.mark.long),
        [*CAUSES, "nothing"],
    ],
    ids=len,
)
def test_the_cause_is_named_however_many_recordings_there_are(tmp_path, monkeypatch, lacking):
    project = make_project(tmp_path, ())
    keys = {f"{number}.bag": topic for number, topic in enumerate(lacking)}
    for number, (key, lost) in enumerate(keys.items()):
        path = tmp_path / "bags" / key
        write_drive(path, "ros1", 1.0 + number / 10, keep=lambda topic, _, lost=lost: topic != lost)
    report, _ = build(project, monkeypatch, jobs=1)
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        assert bool(batch_runs(instance)) == (len(lacking) != 2)
        for key, lost in keys.items():
            if lost not in CAUSES:
                assert (report.outcomes[key].result, observed(instance, key)) == ("built", {})
                continue
            asset, cause = CAUSES[lost]
            assert cause in report.outcomes[key].reason
            assert "materialize" not in report.outcomes[key].reason
            why = observed(instance, key)
            assert cause in why[asset]
            assert why["nuscenes_tables"] == f"{asset} failed: {why[asset]}"
            # So does one that is materialized alone, as in the web UI.
            recorder = Recorder(workspace, key)
            with pytest.raises(BuildFailure) as failure:
                list(make_recording(recorder, workspace.recording(key), {"nuscenes_tables"}))
            said = str(failure.value)
            assert (
                f"{key}: {asset} is not materialized for this recording; materialize {asset} first." in said
            )
            assert said.count(cause) == 1
    for key, state in ((key, states(survey(project), key)) for key in keys):
        lost = keys[key]
        assert ("failed" in state.values()) == (lost in CAUSES)
        if lost == "/odom":  # what does not need the poses is made, and on record
            assert state["frames"] == state["sweeps"] == "fresh"


def test_an_error_that_nobody_expected_stands_there_too(project, monkeypatch):
    def fail(*_, **__):
        raise ZeroDivisionError("by chance")

    monkeypatch.setattr(making, "Graph", fail)
    build(project, monkeypatch, jobs=1)
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        assert not batch_runs(instance)
        why = observed(instance, GOOD)
    assert set(why.values()) == {"ZeroDivisionError: by chance"}
    assert {"frames", "nuscenes_tables"} <= why.keys()
    assert "bag" not in why


def test_recordings_that_are_made_have_no_observation(project, monkeypatch):
    build(project, monkeypatch, jobs=1)
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        found = events(instance)
    assert found
    assert not [e for e in found if e.dagster_event_type == dg.DagsterEventType.ASSET_OBSERVATION]


def test_an_asset_says_which_one_above_it_failed_and_one_beside_it_the_whole(project):
    with pending_work.open_project(project) as workspace:
        instance = workspace.instance
        failure = BuildFailure({"frames": RecordingError("a.bag: /cam: no image.")}, project)
        recorder = Recorder(workspace, "a.bag")
        with pytest.raises(BuildFailure), recorder.giving_up({"frames", "nuscenes_tables", "annotations"}):
            raise failure
        said = observed(instance, "a.bag")
    assert said["frames"] == "a.bag: /cam: no image."
    assert said["nuscenes_tables"] == "frames failed: a.bag: /cam: no image."
    assert said["annotations"].endswith("a.bag: /cam: no image.")
