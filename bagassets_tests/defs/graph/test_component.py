"""The Dagster component: a project as YAML in somebody's code location."""

import importlib.metadata

import dagster as dg
import pytest
import yaml
from dagster.components.testing import create_defs_folder_sandbox

import bagassets
from bagassets.base.errors import RecipeError
from bagassets_tests.small_drive import RECIPE, write_drive

TYPE = "bagassets.RecordingDatasets"


@pytest.fixture
def sandbox(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with create_defs_folder_sandbox() as found:
        yield found


def scaffolded(sandbox, name, attributes):
    """Write a component with a recipe and a recording beside it."""
    folder = sandbox.scaffold_component(
        component_cls=bagassets.RecordingDatasets,
        defs_path=name,
        defs_yaml_contents={"type": TYPE, "attributes": attributes},
    )
    write_drive(folder / "bags" / "a.bag", "ros1", duration_s=1.0)
    return folder


def keys(definitions):
    return {key.to_user_string() for key in definitions.resolve_asset_graph().get_all_asset_keys()}


def test_two_components_with_a_recipe_each_share_a_code_location(sandbox):
    north = scaffolded(sandbox, "north", {"recipe": "recipe.yaml", "key_prefix": "north"})
    (north / "recipe.yaml").write_text(RECIPE.format(name="north", root="bags"))
    inline = yaml.safe_load(RECIPE.format(name="south", root="bags"))
    south = scaffolded(
        sandbox, "south", {"recipe": inline, "key_prefix": ["lab", "south"], "group_name": "drives"}
    )
    with sandbox.build_all_defs() as definitions:
        check_two(definitions)
    assert (south / ".bagassets" / "recipe.yaml").is_file()


def check_two(definitions):
    assert {"north/frames", "lab/south/frames", "north/nuscenes_dataset"} <= keys(definitions)
    assert (
        definitions.resolve_asset_graph().get(dg.AssetKey(["lab", "south", "frames"])).group_name == "drives"
    )
    with dg.DagsterInstance.ephemeral() as instance:
        instance.add_dynamic_partitions("lab/south/south_recordings", ["a.bag"])
        job = definitions.resolve_implicit_global_asset_job_def()
        selection = [dg.AssetKey(["lab", "south", name]) for name in ("bag", "inventory")]
        assert job.execute_in_process(
            partition_key="a.bag", instance=instance, asset_selection=selection
        ).success


def test_without_a_recipe_it_says_what_to_write_and_where(sandbox):
    folder = scaffolded(sandbox, "north", {})
    with pytest.raises(Exception, match="north") as raised, sandbox.build_all_defs() as definitions:
        keys(definitions)
    causes = [raised.value]
    while causes[-1].__cause__ is not None:
        causes.append(causes[-1].__cause__)
    (ours,) = [one for one in causes if isinstance(one, RecipeError)]
    assert str(ours).startswith(f"{folder / 'defs.yaml'}: attributes.recipe is missing")


@pytest.mark.parametrize(
    ("text", "said"), [(None, "recipe.yaml: no recipe here"), ("name: [", "recipe.yaml:1: the recipe is not valid YAML")]
)  # fmt: skip
def test_a_recipe_that_is_missing_or_broken_is_named_and_nothing_else(sandbox, text, said):
    folder = scaffolded(sandbox, "north", {"recipe": "recipe.yaml"})
    if text is not None:
        (folder / "recipe.yaml").write_text(text)
    with pytest.raises(Exception, match="north") as raised, sandbox.build_all_defs() as definitions:
        keys(definitions)
    ours = raised.value
    while not isinstance(ours, RecipeError):
        ours = ours.__cause__
    assert str(ours).startswith(str(folder / said))
    assert ours.__cause__ is None
    assert ours.__suppress_context__


def test_what_is_scaffolded_names_the_recipe_and_loads(sandbox):
    folder = sandbox.scaffold_component(
        component_cls=bagassets.RecordingDatasets,
        defs_path="drives",
        scaffold_params={"recipe": "../drives.yaml", "key_prefix": "north"},
    )
    written = yaml.safe_load((folder / "defs.yaml").read_text())
    assert written["attributes"] == {"recipe": "../drives.yaml", "key_prefix": "north"}
    (folder.parent / "drives.yaml").write_text(RECIPE.format(name="test", root="."))
    with sandbox.build_all_defs() as definitions:
        assert "north/frames" in keys(definitions)


def test_dg_finds_it():
    (entry,) = [
        one
        for one in importlib.metadata.entry_points(group="dagster_dg_cli.registry_modules")
        if one.value == "bagassets"
    ]
    assert "RecordingDatasets" in dir(entry.load())
