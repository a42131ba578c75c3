"""Thousands of partitions are registered and removed in a few statements, with SQLite and with PostgreSQL."""

from contextlib import contextmanager

import dagster as dg
import pytest
from sqlalchemy import Engine, event

from bagassets.defs.records.events import Records
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import add_partitions, remove_partitions
from bagassets_tests.in_process import make_project
from bagassets_tests.postgres_server import PROGRAMS, running_postgres, use_postgres

NAMES, OTHERS = Naming("north"), Naming("south")
KEYS = [f"r{number:05}.bag" for number in range(2500)]
NO_POSTGRES = pytest.mark.skipif(PROGRAMS is None, reason="PostgreSQL is not installed")


@dg.asset(name="bag")
def bag_asset() -> None:
    """Stands for ours."""


one_job = dg.Definitions([bag_asset]).resolve_implicit_global_asset_job_def()


@pytest.fixture(scope="module", params=["sqlite", pytest.param("postgres", marks=NO_POSTGRES)])
def instance(request, tmp_path_factory):
    recipe_file = make_project(tmp_path_factory.mktemp("many"), [])
    if request.param == "sqlite":
        with open_instance(str(recipe_file.parent)) as instance:
            yield instance
        return
    with running_postgres() as server:
        use_postgres(recipe_file, server.url)
        with open_instance(str(recipe_file.parent)) as instance:
            yield instance


@contextmanager
def counted():
    statements = []
    note = lambda _connection, _cursor, statement, *_: statements.append(statement)
    event.listen(Engine, "before_cursor_execute", note)
    try:
        yield statements
    finally:
        event.remove(Engine, "before_cursor_execute", note)


def partitions(instance, names=NAMES):
    return sorted(instance.get_dynamic_partitions(names.partitions))


def test_many_come_and_go_in_a_few_statements(instance):
    with counted() as statements:
        add_partitions(Records(instance, NAMES), KEYS)
    assert len(statements) < 60
    add_partitions(Records(instance, OTHERS), KEYS[:2])
    assert partitions(instance) == KEYS
    with counted() as statements:
        remove_partitions(Records(instance, NAMES), KEYS[1:])
    assert len(statements) < 60
    assert partitions(instance) == KEYS[:1]
    assert partitions(instance, OTHERS) == KEYS[:2], "those of another project stay"
    with counted() as statements:
        remove_partitions(Records(instance, NAMES), [])
    assert statements == []


def test_runs_of_what_is_removed_are_cancelled_and_others_are_not(instance, monkeypatch):
    cancelled = []
    monkeypatch.setattr(type(instance.run_launcher), "terminate", lambda _, run_id: cancelled.append(run_id))
    add_partitions(Records(instance, NAMES), KEYS[:3])
    runs = [
        instance.create_run_for_job(
            one_job,
            tags={"dagster/partition": key},
            asset_selection=frozenset([NAMES.key("bag")]),
            status=dg.DagsterRunStatus.STARTED,
        ).run_id
        for key in KEYS[:3]
    ]
    remove_partitions(Records(instance, NAMES), KEYS[:2])
    assert sorted(cancelled) == sorted(runs[:2])
