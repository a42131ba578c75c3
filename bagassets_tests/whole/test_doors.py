"""The same folder through each door: the command, the sensor, Dagster's command and the web UI have one result."""

import json
from contextlib import contextmanager, suppress
from urllib.request import Request, urlopen

import dagster as dg
import pytest

from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.graph.location import build_definitions
from bagassets.defs.graph.sensor_cursor import Cursor
from bagassets.defs.graph.sensor_scan import Scan
from bagassets.defs.records.events import Records
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import add_partitions
from bagassets_tests.doors import (
    ALL,
    GOOD,
    KEYS,
    LOST,
    RECIPE,
    SHORT,
    TORN,
    make_door,
    result,
    write_recordings,
)
from bagassets_tests.in_process import build
from bagassets_tests.services import BIN, eventually, free_port, running
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once


def by_command(recipe_file, monkeypatch):
    build(recipe_file, monkeypatch, jobs=1)


def by_sensor(recipe_file, _monkeypatch):
    """Do what the daemon does: ask the sensor until it has nothing to request, and execute what it requests."""
    definitions, cursor = build_definitions(recipe_file), Cursor()
    for second in range(6):
        with open_project(recipe_file) as workspace:
            instance = workspace.instance
            scan = Scan(workspace, cursor)
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


def by_partition(recipe_file, _monkeypatch, keys=KEYS):
    """Do what `dagster asset materialize --select '*' --partition KEY` does for each, then `--select 'dataset_inputs*'`."""
    job = build_definitions(recipe_file).resolve_implicit_global_asset_job_def()
    with open_project(recipe_file) as workspace:
        instance = workspace.instance
        add_partitions(Records(instance, Naming("test")), sorted(keys))
        for key in sorted(keys):
            job.execute_in_process(partition_key=key, instance=instance, raise_on_error=False)
        datasets = (
            dg.AssetSelection.assets("dataset_inputs").downstream().resolve(job.asset_layer.asset_graph)
        )
        assert job.execute_in_process(instance=instance, asset_selection=sorted(datasets)).success


def by_range(recipe_file, _monkeypatch):
    """Do what a backfill does: runs of ranges, and then of the datasets."""
    job = build_definitions(recipe_file).resolve_implicit_global_asset_job_def()
    graph = job.asset_layer.asset_graph
    keys = sorted(KEYS)
    with open_project(recipe_file) as workspace:
        instance = workspace.instance
        add_partitions(Records(instance, Naming("test")), keys)
        for first, last in ((keys[0], keys[3]), (keys[4], keys[-1])):
            ends = {"dagster/asset_partition_range_start": first, "dagster/asset_partition_range_end": last}
            chosen = sorted(dg.AssetSelection.groups("recording").resolve(graph))
            job.execute_in_process(tags=ends, instance=instance, asset_selection=chosen, raise_on_error=False)
        datasets = sorted(dg.AssetSelection.assets("dataset_inputs").downstream().resolve(graph))
        assert job.execute_in_process(instance=instance, asset_selection=datasets).success


def by_whole_range(recipe_file, _monkeypatch):
    """Do what `dagster asset materialize --select '*' --partition-range FIRST...LAST` does: all is one run."""
    job = build_definitions(recipe_file).resolve_implicit_global_asset_job_def()
    with open_project(recipe_file) as workspace:
        instance = workspace.instance
        add_partitions(workspace.records, sorted(KEYS))
        ends = {
            "dagster/asset_partition_range_start": min(KEYS),
            "dagster/asset_partition_range_end": max(KEYS),
        }
        chosen = sorted(job.asset_layer.asset_graph.materializable_asset_keys)
        job.execute_in_process(tags=ends, instance=instance, asset_selection=chosen, raise_on_error=False)
        assert instance.get_runs_count() == 1


def dataset_checks(recipe_file):
    """Return the states of the checks of what exists once, as Dagster keeps them."""
    graph = build_definitions(recipe_file).resolve_asset_graph()
    found = [key for key in graph.asset_check_keys if not graph.get(key.asset_key).is_partitioned]
    with open_project(recipe_file) as workspace:
        latest = workspace.instance.event_log_storage.get_latest_asset_check_execution_by_key(found)
    return {key.to_user_string(): record.status.value for key, record in latest.items()}


def differences(found, expected):
    return {part: (found[part], value) for part, value in expected.items() if found[part] != value}


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("doors") / "bags"
    write_recordings(folder)
    return folder


def test_the_doors_have_one_result(bags, tmp_path, monkeypatch):
    found = {}
    for door in (by_command, by_sensor, by_partition, by_range, by_whole_range):
        recipe_file = make_door(tmp_path / door.__name__, bags)
        door(recipe_file, monkeypatch)
        found[door.__name__] = {**result(recipe_file), "checks": dataset_checks(recipe_file)}
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
        assert differences(other, expected) == {}, door


def test_what_reads_nothing_of_what_failed_is_made(tmp_path, monkeypatch):
    """Dagster begins no step after one that failed: that of all extracted assets, where only clouds cannot be deskewed."""
    write_drive(tmp_path / "bags" / GOOD, "ros1", duration_s=1.0)
    text = RECIPE.replace("topic: /points}}", "topic: /points, deskew: true}}") + "vision: {{}}\n"
    whole, steps = (make_door(tmp_path / name, tmp_path / "bags", text) for name in ("whole", "steps"))
    by_command(whole, monkeypatch)
    by_partition(steps, monkeypatch, {GOOD})
    expected, found = result(whole), result(steps)
    assert (
        expected["shown"]["sweeps"]
        == expected["shown"]["nuscenes_tables"]
        == {"made": set(), "failed": {GOOD}}
    )
    assert expected["shown"]["vision_sequences"] == {"made": {GOOD}, "failed": set()}
    assert differences(found, expected) == {}


def test_a_click_on_the_dataset_alone_takes_all_recordings_and_says_so(tmp_path):
    """What is recorded of its inputs is older: of no recording, or of fewer."""
    recipe_file = make_door(tmp_path / "project", tmp_path / "bags")
    job = build_definitions(recipe_file).resolve_implicit_global_asset_job_def()
    for number, name in enumerate((GOOD, SHORT)):
        write_drive(tmp_path / "bags" / name, "ros1", duration_s=1.0 + 0.1 * number)
        with open_project(recipe_file) as workspace:
            instance = workspace.instance
            add_partitions(Records(instance, Naming("test")), [name])
            recording = dg.AssetSelection.assets("nuscenes_tables").upstream()
            for selection, key in ((recording, name), (dg.AssetSelection.assets("nuscenes_dataset"), None)):
                chosen = sorted(selection.resolve(job.asset_layer.asset_graph))
                assert job.execute_in_process(
                    partition_key=key, instance=instance, asset_selection=chosen
                ).success
        assert result(recipe_file)["dataset is current"]


# --- with Dagster's own programs -----------------------------------------------------------

BACKFILL = """mutation($names: [String!], $assets: [AssetKeyInput!]) {
  launchPartitionBackfill(backfillParams: {partitionNames: $names, assetSelection: $assets, fromFailure: false}) {
    __typename ... on LaunchBackfillSuccess { backfillId } ... on PythonError { message }
  } }"""
STATUS = "query($id: String!) { partitionBackfillOrError(backfillId: $id) { ... on PartitionBackfill { status } } }"
ENDED = {"COMPLETED_SUCCESS", "COMPLETED_FAILED", "FAILED", "CANCELED"}
WITHIN_S = 240


def ask(port, query, **variables):
    body = json.dumps({"query": query, "variables": variables}).encode()
    request = Request(f"http://127.0.0.1:{port}/graphql", body, {"Content-Type": "application/json"})
    with urlopen(request, timeout=60) as answer:
        found = json.load(answer)
    assert "errors" not in found, found
    return found["data"]


def is_answering(port):
    with suppress(OSError):
        return bool(ask(port, "{ version }"))
    return False


def stop_sensor(port):
    where = 'repositoryName: "__repository__", repositoryLocationName: "bagassets.definitions"'
    selector = f'{{{where}, sensorName: "recordings"}}'
    query = f"{{ sensorOrError(sensorSelector: {selector}) {{ ... on Sensor {{ sensorState {{ id }} }} }} }}"
    state = ask(port, query)["sensorOrError"]["sensorState"]["id"]
    ask(port, f'mutation {{ stopSensor(id: "{state}") {{ __typename }} }}')


def materialize_all(port, keys):
    """Do what *Materialize all…*, *All*, *Launch backfill* do; return how the backfill ended."""
    nodes = ask(port, "{ assetNodes { assetKey { path } isMaterializable } }")["assetNodes"]
    assets = [node["assetKey"] for node in nodes if node["isMaterializable"]]
    launched = ask(port, BACKFILL, names=sorted(keys), assets=assets)["launchPartitionBackfill"]
    backfill = launched["backfillId"]

    def status():
        now = ask(port, STATUS, id=backfill)["partitionBackfillOrError"]["status"]
        return now if now in ENDED else None

    return eventually(status, "the backfill has ended", WITHIN_S)


@contextmanager
def stock_dagster(recipe_file):
    """Run Dagster's own web server and daemon, with the sensor off; yield the port."""
    project, port = recipe_file.parent, free_port()
    server = [BIN / "dagster-webserver", "-w", "workspace.yaml", "-p", port]
    daemon = [BIN / "dagster-daemon", "run", "-w", "workspace.yaml"]
    home = {"DAGSTER_HOME": str(project)}
    with running(server, project, project.parent / "server.log", home):
        eventually(lambda: is_answering(port), "the web server answers")
        stop_sensor(port)
        with running(daemon, project, project.parent / "daemon.log", home):
            yield port


def built_by_command(folder, bags, monkeypatch):
    recipe_file = make_door(folder, bags, ALL)
    by_command(recipe_file, monkeypatch)
    return result(recipe_file)


@pytest.mark.long
def test_a_backfill_of_everything_with_dagsters_own_programs(tmp_path, monkeypatch):
    """With the sensor off, it makes the datasets itself, since a recording that is skipped has not failed."""
    bags = tmp_path / "bags"
    write_recordings(bags, fails=False)
    expected = built_by_command(tmp_path / "command", bags, monkeypatch)
    recipe_file = make_door(tmp_path / "stock", bags, ALL)
    keys = KEYS - {TORN, LOST}
    with open_project(recipe_file) as workspace:
        instance = workspace.instance
        add_partitions(Records(instance, Naming("test")), sorted(keys))
    with stock_dagster(recipe_file) as port:
        assert materialize_all(port, keys) == "COMPLETED_SUCCESS"
        assert differences(result(recipe_file), expected) == {}


@pytest.mark.long
def test_a_backfill_of_everything_in_our_web_ui_beside_the_sensor(bags, tmp_path, monkeypatch):
    """Where something failed, Dagster requests no datasets; the sensor does."""
    expected = built_by_command(tmp_path / "command", bags, monkeypatch)
    recipe_file, port = make_door(tmp_path / "ui", bags, ALL), free_port()
    with open_project(recipe_file) as workspace:
        instance = workspace.instance
        add_partitions(Records(instance, Naming("test")), sorted(KEYS))
    command = [BIN / "bagassets", "ui", "--recipe", recipe_file, "--port", port, "--no-browser"]
    with running(command, tmp_path, tmp_path / "ui.log"):
        eventually(lambda: is_answering(port), "the web server answers")
        assert materialize_all(port, KEYS) == "COMPLETED_FAILED"
        eventually(lambda: result(recipe_file)["dataset is current"], "the sensor has the datasets made")
        assert differences(result(recipe_file), expected) == {}
