"""`bagassets build` of a project that the user's code location defines below a prefix: its records are below it, too."""

import json
import sys
from itertools import count

import dagster as dg
import pytest
import yaml
from dagster._core.definitions.reconstruct import ReconstructableJob

from bagassets.base.errors import RecipeError
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.main import main
from bagassets.defs.builds import pending_work
from bagassets.defs.records.projects import note_project
from bagassets.engine.batches import DATASET
from bagassets.engine.freshness.decide import nothing_to_do
from bagassets_tests.in_process import build, keys_of, make_project
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

MODULE = """
from pathlib import Path

import dagster as dg

from bagassets.defs import build_definitions, per_recording, recipe_beside

PREFIX = {prefix!r}


@dg.asset(
    partitions_def=per_recording(recipe_beside(__file__), key_prefix=PREFIX),
    deps=[dg.AssetKey([*(PREFIX or []), "frames"])],
    automation_condition=dg.AutomationCondition.eager(),
)
def blur(): ...


defs = dg.Definitions.merge(
    build_definitions(Path(__file__).with_name("recipe.yaml"), key_prefix=PREFIX),
    dg.Definitions(assets=[blur], executor=dg.in_process_executor),
)
"""
PREFIX = ["lab", "north"]
# Modules stay imported, so each project has one of its own.
_numbers = count()


@pytest.fixture
def project(tmp_path):
    recipe = make_project(tmp_path)
    write_drive(tmp_path / "bags" / "b.bag", "ros1", duration_s=1.3)
    module = f"prefixed_{next(_numbers)}"
    write_module(recipe, module, PREFIX)
    name_locations(recipe, module)
    yield recipe, module
    sys.modules.pop("bagassets.definitions", None)


def write_module(recipe, module, prefix):
    recipe.with_name(f"{module}.py").write_text(MODULE.format(prefix=prefix))
    sys.modules.pop(module, None)
    # Dagster keeps the last job; a new worker would import it.
    ReconstructableJob.get_definition.cache_clear()
    ReconstructableJob.get_repository_definition.cache_clear()


def name_locations(recipe, *modules):
    named = [{"python_module": {"module_name": name, "working_directory": "."}} for name in modules]
    recipe.with_name("workspace.yaml").write_text(yaml.safe_dump({"load_from": named}))


def recorded(recipe):
    """Return the runs, the keys of assets with records, and recording -> version of its frames below the prefix."""
    with pending_work.open_project(recipe) as workspace:
        instance = workspace.instance
        versions = {}
        for record in instance.fetch_materializations(dg.AssetKey([*PREFIX, "frames"]), limit=100).records:
            event = record.event_log_entry.asset_materialization
            versions.setdefault(event.partition, event.tags["dagster/data_version"])
        return instance.get_runs(), {key.to_user_string() for key in instance.all_asset_keys()}, versions


def say(capsys, recipe, *command):
    """Run a command; return its exit status and what it printed."""
    try:
        code = main([*command, "--recipe", str(recipe)])
    except SystemExit as ended:
        code = ended.code
    return code, capsys.readouterr().out


def test_everything_is_recorded_below_the_prefix_and_once(project, monkeypatch, capsys):
    recipe, _ = project
    assert say(capsys, recipe, "build", "--check")[0] == ExitStatus.FOUND
    assert say(capsys, recipe, "status")[0] == ExitStatus.FOUND
    report, _ = build(recipe, monkeypatch)
    assert report.own_problem == ""
    assert report.succeeded
    assert report.dataset == "updated"
    assert {key: one.result for key, one in report.outcomes.items()} == {"a.bag": "built", "b.bag": "built"}
    assert dict(report.own["blur"].results) == {"made": 2}
    runs, keys, versions = recorded(recipe)
    assert keys - {"blur"} == {key for key in keys if key.startswith("lab/north/")}
    assert {"lab/north/bag", "lab/north/frames", "lab/north/nuscenes_dataset", "blur"} <= keys
    assert {key for run in runs for key in keys_of(run)} >= {"a.bag", "b.bag", DATASET}
    assert len(set(versions.values())) == 2
    assert say(capsys, recipe, "build", "--check")[0] == 0
    assert say(capsys, recipe, "status")[0] == 0
    assert nothing_to_do(["build", "--recipe", str(recipe)]) is not None, "without Dagster, next time"
    assert build(recipe, monkeypatch)[1] == []


def test_a_changed_recording_is_the_only_one_that_runs_and_gc_deletes_its_runs_of_before(
    project, monkeypatch, capsys
):
    recipe, _ = project
    build(recipe, monkeypatch)
    before = recorded(recipe)[2]
    drive = recipe.parent / "bags" / "b.bag"
    drive.unlink()
    write_drive(drive, "ros1", duration_s=1.6)
    code, said = say(capsys, recipe, "explain", "b.bag", "bag", "--json")
    assert code == 0
    assert json.loads(said)["state"] == "stale"
    assert say(capsys, recipe, "explain", "b.bag", "lab/north/bag", "--json") == (code, said)
    report, runs = build(recipe, monkeypatch)
    assert {key for key, _ in runs if key} == {"b.bag"}
    after = recorded(recipe)[2]
    assert after["a.bag"] == before["a.bag"]
    assert after["b.bag"] != before["b.bag"]
    assert report.outcomes["a.bag"].result == "fresh"
    runs_before = {run.run_id for run in recorded(recipe)[0]}
    code, said = say(capsys, recipe, "gc", "--keep-runs-days", "0", "--json")
    assert code == 0
    deleted = set(json.loads(said)["runs"])
    assert deleted
    assert {run.run_id for run in recorded(recipe)[0]} == runs_before - deleted
    assert build(recipe, monkeypatch)[1] == []


def test_a_prefix_that_comes_or_goes_makes_nothing_twice(project, monkeypatch, capsys):
    recipe, module = project
    write_module(recipe, module, None)
    build(recipe, monkeypatch)
    assert "frames" in recorded(recipe)[1]
    write_module(recipe, module, PREFIX)
    report, _ = build(recipe, monkeypatch)
    assert {one.result for one in report.outcomes.values()} == {"hit"}, "all is in the store"
    assert "lab/north/frames" in recorded(recipe)[1]
    assert say(capsys, recipe, "check")[0] == 0
    for prefix in (["lab", "south"], None):
        write_module(recipe, module, prefix)
        report, _ = build(recipe, monkeypatch)
        assert report.succeeded
        with pending_work.open_project(recipe) as workspace:
            assert workspace.names.prefix == tuple(prefix or ())


def test_a_module_that_is_broken_holds_up_a_project_that_is_known_to_have_a_prefix(project, monkeypatch):
    recipe, module = project
    with pending_work.open_project(recipe) as workspace:
        instance = workspace.instance
        note_project(instance, tuple(PREFIX), recipe)
    recipe.with_name(f"{module}.py").write_text("defs = (")
    with pytest.raises(RecipeError, match="cannot be loaded"):
        build(recipe, monkeypatch)
    assert recorded(recipe)[:2] == ([], set())


def test_a_project_that_is_defined_without_a_prefix_as_well_is_built_without(project, monkeypatch):
    recipe, module = project
    name_locations(recipe, module, "bagassets.definitions")
    report, runs = build(recipe, monkeypatch)
    assert report.succeeded
    assert runs
    assert "bag" in recorded(recipe)[1]
