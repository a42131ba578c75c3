"""What an asset's face says is shown wherever people look: in the web UI, in the table of a build, in reports."""

import io
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest
from rich.console import Console

from bagassets.assets.asset import Asset, Use
from bagassets.assets.face import Face, Loss, Picture, Table
from bagassets.base.plugins import Extension
from bagassets.cli.status import _table
from bagassets.cli.summary import print_summary
from bagassets.defs.graph.location import build_definitions
from bagassets.defs.records.reporting import result_metadata
from bagassets.engine.build_report import BagOutcome, BuildReport
from bagassets.engine.execute import AssetResult
from bagassets.engine.plan import AssetState, BagPlan, Plan
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.engine.run_action import run_action
from bagassets.engine.summary_rows import summary_rows
from bagassets.formats import catalogue, foreign, report_data
from bagassets.recipe import load_recipe
from bagassets.report.page import report_page
from bagassets.store.store import Store
from bagassets_tests.in_process import make_project
from bagassets_tests.recording_build import ASSETS

pytestmark = pytest.mark.once

SUMMARY = {"counts": {"doors": 3}, "kept": "well", "lost": {"ajar": 1}}

DOORS = Asset(
    name="front_doors",
    version=1,
    title="The doors that the recording passes.",
    kinds=frozenset({"json"}),
    optional=True,
    params=lambda _recipe, _rig: {},
    use=lambda _params, _facts: {"": Use({})},
    make=lambda _use, _inputs, _out: dict(SUMMARY),
    face=Face(
        columns=pa.schema({"width_m": pa.float64()}),
        shown=lambda artifact: {
            "widths": Table(("door", "width (m)"), [("left", 0.8), ("right", 0.9)]),
            "kept": artifact.summary()["kept"],
        },
        counts={"doors": lambda summary: summary.get("counts", {}).get("doors")},
        losses=lambda summary: [
            Loss("/door", reason, number, "box") for reason, number in summary.get("lost", {}).items()
        ],
        pictures=lambda _artifact: [Picture("door", "A door", "door.jpg", "inline/door.jpg")],
        thumbnail="tiny.jpg",
        heading="door",
        operation="find_doors",
    ),
)


@pytest.fixture
def made(tmp_path):
    """A store, the artifact of the asset, and a plan in which it is the only one that a recording has."""
    store = Store(tmp_path / "store")

    def make(out):
        for name in ("door.jpg", "inline/door.jpg", "tiny.jpg"):
            out.write(name, b"\xff\xd8")
        out.write_json("inventory.json", {})
        return dict(SUMMARY)

    artifact = run_action(store, DOORS.action(Use({}), None), make).artifact
    states = {name: AssetState("fresh", "") for name in ("bag", *ASSETS.names)}
    states |= {DOORS.name: AssetState("fresh", "", artifact.digest)}
    return store, artifact, Plan({"a": BagPlan("a", states, "mcap", rig="car")}, {}, ())


@pytest.fixture
def assets():
    return RecordingAssets(ASSETS.recipe, (*catalogue.OUR_ASSETS, DOORS))


def test_the_web_ui_shows_tables_numbers_and_pictures(made):
    _, artifact, _ = made
    found = result_metadata(AssetResult(DOORS.name, artifact, "0" * 64, False, 1.0), DOORS.face)
    assert list(found)[:4] == ["picture_door", "thumbnail", "widths", "kept"]
    assert found["widths"].value.splitlines() == [
        "| door | width (m) |", "| --- | --: |", "| left | 0.8 |", "| right | 0.9 |"
    ]  # fmt: skip
    assert found["picture_door"].value.startswith("[![](/bagassets/artifacts/")
    assert found["picture_door"].value.endswith(' "A door")')


def test_without_a_face_the_summary_is_shown(made):
    _, artifact, _ = made
    found = result_metadata(AssetResult("x", artifact, "0" * 64, False, 1.0), Face())
    assert found["kept"] == "well"
    assert found["lost"].value == "|  |  |\n| --- | --: |\n| ajar | 1 |"


def test_a_build_has_a_column_of_what_it_counts_and_says_what_it_lost(made, assets):
    store, _, plan = made
    report = BuildReport(plan, outcomes={"a": BagOutcome("built")})
    assets.store = store
    (row,) = rows = summary_rows(report, assets)
    assert (row.counts["doors"], row.lost) == (3, {"/door": {"ajar": 1}})
    stream = io.StringIO()
    print_summary(report, rows, Path("/p/recipe.yaml"), Console(file=stream, width=120))
    assert "keyframes doors result" in stream.getvalue()


@pytest.mark.parametrize("asset", catalogue.known_assets(), ids=lambda asset: asset.name)
def test_a_recording_that_lacks_an_asset_has_nothing_of_it(asset):
    assert {count({}) for count in asset.face.counts.values()} <= {None}
    assert not list(asset.face.losses({}))


def test_status_has_a_short_heading_for_it(monkeypatch):
    monkeypatch.setattr(catalogue, "known_assets", lambda: (*catalogue.OUR_ASSETS, DOORS))
    rows = [("a", {"inventory": "fresh", "ego_poses": "fresh", DOORS.name: "fresh"})]
    assert [str(one.header) for one in _table(rows, short=True).columns][1:] == ["invent.", "poses", "door"]


def test_a_report_counts_it_and_shows_what_it_lost_and_its_pictures(made, assets, tmp_path):
    store, artifact, plan = made
    (bag,) = plan.bags.values()
    assets.store = store
    shown = report_data._shown(assets, bag)
    assert shown["counts"] == {"doors": 3}
    assert shown["lost"] == ["/door: 1 box lost, ajar"]
    assert shown["pictures"] == {"A door": artifact.path("inline/door.jpg")}
    assert (shown["thumbnail"], shown["full_pictures"]) == (artifact.path("tiny.jpg"), artifact.files)
    facts = report_data.RecordingFacts("a", "ready", size=1, **shown)
    page = report_page(report_data.ReportData("yard", tmp_path, [facts], counted=assets.counted))
    assert '<th class="n">doors</th>' in page
    assert "<b>3</b><span>doors</span>" in page
    assert "/door: 1 box lost, ajar" in page


def test_dagster_shows_its_columns_and_calls_its_operation_as_it_says(tmp_path, monkeypatch):
    project = make_project(tmp_path)
    assets = RecordingAssets(load_recipe(project), (*catalogue.OUR_ASSETS, DOORS))
    monkeypatch.setattr("bagassets.defs.graph.assets.recording_assets", lambda _recipe: assets)
    graph = build_definitions(project).get_repository_def().asset_graph
    by_name = {key.to_user_string(): graph.get(key) for key in graph.get_all_asset_keys()}
    (column,) = by_name[DOORS.name].metadata["dagster/column_schema"].value.columns
    assert (column.name, column.type) == ("width_m", "double")
    operations = {node.assets_def.op.name for node in by_name.values() if node.is_materializable}
    assert {"find_doors", "tables"} <= operations


def test_what_a_face_of_a_package_raises_is_shown_and_costs_nothing_else(made):

    def broken(_):
        raise ZeroDivisionError("no doors")

    entry = Extension("front_doors", "doors", "1.0", "doors:DOORS")
    face = replace(DOORS.face, shown=broken, counts={"doors": broken}, losses=broken, pictures=broken)
    guarded = foreign._guarded(replace(DOORS, face=face), entry)
    store, artifact, plan = made
    assets = RecordingAssets(ASSETS.recipe, (*catalogue.OUR_ASSETS, guarded))
    assets.store = store
    rows = summary_rows(BuildReport(plan, outcomes={"a": BagOutcome("built")}), assets)
    assert (rows[0].counts["doors"], rows[0].lost) == (None, {})
    found = result_metadata(AssetResult(DOORS.name, artifact, "0" * 64, False, 1.0), guarded.face)
    assert found["problem"] == (
        "front_doors of doors 1.0 cannot be used: the face of its asset front_doors raised ZeroDivisionError: no doors; fix, "
        "upgrade or uninstall that package."
    )
    assert found["kept"] == "well"
