"""Vision dataset, pictures, map and named datasets as assets in a real Dagster instance."""

import json

import dagster as dg
import pytest

from bagassets.defs.graph.dataset import dataset_is_current
from bagassets.defs.graph.location import build_definitions
from bagassets.defs.records.events import Records
from bagassets.defs.records.instance_plan import plan_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import add_partitions
from bagassets.defs.records.workspace import Workspace
from bagassets.formats.dataset_build import select_inputs
from bagassets.recipe import load_recipe
from bagassets_tests.small_drive import RECIPE, write_drive

EXTRA = "vision: {frames: 5}\ndatasets: [{name: mine, scenes: ['*']}]\n"


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dagster")
    write_drive(folder / "bags" / "a.bag", "ros1", duration_s=2.0)
    (folder / "recipe.yaml").write_text(RECIPE.format(name="test", root="bags") + EXTRA)
    with dg.DagsterInstance.ephemeral() as instance:
        add_partitions(Records(instance, Naming(load_recipe(folder / "recipe.yaml").name)), ["a.bag"])
        yield folder / "recipe.yaml", instance, materialize(folder / "recipe.yaml", instance)


def materialize(recipe_file, instance, assets=None):
    job = build_definitions(recipe_file).resolve_implicit_global_asset_job_def()
    selection = None if assets is None else [dg.AssetKey(name) for name in assets]
    return job.execute_in_process(
        partition_key="a.bag", instance=instance, asset_selection=selection, raise_on_error=False
    )


def metadata(result, asset):
    (event,) = [
        e for e in result.all_events if e.is_step_materialization and e.asset_key.to_user_string() == asset
    ]
    return event.event_specific_data.materialization.metadata


def test_all_of_them_are_made(project):
    recipe_file, _, result = project
    assert result.success
    recipe = load_recipe(recipe_file)
    rows = json.loads((recipe.vision.output / "annotations" / "train.json").read_bytes())
    rows += json.loads((recipe.vision.output / "annotations" / "val.json").read_bytes())
    assert [(row["recording"], len(row["frames"])) for row in rows] == [("a.bag", 5)] * 3
    scenes = (recipe_file.parent / "dataset" / "mine" / "v1.0-test" / "scene.json").read_text()
    assert "a.bag_000" in scenes
    assert (recipe.state / "trajectory_map.html").is_file()


def test_the_datasets_are_current_until_what_they_are_made_with_changes(project, tmp_path):
    recipe_file, instance, _ = project
    workspace = Workspace(recipe_file=str(recipe_file))
    inputs = select_inputs(plan_instance(workspace.on(instance)))
    assert len(inputs.parts["vision"]) == 1
    assert dataset_is_current(workspace.on(instance), inputs)
    for change in ("frames: 4", "frames: 5, files: one"):
        text = recipe_file.read_text().replace("frames: 5", change)
        other = recipe_file.with_name("other.yaml")
        other.write_text(text)
        assert not dataset_is_current(Workspace(recipe_file=str(other)).on(instance), inputs)
    (workspace.recipe.state / "trajectory_map.html").unlink()
    assert not dataset_is_current(workspace.on(instance), inputs)


def test_people_see_pictures_shares_and_what_was_left_out(project):
    _, _, result = project
    pictures = metadata(result, "preview")
    # The camera of this drive sees its lidar's points, and everything else there is to show.
    assert {name for name in pictures if name.startswith("picture_")} == {
        "picture_lidar_over_camera",
        "picture_birds_eye",
        "picture_future_trajectory",
        "picture_contact_sheet",
        "picture_timeline",
    }
    assert "data:image/jpeg;base64," in pictures["thumbnail"].value
    assert "| val |" in metadata(result, "vision_dataset")["split_shares"].value
    assert metadata(result, "dataset_mine")["scenes_left_out"].value == {}
    assert metadata(result, "trajectory_map")["recordings"].value == 1


def test_a_recording_without_sequences_still_enters_the_nuscenes_dataset(project, monkeypatch):
    recipe_file, instance, _ = project
    other = recipe_file.with_name("broken.yaml")
    other.write_text(recipe_file.read_text().replace("frames: 5", "frames: 6"))

    def fail(*_args, **_options):
        from bagassets.base.errors import DatasetError

        raise DatasetError("this is a test")

    monkeypatch.setattr("bagassets.formats.vision.recording_part.cut_sequences", fail)
    result = materialize(other, instance, ["vision_sequences"])
    assert not result.success
    inputs = select_inputs(plan_instance(Workspace(recipe_file=str(other)).on(instance)))
    assert [part.key for part in inputs.parts["nuscenes"]] == ["a.bag"]
    assert inputs.parts["vision"] == ()
    assert inputs.failed["vision"] == {"a.bag": "this is a test"}
