"""Assets and checks in a real Dagster instance."""

import re
from pathlib import Path

import dagster as dg
import pytest

from bagassets.defs.graph.location import build_definitions
from bagassets.defs.records.events import Records
from bagassets.defs.records.instance_plan import plan_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import add_partitions
from bagassets.defs.records.workspace import Workspace
from bagassets.formats.nuscenes.dataset_checks import CHECKS as DATASET_CHECKS
from bagassets.recipe import load_recipe
from bagassets_tests.checks import RECORDING_CHECKS
from bagassets_tests.recording_build import RECORDING_ASSETS
from bagassets_tests.small_drive import RECIPE, write_drive


@pytest.fixture
def project(tmp_path):
    write_drive(tmp_path / "bags" / "a.bag", "ros1", duration_s=2.0)
    (tmp_path / "recipe.yaml").write_text(RECIPE.format(name="test", root="bags"))
    with dg.DagsterInstance.ephemeral() as instance:
        yield tmp_path / "recipe.yaml", instance


def materialize(recipe_file, instance, key, assets=None):
    job = build_definitions(recipe_file).resolve_implicit_global_asset_job_def()
    selection = None if assets is None else [dg.AssetKey(name) for name in assets]
    return job.execute_in_process(
        partition_key=key, instance=instance, asset_selection=selection, raise_on_error=False
    )


def plan_of(recipe_file, instance):
    return plan_instance(Workspace(recipe_file=str(recipe_file)).on(instance))


def states(plan, key):
    return {name: asset.state for name, asset in plan.bags[key].assets.items()}


def materialized(result):
    return {e.asset_key.to_user_string() for e in result.all_events if e.is_step_materialization}


def test_everything_materializes_and_is_fresh_afterwards(project):
    recipe_file, instance = project
    recipe = load_recipe(recipe_file)
    add_partitions(Records(instance, Naming(recipe.name)), ["a.bag"])
    assert set(states(plan_of(recipe_file, instance), "a.bag").values()) == {"missing"}
    result = materialize(recipe_file, instance, "a.bag")
    assert result.success
    assert materialized(result) == {
        *RECORDING_ASSETS,
        "preview",
        "dataset_inputs",
        "nuscenes_dataset",
        "trajectory_map",
    }
    assert set(states(plan_of(recipe_file, instance), "a.bag").values()) == {"fresh"}
    assert (recipe.nuscenes.output / "v1.0-test" / "sample.json").is_file()
    checks = [
        e.event_specific_data for e in result.all_events if e.event_type_value == "ASSET_CHECK_EVALUATION"
    ]
    assert len(checks) == len(RECORDING_CHECKS) + len(DATASET_CHECKS)
    assert all(check.passed for check in checks)


def test_materializing_again_is_a_recorded_hit(project):
    recipe_file, instance = project
    add_partitions(Records(instance, Naming(load_recipe(recipe_file).name)), ["a.bag"])
    materialize(recipe_file, instance, "a.bag")
    result = materialize(recipe_file, instance, "a.bag", ["frames"])
    (event,) = [e for e in result.all_events if e.is_step_materialization]
    metadata = event.event_specific_data.materialization.metadata
    assert metadata["cached"].value is True
    assert len(metadata["action_digest"].value) == 64


def test_a_missing_upstream_fails_with_a_sentence_and_no_traceback(project):
    recipe_file, instance = project
    add_partitions(Records(instance, Naming(load_recipe(recipe_file).name)), ["a.bag"])
    result = materialize(recipe_file, instance, "a.bag", ["nuscenes_tables"])
    assert not result.success
    (failure,) = [e for e in result.all_events if e.is_step_failure]
    assert "bag is not materialized" in failure.event_specific_data.user_failure_data.description


def test_an_unreadable_recording_fails_alone_with_a_sentence(project):
    recipe_file, instance = project
    (recipe_file.parent / "bags" / "broken.bag").write_bytes(b"#ROSBAG V2.0\n" + b"x" * 100)
    add_partitions(Records(instance, Naming(load_recipe(recipe_file).name)), ["a.bag", "broken.bag"])
    assert materialize(recipe_file, instance, "a.bag", RECORDING_ASSETS).success
    result = materialize(recipe_file, instance, "broken.bag", RECORDING_ASSETS)
    (failure,) = [e for e in result.all_events if e.is_step_failure]
    sentence = failure.event_specific_data.user_failure_data.description
    assert "broken.bag" in sentence
    assert "rosbag reindex" in sentence
    assert plan_of(recipe_file, instance).bags["broken.bag"].failed is not None


def test_a_code_server_can_load_everything(project):
    """It checks what a run does not ask for, such as names that two definitions share."""
    recipe_file, _ = project
    build_definitions(recipe_file).get_repository_def().load_all_definitions()


def test_the_page_about_other_dagsters_can_be_followed_as_it_stands(tmp_path):
    for name in ("north", "south"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "recipe.yaml").write_text(RECIPE.format(name=name, root="bags"))
    page = (Path(__file__).parents[3] / "docs" / "own-dagster.md").read_text(encoding="utf-8")
    merged, own = (
        text.replace("/data/", f"{tmp_path}/") for text in re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    )
    there = {"dg": dg}
    exec(own, there)
    exec(merged, there)
    graph = there["defs"].resolve_asset_graph()
    north = graph.get(dg.AssetKey(["north", "frames"]))
    assert graph.get(dg.AssetKey("sharpness")).partitions_def == north.partitions_def
    assert graph.get(dg.AssetKey("sharpness")).parent_keys == {north.key}
