"""Checks in a real Dagster instance: per recording, with severity and thresholds from the recipe."""

import dagster as dg
import pytest

from bagassets.defs.graph.location import build_definitions
from bagassets.defs.records.events import Records
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import add_partitions
from bagassets.formats.nuscenes.dataset_checks import CHECKS as DATASET_CHECKS
from bagassets.recipe import load_recipe
from bagassets_tests.checks import RECORDING_CHECKS
from bagassets_tests.recording_build import RECORDING_ASSETS
from bagassets_tests.small_drive import RECIPE, write_drive

KEYS = ["a.mcap", "b.mcap"]


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """Two recordings, the second of which lacks the camera that only the recipe of the tests asks for."""
    folder = tmp_path_factory.mktemp("project")
    write_drive(folder / "bags" / "a.mcap", "mcap", duration_s=2.0)
    write_drive(folder / "bags" / "b.mcap", "mcap", duration_s=1.5)
    path = folder / "recipe.yaml"
    path.write_text(RECIPE.format(name="test", root="bags"))
    with dg.DagsterInstance.ephemeral() as instance:
        add_partitions(Records(instance, Naming(load_recipe(path).name)), KEYS)
        for key in KEYS:
            assert run(path, instance, key, RECORDING_ASSETS).success
        yield path, instance


def run(path, instance, key=None, assets=(), checks=None):
    """Materialize assets with their checks, or run just the checks named."""
    definitions = build_definitions(path)
    selection = dg.AssetSelection.assets(*assets)
    if checks is not None:
        selection = dg.AssetSelection.checks(*(dg.AssetCheckKey(dg.AssetKey(a), n) for a, n in checks))
    job = dg.define_asset_job("some", selection=selection)
    merged = dg.Definitions.merge(definitions, dg.Definitions(jobs=[job]))
    return merged.resolve_job_def("some").execute_in_process(
        instance=instance, partition_key=key, raise_on_error=False
    )


def evaluations(result):
    return {
        event.event_specific_data.check_name: event.event_specific_data
        for event in result.all_events
        if event.event_type_value == "ASSET_CHECK_EVALUATION"
    }


def test_every_check_is_made_for_every_recording(project):
    path, instance = project
    for key in KEYS:
        found = evaluations(run(path, instance, key, RECORDING_ASSETS))
        assert found.keys() == {check.name for check in RECORDING_CHECKS}
        assert all(evaluation.passed for evaluation in found.values())
        assert {evaluation.partition for evaluation in found.values()} == {key}


def test_a_check_of_one_asset_runs_with_that_asset_alone(project):
    path, instance = project
    found = evaluations(run(path, instance, "a.mcap", ["calibration"]))
    assert found.keys() == {"calibration_plausible"}


def test_thresholds_and_severity_are_the_recipes(project):
    path, instance = project
    limits = "\nchecks:\n  topic_rates: {{severity: error, limits: {{/odom: {{min_hz: 60}}}}}}\n  calibration_plausible: {{max_distance_m: 1.0}}\n"
    stricter = path.with_name("stricter.yaml")
    stricter.write_text((RECIPE + limits).format(name="test", root="bags"))
    found = evaluations(run(stricter, instance, "a.mcap", RECORDING_ASSETS))
    failed = {name: evaluation for name, evaluation in found.items() if not evaluation.passed}
    assert failed.keys() == {"topic_rates", "calibration_plausible"}
    assert failed["topic_rates"].severity == dg.AssetCheckSeverity.ERROR
    assert failed["topic_rates"].description.startswith("/odom: ")
    assert failed["topic_rates"].description.endswith("Hz, at least 60 Hz expected")
    assert failed["calibration_plausible"].severity == dg.AssetCheckSeverity.WARN
    assert failed["calibration_plausible"].metadata["problems"].value == 2
    assert "- CAM_FRONT: is 1." in failed["calibration_plausible"].metadata["found"].value


def test_one_recordings_pass_does_not_hide_anothers_failure(project):
    path, instance = project
    other = path.with_name("other.yaml")
    limits = "\nchecks:\n  topic_rates: {{limits: {{/odom: {{max_gap_s: 0.001}}}}}}\n"
    other.write_text((RECIPE + limits).format(name="test", root="bags"))
    assert not evaluations(run(other, instance, "b.mcap", ["inventory"]))["topic_rates"].passed
    assert evaluations(run(path, instance, "a.mcap", ["inventory"]))["topic_rates"].passed
    key = dg.AssetCheckKey(dg.AssetKey("inventory"), "topic_rates")
    storage = instance.event_log_storage
    latest = {
        partition: storage.get_asset_check_execution_history(key, limit=1, partition_filter=_only(partition))[
            0
        ]
        for partition in KEYS
    }
    assert {partition: record.status.value for partition, record in latest.items()} == {
        "a.mcap": "SUCCEEDED",
        "b.mcap": "FAILED",
    }


def _only(partition):
    from dagster._core.storage.event_log.base import PartitionKeyFilter

    return PartitionKeyFilter(key=partition)


def test_checks_are_left_out_one_by_one_or_altogether(project):
    path, _ = project
    skipping = path.with_name("skipping.yaml")
    skipping.write_text(
        (RECIPE + "\nchecks: {{files_match: {{severity: skip}}}}\n").format(name="t", root="bags")
    )
    names = check_names(skipping)
    assert "files_match" not in names
    assert "dataset_files_match" not in names
    assert "tokens_unique" in names
    skipping.write_text((RECIPE + "\nchecks: {{enabled: false}}\n").format(name="t", root="bags"))
    assert check_names(skipping) == set()
    assert check_names(path) == {check.name for check in (*RECORDING_CHECKS, *DATASET_CHECKS)}


def check_names(path):
    definitions = build_definitions(path)
    return {key.name for key in definitions.resolve_asset_graph().asset_check_keys}


def test_a_file_that_vanished_from_the_dataset_is_named(project):
    path, instance = project
    recipe = load_recipe(path)
    assert run(path, instance, assets=["dataset_inputs", "nuscenes_dataset"]).success
    checks = [("nuscenes_dataset", check.name) for check in DATASET_CHECKS]
    assert all(e.passed for e in evaluations(run(path, instance, checks=checks)).values())
    victim = min((recipe.nuscenes.output / "samples" / "CAM_FRONT").iterdir())
    victim.unlink()
    found = evaluations(run(path, instance, checks=checks))
    assert [name for name, e in found.items() if not e.passed] == ["dataset_files_match"]
    assert f"samples/CAM_FRONT/{victim.name}" in found["dataset_files_match"].description
