"""Recordings that go while a backfill of Dagster's targets them: their partitions stay until it has ended."""

import time

import dagster as dg
import pytest
from click.testing import CliRunner
from dagster._core.execution.backfill import BulkActionStatus, PartitionBackfill

from bagassets.cli.main import root
from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.graph.location import build_definitions
from bagassets.defs.graph.sensor_cursor import Cursor
from bagassets.defs.graph.sensor_scan import Scan
from bagassets.defs.records.events import Records
from bagassets.defs.records.naming import Naming
from bagassets_tests.in_process import build, make_project, survey

GONE, OTHER, KEPT = "a.bag", "b.bag", "c.bag"
WAITS = f"{GONE} is gone: its partition is removed once backfill everything, which targets it, has ended"


@pytest.fixture
def project(tmp_path, monkeypatch):
    """Three recordings that were built, and a backfill of two; then one of these goes, and the third."""
    recipe_file = make_project(tmp_path, (GONE, OTHER, KEPT))
    build(recipe_file, monkeypatch)
    graph = build_definitions(recipe_file).resolve_asset_graph()
    with open_project(recipe_file) as workspace:
        instance = workspace.instance
        instance.add_backfill(
            PartitionBackfill.from_asset_partitions(
                backfill_id="everything",
                asset_graph=graph,
                partition_names=[GONE, KEPT],
                asset_selection=[dg.AssetKey(name) for name in ("bag", "inventory", "nuscenes_dataset")],
                backfill_timestamp=time.time(),
                tags={},
                dynamic_partitions_store=instance,
                all_partitions=False,
                title=None,
                description=None,
                run_config=None,
            )
        )
    for key in (GONE, OTHER):
        (tmp_path / "bags" / key).unlink()
    return recipe_file


def registered(recipe_file):
    with open_project(recipe_file) as workspace:
        instance = workspace.instance
        return Records(instance, Naming("test")).live()


def end(recipe_file):
    with open_project(recipe_file) as workspace:
        instance = workspace.instance
        backfill = instance.get_backfill("everything")
        instance.update_backfill(backfill.with_status(BulkActionStatus.COMPLETED_FAILED))


def test_a_build_leaves_it_and_says_so_until_the_backfill_has_ended(project, monkeypatch):
    for command in (["status"], ["build", "-n"]):
        said = CliRunner().invoke(root, [*command, "--recipe", str(project)]).stdout
        assert "its partition is removed once backfill everything, which targets it, has ended" in said
    report, _ = build(project, monkeypatch)
    assert report.removed == (OTHER,)
    assert [remark.problem for remark in report.remarks] == [f"{WAITS}."]
    assert registered(project) == {GONE, KEPT}
    pending = survey(project)
    assert not pending.is_settled
    end(project)
    report, _ = build(project, monkeypatch)
    assert (report.removed, report.remarks) == ((GONE,), ())
    assert registered(project) == {KEPT}
    assert survey(project).is_settled


@pytest.mark.once
def test_so_does_the_sensor(project):
    def scan(now_s):
        with open_project(project) as workspace:
            found = Scan(workspace, Cursor.parse(cursor.text()))
            found.scan(now_s)
        return found.cursor

    cursor = Cursor()
    for second in (1.0, 2.0):
        cursor = scan(second)
        assert registered(project) == {GONE, KEPT}
        assert WAITS in cursor.said
    end(project)
    cursor = scan(3.0)
    assert registered(project) == {KEPT}
    assert WAITS not in cursor.said
