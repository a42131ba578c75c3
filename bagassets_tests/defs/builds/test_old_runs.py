"""`bagassets gc --keep-runs-days`: what no current record is from goes from Dagster's database, and nothing else does."""

import json
import shutil
import sqlite3
from contextlib import closing

import dagster as dg
import pytest
from click.testing import CliRunner

from bagassets.cli.main import root as command_line
from bagassets.defs.records.events import event_database
from bagassets.defs.records.instances import open_instance
from bagassets.defs.runs.execution import create_run
from bagassets.engine.batches import DATASET
from bagassets_tests.in_process import build, keys_of, make_project, survey
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

KEYS = ("a.bag", "b.mcap")


@pytest.fixture
def project(tmp_path, monkeypatch):
    """Built three times: twice `a.bag` was another; the last time it was damaged."""
    recipe_file = make_project(tmp_path / "p", KEYS)
    build(recipe_file, monkeypatch)
    damaged = recipe_file.parent / "bags/a.bag"
    damaged.unlink()
    write_drive(damaged, "ros1", duration_s=2.0)
    build(recipe_file, monkeypatch)
    damaged.write_bytes(damaged.read_bytes()[:100])
    build(recipe_file, monkeypatch)
    return recipe_file


def collect(recipe_file, *options):
    done = CliRunner().invoke(
        command_line, ["gc", "--recipe", str(recipe_file), "--json", *options], standalone_mode=False
    )
    assert done.exception is None, done.output
    return json.loads(done.stdout)["runs"]


def runs_of(recipe_file):
    """Run id -> what it is about, the newest first."""
    with open_instance(str(recipe_file.parent)) as instance:
        return {run.run_id: keys_of(run) for run in instance.get_runs()}


def database_size(recipe_file):
    """Bytes of the events, read back from the write-ahead log first."""
    with open_instance(str(recipe_file.parent)) as instance:
        path = event_database(instance)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    return path.stat().st_size


def test_superseded_runs_go_and_nothing_is_to_be_done_because_of_that(project, monkeypatch):
    before = runs_of(project)
    of_a = [run_id for run_id, keys in before.items() if "a.bag" in keys]
    of_datasets = [run_id for run_id, keys in before.items() if DATASET in keys]
    assert (len(of_a), len(of_datasets)) == (3, 3)
    assert of_a[:2] == of_datasets[:2], "a change of one recording is one run"
    # The latest images of `a.bag` are from the second build, though the dataset is from the third.
    old = {of_a[2], of_datasets[2]}
    assert set(collect(project, "--keep-runs-days", "0", "--dry-run")) == old
    assert collect(project, "--keep-runs-days", "1") == []
    assert collect(project) == [], "only if asked"
    assert runs_of(project) == before
    size = database_size(project)
    assert set(collect(project, "--keep-runs-days", "0")) == old
    assert runs_of(project).keys() == before.keys() - old
    assert database_size(project) < 0.8 * size, "the disk space is given back"
    report, runs = build(project, monkeypatch)
    assert runs == []
    assert report.outcomes["a.bag"].result == "failed", "the run that says why is still there"


def test_runs_with_a_database_of_their_own_lose_it(project):
    """As a project of before has them."""
    (*_, oldest) = (run_id for run_id, keys in runs_of(project).items() if "a.bag" in keys)
    with open_instance(str(project.parent)) as instance:
        own = event_database(instance).with_name(f"{oldest}.db")
        shutil.copy(event_database(instance), own)
    assert oldest in collect(project, "--keep-runs-days", "0")
    assert not own.exists()


def test_runs_of_others_and_those_at_work_stay(project, monkeypatch):
    @dg.asset
    def training():
        pass

    monkeypatch.setenv("BAGASSETS_RECIPE", str(project))
    with open_instance(str(project.parent)) as instance:
        others = {dg.materialize([training], instance=instance).run_id for _ in range(2)}
        others |= {create_run(instance, ["bag"], partition_key="b.mcap") for _ in range(2)}
    assert not others & set(collect(project, "--keep-runs-days", "0", "--dry-run"))


def test_a_run_that_is_deleted_by_hand_takes_along_records_of_recordings_and_not_of_datasets(
    tmp_path, monkeypatch
):
    recipe_file = make_project(tmp_path)
    build(recipe_file, monkeypatch, select=("nuscenes_tables",))
    build(recipe_file, monkeypatch)
    dataset = dg.AssetKey("nuscenes_dataset")
    with open_instance(str(recipe_file.parent)) as instance:
        instance.delete_run(instance.get_latest_materialization_event(dataset).run_id)
        assert instance.fetch_materializations(dataset, limit=1).records == []
        assert instance.get_latest_materialization_event(dataset) is not None, (
            "Dagster keeps it with the asset"
        )
    assert survey(recipe_file).is_settled
    assert build(recipe_file, monkeypatch)[1] == []
    with open_instance(str(recipe_file.parent)) as instance:
        for run in instance.get_runs():
            instance.delete_run(run.run_id)
    assert "bag" in dict(build(recipe_file, monkeypatch)[1])["a.bag"], "recorded again"
