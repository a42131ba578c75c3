"""Label files are looked at by the plan, its memory, and the sensor."""

import dagster as dg
import pytest
import yaml
from label_files import box_json

from bagassets.defs.graph.location import build_definitions
from bagassets.defs.graph.sensor_cursor import Cursor
from bagassets.defs.graph.sensor_scan import Scan
from bagassets.defs.records.events import Records
from bagassets.defs.records.instance_plan import plan_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import add_partitions
from bagassets.defs.records.workspace import Workspace
from bagassets.recipe import load_recipe
from bagassets_tests.small_drive import RECIPE, write_drive

pytestmark = pytest.mark.once

CHANGED = {"annotations", "nuscenes_tables"}


@pytest.fixture
def project(tmp_path):
    """A recording with labels, brought up to date in a real instance."""
    write_drive(tmp_path / "bags" / "a.mcap", "mcap", duration_s=2.2)
    (tmp_path / "bags" / "a.boxes.json").write_text(box_json())
    data = yaml.safe_load(RECIPE.format(name="test", root="bags"))
    data["preview"] = {"enabled": False}
    data["rigs"][0]["annotation_files"] = [{"format": "boxes", "path": "{stem}.boxes.json"}]
    (tmp_path / "recipe.yaml").write_text(yaml.safe_dump(data))
    with dg.DagsterInstance.ephemeral() as instance:
        add_partitions(Records(instance, Naming(load_recipe(tmp_path / "recipe.yaml").name)), ["a.mcap"])
        execute(tmp_path / "recipe.yaml", instance, None)
        yield tmp_path / "recipe.yaml", instance


def execute(recipe_file, instance, assets):
    job = build_definitions(recipe_file).resolve_implicit_global_asset_job_def()
    selection = None if assets is None else [dg.AssetKey(name) for name in assets]
    assert job.execute_in_process(
        partition_key="a.mcap", instance=instance, asset_selection=selection
    ).success


def plan(recipe_file, instance):
    return plan_instance(Workspace(recipe_file=str(recipe_file)).on(instance)).bags["a.mcap"]


def not_fresh(bag):
    return {name for name, asset in bag.assets.items() if asset.state != "fresh"}


def test_an_edited_label_file_is_planned_for_though_the_recording_is_as_it_was(project):
    recipe_file, instance = project
    assert plan(recipe_file, instance).to_run() == ()
    assert plan(recipe_file, instance).to_run() == ()  # from memory
    (recipe_file.parent / "bags" / "a.boxes.json").write_text(box_json([]))
    bag = plan(recipe_file, instance)
    assert not_fresh(bag) == CHANGED
    assert bag.assets["annotations"].reason == "labels {stem}.boxes.json changed"
    execute(recipe_file, instance, bag.to_run())
    assert plan(recipe_file, instance).to_run() == ()
    (recipe_file.parent / "bags" / "a.boxes.json").unlink()
    assert not_fresh(plan(recipe_file, instance)) == CHANGED


def test_the_sensor_asks_for_the_recording_once_per_edit(project):
    recipe_file, instance = project
    cursor, now_s = Cursor(), 1_800_000_000.0

    def look():
        nonlocal cursor, now_s
        now_s += 1
        requests = Scan(Workspace(recipe_file=str(recipe_file)).on(instance), cursor).scan(now_s)
        cursor = Cursor.parse(cursor.text())
        return [(request.partition_key, request.tags["why"]) for request in requests]

    assert look() == []
    labels = recipe_file.parent / "bags" / "a.boxes.json"
    labels.write_text(box_json([]))
    assert look() == [("a.mcap", "labels {stem}.boxes.json changed")]
    assert look() == []
    execute(recipe_file, instance, ["annotations", "nuscenes_tables"])
    assert [key for key, _ in look()] == [None]  # the dataset
    execute(recipe_file, instance, None)
    assert look() == []
    labels.write_text(box_json())  # as it was: everything is in the store
    assert [key for key, _ in look()] == ["a.mcap"]
