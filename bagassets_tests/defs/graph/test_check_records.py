"""Checks that passed, recorded together: Dagster reads from them what it reads from its own records."""

import time
from uuid import uuid4

import dagster as dg
import pytest
from dagster._core.definitions.asset_checks.asset_check_evaluation import (
    AssetCheckEvaluationTargetMaterializationData,
)

from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.recorder import record_passed
from bagassets_tests.in_process import make_project
from bagassets_tests.postgres_server import PROGRAMS, running_postgres, use_postgres

KEY = dg.AssetKey(["robot", "inventory"])
NAMES = ["stamps_monotonic", "topic_rates", "välid"]
OURS, THEIRS = "0b8f9f4e-5f0a-4f5c-9a53-3d7c5f1d2a11", "5d0e8a7c-1d9b-4f7e-8c83-6a2f0d4b7e22"
PARTITION = "tour/ä.bag"
NOW_S = time.time()


@pytest.fixture(scope="module")
def server():
    if PROGRAMS is None:
        pytest.skip("PostgreSQL is not installed")
    with running_postgres() as server:
        yield server


@pytest.fixture(params=["sqlite", "postgres"])
def storage(request, tmp_path):
    recipe_file = make_project(tmp_path / "p", ())
    if request.param == "postgres":
        server, name = request.getfixturevalue("server"), f"t{uuid4().hex}"
        server.create_database(name)
        use_postgres(recipe_file, server.url_of(name))
    with open_instance(str(recipe_file.parent)) as instance:
        yield instance.event_log_storage


def entry(run_id, name, partition=PARTITION, facts=0.5):
    evaluation = dg.AssetCheckEvaluation(
        asset_key=KEY,
        check_name=name,
        passed=True,
        metadata={"facts": {"rate_hz": facts, "absent": None}, "problems": 0},
        severity=dg.AssetCheckSeverity.WARN,
        partition=partition,
        target_materialization_data=AssetCheckEvaluationTargetMaterializationData(
            storage_id=7, run_id=run_id, timestamp=NOW_S - 1.25
        ),
    )
    event = dg.DagsterEvent(
        dg.DagsterEventType.ASSET_CHECK_EVALUATION.value,
        job_name="job",
        step_key="op",
        event_specific_data=evaluation,
    )
    return dg.EventLogEntry(None, 10, "", run_id, NOW_S, step_key="op", job_name="job", dagster_event=event)


def history(storage, name):
    """Run id -> (status, the event without what differs between runs, materialization), as the web UI looks it up."""
    found = storage.get_asset_check_execution_history(dg.AssetCheckKey(KEY, name), limit=10)
    assert len({record.run_id for record in found}) == len(found)
    return {record.run_id: record for record in found}


@pytest.mark.parametrize("partition", [PARTITION, None], ids=["of a recording", "of a dataset"])
def test_dagster_reads_what_it_would_have_recorded(storage, partition):
    ours = [entry(OURS, name, partition) for name in NAMES]
    theirs = [entry(THEIRS, name, partition) for name in NAMES]
    record_passed(storage, ours)
    for each in theirs:
        storage.store_event(each)
    for name, expected, stored in zip(NAMES, ours, theirs, strict=True):
        found = history(storage, name)
        assert found[OURS].event == expected
        assert found[THEIRS].event == stored
        assert found[OURS].status == found[THEIRS].status
        assert found[OURS].partition == found[THEIRS].partition == partition
        assert found[OURS].evaluation.target_materialization_data.storage_id == 7
    assert storage.get_logs_for_run(OURS) == []
    assert _columns(storage, OURS) == _columns(storage, THEIRS)


def test_dagster_finds_the_partitions_of_which_they_passed(storage):
    storage.store_event(entry(THEIRS, NAMES[0], "other.bag"))
    after = storage.get_maximum_record_id()
    storage.store_event(entry(THEIRS, NAMES[1], "other.bag"))
    record_passed(storage, [entry(OURS, NAMES[0])])
    keys = [dg.AssetCheckKey(KEY, NAMES[0])]
    every, new = (
        {info.partition_key: info for info in storage.get_asset_check_partition_info(keys, since)}
        for since in (None, after)
    )
    assert every.keys() == {"other.bag", PARTITION}
    assert new.keys() == {PARTITION}
    assert len({info.latest_execution_status for info in every.values()}) == 1
    assert {info.latest_target_materialization_storage_id for info in every.values()} == {7}


@pytest.mark.parametrize("partition", [PARTITION, None], ids=["of a recording", "of a dataset"])
def test_a_run_that_records_a_check_again_corrects_it(storage, partition):
    record_passed(storage, [entry(OURS, NAMES[0], partition)])
    record_passed(
        storage, [entry(OURS, NAMES[1], partition, facts=1.0), entry(OURS, NAMES[0], partition, facts=2.0)]
    )
    for name, rate_hz in ((NAMES[0], 2.0), (NAMES[1], 1.0)):
        (record,) = history(storage, name).values()
        assert record.evaluation.metadata["facts"].value["rate_hz"] == rate_hz


def test_no_checks_are_no_statement(storage):
    record_passed(storage, [])


def _columns(storage, run_id):
    """Return what is in the table about a run, but for ids of rows and events, the time of recording, and the event."""
    from dagster._core.storage.event_log.schema import AssetCheckExecutionsTable as Table

    columns = [
        column
        for column in Table.c
        if column.name
        not in {"id", "run_id", "create_timestamp", "evaluation_event", "evaluation_event_storage_id"}
    ]
    with storage.index_connection() as connection:
        found = connection.execute(
            Table.select().with_only_columns(*columns).where(Table.c.run_id == run_id)
        ).fetchall()
    return sorted(tuple(row) for row in found)
