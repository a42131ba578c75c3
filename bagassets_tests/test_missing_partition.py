"""`dagster asset materialize` and `dg launch --assets` of recordings, without saying which."""

import sys

import click
import dagster as dg
import pytest
from click.testing import CliRunner
from dagster._cli import asset
from dagster_shared.cli import python_pointer_options

from bagassets.defs import build_definitions
from bagassets_tests.in_process import QUICK
from bagassets_tests.small_drive import write_drive

MODULE = """
from pathlib import Path

import dagster as dg

from bagassets.defs import build_definitions, per_recording, recipe_beside
from bagassets.recipe import load_recipe

NORTH = Path(__file__).parent / "north" / "recipe.yaml"


@dg.asset(partitions_def=per_recording(load_recipe(NORTH), key_prefix="north"))
def blur(): ...


@dg.asset
def other(): ...


@dg.asset(partitions_def=dg.StaticPartitionsDefinition(["1", "2"]))
def folds(): ...


defs = dg.Definitions.merge(
    *(build_definitions(NORTH.parent.parent / name / "recipe.yaml", key_prefix=name) for name in ("north", "south")),
    dg.Definitions(assets=[blur, other, folds], executor=dg.in_process_executor),
)
"""


@click.command(name="launch")
@click.option("--assets")
@click.option("--partition")
@click.option("--partition-range")
@python_pointer_options
def launch(assets, partition, partition_range, **where):
    """As `dg launch` calls it, which comes with another package."""
    asset.asset_materialize_command_impl(assets, partition, partition_range, (), None, **where)


WAYS = {
    "dagster asset materialize": (asset.asset_materialize_command, "--select"),
    "dg launch": (launch, "--assets"),
}


@pytest.fixture
def place(tmp_path, monkeypatch):
    for name in ("north", "south"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "recipe.yaml").write_text(QUICK.format(name="drives", root="bags"))
    write_drive(tmp_path / "north" / "bags" / "a.bag", "ros1", duration_s=1.0)
    (tmp_path / "asked_drives.py").write_text(MODULE)
    (tmp_path / "dagster.yaml").write_text("telemetry: {enabled: false}\n")
    monkeypatch.setenv("DAGSTER_HOME", str(tmp_path))
    monkeypatch.delitem(sys.modules, "asked_drives", raising=False)
    monkeypatch.setattr(asset, "AssetSelection", dg.AssetSelection)  # put back in the end
    return tmp_path


def ask(place, way, select, *options):
    command, option = WAYS[way]
    return CliRunner().invoke(command, ["-m", "asked_drives", "-d", str(place), option, select, *options])


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("select", "said"),
    [
        ("north/frames", "north/frames: made per recording, so add --partition KEY, as in --partition a.bag."),
        (
            'key:"north/*"',
            "north/annotations, north/bag and 6 more: made per recording, so add --partition KEY, as in --partition a.bag.",
        ),
        ("south/bag", "south/bag: made per recording, so add --partition KEY."),
        ("blur", "blur: made per recording, so add --partition KEY, as in --partition a.bag."),
        (
            "north/bag,south/bag",
            "north/bag, south/bag: made per recording, and the selection has assets with other partitions, too; select those of one project, as in --select 'key:\"north/*\"', and add --partition KEY.",
        ),
    ],
)  # fmt: skip
def test_it_says_in_a_sentence_what_to_add(place, way, select, said):
    done = ask(place, way, select)
    assert isinstance(done.exception, SystemExit), done.exception
    assert (done.exit_code, done.stderr.splitlines()[-1]) == (2, f"Error: {said}")


@pytest.mark.parametrize("way", WAYS)
def test_what_is_not_ours_is_left_to_dagster(place, way):
    assert ask(place, way, "other").exit_code == 0
    done = ask(place, way, "folds")
    assert "no '--partition' option was provided" in str(done.exception)


def test_with_a_partition_or_elsewhere_nothing_is_replaced(place):
    assert "no recording with this partition key" in str(
        ask(place, "dg launch", "north/bag", "--partition", "b").exception
    )
    assert asset.AssetSelection is dg.AssetSelection
    build_definitions(place / "north" / "recipe.yaml")
    assert asset.AssetSelection is dg.AssetSelection
    listed = CliRunner().invoke(
        asset.asset_list_command, ["-m", "asked_drives", "-d", str(place), "--select", "north/bag"]
    )
    assert (listed.exit_code, listed.stdout) == (0, "north/bag\n")
    assert asset.AssetSelection is dg.AssetSelection
