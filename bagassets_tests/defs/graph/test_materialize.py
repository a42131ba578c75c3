"""`dagster asset materialize`, as people type it in a project folder: no variables set, a process of its own."""

import json
import subprocess
import time

import dagster as dg
import pytest
from sqlalchemy import Engine, event

from bagassets.base.errors import RecordingError
from bagassets.defs.records.events import Records
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import RecordingPartitions, add_partitions, recording_partitions
from bagassets.defs.runs.exclusive import exclusive
from bagassets.recipe import load_recipe
from bagassets_tests.services import BIN, bare_environment, make_project
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.xdist_group("materialize")


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("materialize")
    write_drive(folder / "bags" / "a.bag", "ros1", duration_s=2.0)
    write_drive(folder / "bags" / "b.mcap", "mcap", duration_s=2.2)
    return make_project(folder)


def materialize(project, select, partition=None, keys=None):
    command = [BIN / "dagster", "asset", "materialize", "-m", "bagassets.definitions", "--select", select]
    command += ["--partition", partition] if partition else []
    command += ["--partition-range", keys] if keys else []
    return subprocess.run(
        [str(part) for part in command],
        check=False,
        cwd=project,
        env=bare_environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )


def latest(project, asset, partition):
    with open_instance(str(project)) as instance:
        records = instance.fetch_materializations(
            dg.AssetRecordsFilter(asset_key=dg.AssetKey(asset), asset_partitions=[partition]), limit=1
        )
        return next((record.asset_materialization for record in records.records), None)


def test_everything_of_a_recording_that_nobody_registered_yet(project):
    done = materialize(project, "*", "a.bag")
    assert done.returncode == 0, done.stderr[-2000:]
    assert latest(project, "nuscenes_tables", "a.bag") is not None
    with open_instance(str(project)) as instance:
        (inputs,) = instance.fetch_materializations(dg.AssetKey("dataset_inputs"), limit=9).records
        assert inputs.run_id, "once, and by the run"
    version = project / "dataset" / "nuscenes" / "v1.0-test"
    assert [bag["key"] for bag in json.loads((version / "dataset.lock.json").read_text())["bags"]] == [
        "a.bag"
    ]
    with open_instance(str(project)) as instance:
        assert instance.get_dynamic_partitions("test_recordings") == ["a.bag"]


@pytest.mark.once
def test_one_asset_of_a_recording_is_a_hit_when_it_is_known(project):
    done = materialize(project, "nuscenes_tables", "a.bag")
    assert done.returncode == 0, done.stderr[-2000:]
    assert latest(project, "nuscenes_tables", "a.bag").metadata["cached"].value is True


@pytest.mark.once
def test_one_asset_without_what_it_reads_says_what_to_materialize_first(project):
    done = materialize(project, "nuscenes_tables", "b.mcap")
    assert done.returncode == 1
    assert "b.mcap: bag is not materialized for this recording" in done.stdout + done.stderr


def test_one_asset_with_all_that_it_reads(project):
    done = materialize(project, "*nuscenes_tables", "b.mcap")
    assert done.returncode == 0, done.stderr[-2000:]
    assert latest(project, "frames", "b.mcap") is not None


def test_a_recording_that_does_not_exist_is_reported_with_one_that_does(project):
    done = materialize(project, "nuscenes_tables", "b.mcpa")
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith("Error: b.mcpa: no recording with this partition key below")
    assert last.endswith("did you mean b.mcap?")
    assert "Traceback" not in done.stderr
    with open_instance(str(project)) as instance:
        assert "b.mcpa" not in instance.get_dynamic_partitions("test_recordings")


@pytest.mark.once
def test_without_a_partition_dagster_says_what_is_missing(project):
    done = materialize(project, "*")
    assert done.returncode == 1
    assert "no '--partition' option was provided" in done.stderr.splitlines()[-1]


@pytest.mark.once
def test_runs_of_one_recording_take_turns_whoever_launched_them(project):
    """A worker that was given up but works on, and the run that took its place, say."""
    locks = load_recipe(project / "recipe.yaml").state / "locks"
    with exclusive(locks, "a.bag", keep_waiting=lambda _asked: False) as held:
        assert held
        command = [BIN / "dagster", "asset", "materialize", "-m", "bagassets.definitions"]
        process = subprocess.Popen(
            [*map(str, command), "--select", "bag,inventory", "--partition", "a.bag"],
            cwd=project, env=bare_environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        seen = ""
        while "Waiting for another run of a.bag to end." not in seen:
            line = process.stdout.readline()
            assert line, seen
            seen += line
        released_s = time.time()
    seen, _ = process.communicate(timeout=120)
    assert process.returncode == 0, seen
    with open_instance(str(project)) as instance:
        for asset in ("bag", "inventory"):
            filters = dg.AssetRecordsFilter(asset_key=dg.AssetKey(asset), asset_partitions=["a.bag"])
            (record,) = instance.fetch_materializations(filters, limit=1).records
            assert record.timestamp >= released_s, f"{asset} was recorded while another run had its turn"


@pytest.mark.once
def test_the_dataset_takes_no_partition(project):
    done = materialize(project, "nuscenes_dataset")
    assert done.returncode == 0, done.stderr[-2000:]


def test_partitions_are_equal_to_plain_ones_of_the_same_name(project):
    recipe = load_recipe(project / "recipe.yaml")
    ours, plain = (
        recording_partitions(recipe.bags, Naming("test")),
        dg.DynamicPartitionsDefinition(name="test_recordings"),
    )
    assert isinstance(ours, RecordingPartitions)
    assert (ours == plain, hash(ours) == hash(plain)) == (True, True)
    assert ours != dg.DynamicPartitionsDefinition(name="other_recordings")


def test_recordings_that_another_process_registers_at_the_same_moment(project):
    """Each time we have seen what is missing and are about to insert it, the other one has inserted one of them."""
    recipe, keys = load_recipe(project / "recipe.yaml"), ["x.bag", "y.bag", "z.bag"]
    left, inserting = list(keys), False

    with open_instance(str(project)) as instance, open_instance(str(project)) as other:

        def be_faster(_connection, _cursor, statement, *_more):
            nonlocal inserting
            if "INSERT INTO dynamic_partitions" in statement and left and not inserting:
                inserting = True
                other.add_dynamic_partitions("test_recordings", [left.pop(0)])
                inserting = False

        event.listen(Engine, "before_cursor_execute", be_faster)
        try:
            add_partitions(Records(instance, Naming(recipe.name)), keys)
        finally:
            event.remove(Engine, "before_cursor_execute", be_faster)
        assert left == []
        assert set(keys) <= set(instance.get_dynamic_partitions("test_recordings"))
        for key in keys:
            instance.delete_dynamic_partition("test_recordings", key)


def test_a_range_of_what_nobody_registered_yet_has_all_that_is_in_it_and_the_dataset(tmp_path):
    keys = ["a.bag", "b.bag", "c.bag"]
    for number, key in enumerate(keys):
        write_drive(tmp_path / "bags" / key, "ros1", duration_s=1.0 + 0.1 * number)
    project = make_project(tmp_path)
    done = materialize(project, "*", keys="a.bag...c.bag")
    assert done.returncode == 0, done.stderr[-2000:]
    assert all(f"{key}: is recorded" in done.stdout + done.stderr for key in keys)
    with open_instance(str(project)) as instance:
        assert instance.get_dynamic_partitions("test_recordings") == keys
        assert len(instance.get_runs()) == 1
    lock = project / "dataset" / "nuscenes" / "v1.0-test" / "dataset.lock.json"
    assert [bag["key"] for bag in json.loads(lock.read_text())["bags"]] == keys
    done = materialize(project, "*", keys="c.bag...a.bag")
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert done.stderr.splitlines()[-1] == (
        "Error: c.bag...a.bag: a.bag was registered before c.bag, so there is nothing in this range; write a.bag...c.bag."
    )


@pytest.mark.once
def test_a_dataset_of_nothing_is_not_written(tmp_path):
    (tmp_path / "bags").mkdir()
    project = make_project(tmp_path)
    done = materialize(project, "nuscenes_dataset")
    assert done.returncode == 1
    assert (
        "nuscenes_dataset: never made, as no recording can be part of it yet; materialize the assets"
        in done.stderr
    )
    assert not (project / "dataset").exists()


def test_a_range_from_its_end_to_its_start_is_no_empty_one(project):
    """Dagster makes nothing of it, and ends well: of assets of the user's own, too."""
    partitions = recording_partitions(load_recipe(project / "recipe.yaml").bags, Naming("range"))

    @dg.asset(partitions_def=partitions, backfill_policy=dg.BackfillPolicy.single_run())
    def own(context: dg.AssetExecutionContext) -> None:
        assert context.partition_keys == ["a.bag", "b.bag"]

    with dg.DagsterInstance.ephemeral() as instance:
        instance.add_dynamic_partitions("range_recordings", ["a.bag", "b.bag"])

        def materialize_range(start, end):
            tags = {"dagster/asset_partition_range_start": start, "dagster/asset_partition_range_end": end}
            return dg.materialize([own], instance=instance, tags=tags)

        assert materialize_range("a.bag", "b.bag").success
        with pytest.raises(
            RecordingError, match=r"a\.bag was registered before b\.bag.*write a\.bag\.\.\.b\.bag"
        ):
            materialize_range("b.bag", "a.bag")
