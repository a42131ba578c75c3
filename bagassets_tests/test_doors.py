"""The same folder through each door: the command, the sensor, Dagster's command and the web UI have one result."""

import pytest

from bagassets.defs.location import build_definitions
from bagassets.defs.naming import Naming
from bagassets.defs.partitions import add_partitions
from bagassets.defs.pending_work import open_project
from bagassets.defs.sensor_cursor import Cursor
from bagassets.defs.sensor_scan import Scan
from bagassets_tests.doors import KEYS, LOST, SHORT, TORN, make_door, result, write_recordings
from bagassets_tests.in_process import build


def by_command(recipe_file, monkeypatch):
    build(recipe_file, monkeypatch, jobs=1)


def by_sensor(recipe_file, _monkeypatch):
    """Do what the daemon does: ask the sensor until it has nothing to request, and execute what it requests."""
    definitions, cursor = build_definitions(recipe_file), Cursor()
    for second in range(6):
        with open_project(recipe_file) as (instance, workspace):
            scan = Scan(instance, workspace, cursor)
            requests = scan.scan(1e9 + 100 * second)
            cursor = Cursor.parse(scan.cursor.text())
            for request in requests:
                definitions.resolve_job_def(request.job_name).execute_in_process(
                    run_config=request.run_config,
                    partition_key=request.partition_key,
                    instance=instance,
                    asset_selection=request.asset_selection and list(request.asset_selection),
                    raise_on_error=False,
                )
        if not requests:
            return
    raise AssertionError("there is always something to do")


def by_partition(recipe_file, _monkeypatch):
    """Do what `dagster asset materialize --select '*' --partition KEY` does for each, then `--select 'dataset_inputs*'`."""
    job = build_definitions(recipe_file).resolve_implicit_global_asset_job_def()
    with open_project(recipe_file) as (instance, _):
        add_partitions(instance, Naming("test"), sorted(KEYS))
        for key in sorted(KEYS):
            job.execute_in_process(partition_key=key, instance=instance, raise_on_error=False)
        datasets = [key for key in job.asset_layer.executable_asset_keys if "dataset" in key.to_user_string()]
        assert job.execute_in_process(instance=instance, asset_selection=datasets).success


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("doors") / "bags"
    write_recordings(folder)
    return folder


def test_the_doors_have_one_result(bags, tmp_path, monkeypatch):
    found = {}
    for door in (by_command, by_sensor, by_partition):
        recipe_file = make_door(tmp_path / door.__name__, bags)
        door(recipe_file, monkeypatch)
        found[door.__name__] = result(recipe_file)
    expected = found["by_command"]
    assert expected["dataset"]
    assert expected["dataset is current"]
    assert expected["registered"] == KEYS
    assert set(expected["states"][SHORT].values()) == {"fresh", "skipped"}
    assert {name: shown["failed"] for name, shown in expected["shown"].items()}["nuscenes_tables"] == {
        TORN,
        LOST,
    }
    assert expected["shown"]["nuscenes_tables"]["made"] == KEYS - {TORN, LOST}
    for door, other in found.items():
        for part, value in expected.items():
            assert other[part] == value, f"{door}: {part}"
