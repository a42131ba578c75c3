"""The ids of the latest records are those that Dagster gives, however they came about since they were last read."""

import random
from collections.abc import Iterator

import dagster as dg
import pytest
import sqlalchemy as db

from bagassets.base.cache import NAME
from bagassets.defs.dagster_private import SqlEventLogStorageTable
from bagassets.defs.records import latest_ids as latest_ids_module
from bagassets.defs.records.events import Records, all_assets
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.latest_ids import latest_ids
from bagassets.defs.records.workspace import Workspace
from bagassets_tests.in_process import make_project
from bagassets_tests.postgres_server import running_postgres, use_postgres

pytestmark = pytest.mark.once

KEYS = [f"{name}.bag" for name in "abcd"]


@pytest.fixture(scope="module")
def postgres() -> Iterator[object]:
    with running_postgres() as server:
        yield server


@pytest.fixture(params=["sqlite", "postgres"])
def workspace(request, tmp_path):
    recipe = make_project(tmp_path, [])
    if request.param == "postgres":
        server = request.getfixturevalue("postgres")
        server.create_database(tmp_path.name.replace("-", "_").lower())
        use_postgres(recipe, server.url_of(tmp_path.name.replace("-", "_").lower()))
    with open_instance(str(recipe.parent)) as instance:
        yield Workspace(recipe_file=str(recipe)).on(instance)


def record(workspace, asset="frames", key=KEYS[0]):
    workspace.instance.report_runless_asset_event(dg.AssetMaterialization(asset, partition=key))


def of_dagster(workspace):
    """Return what a look finds that knows nothing, without partitions that have none."""
    return {asset: dict(ids) for asset, ids in workspace.records.latest_ids(all_assets()).items()}


def delete(workspace, which):
    """Delete events as Dagster does with those of a run that is deleted."""
    with workspace.instance.event_log_storage.index_connection() as connection:
        connection.execute(SqlEventLogStorageTable.delete().where(which))


def test_only_newer_ones_are_read(workspace, monkeypatch):
    for key in KEYS:
        record(workspace, key=key)
    asked, plain, newer = [], Records.latest_ids, latest_ids_module._newer

    def note(records, assets, **options):
        asked.append(None)
        return plain(records, assets, **options)

    def note_newer(storage, records, last):
        asked.append(last)
        return newer(storage, records, last)

    monkeypatch.setattr(Records, "latest_ids", note)
    monkeypatch.setattr(latest_ids_module, "_newer", note_newer)
    first = latest_ids(workspace)
    assert first["frames"].keys() == set(KEYS)
    last = max(first["frames"].values())
    assert latest_ids(workspace) == first
    record(workspace, key="b.bag")
    record(workspace, asset="bag", key="new.bag")
    now = latest_ids(workspace)
    assert asked == [None, last], "all of them once, then nothing, then what is newer"
    assert now["frames"] == {**first["frames"], "b.bag": now["frames"]["b.bag"]}
    assert now["frames"]["b.bag"] > last
    assert now["bag"].keys() == {"new.bag"}
    assert now == of_dagster(workspace)


def test_after_any_changes_they_are_those_of_dagster(workspace):
    """Events come and go, assets are wiped, and one event comes late, as PostgreSQL may have it."""
    dice, events = random.Random(43), SqlEventLogStorageTable.c

    def some_event():
        with workspace.instance.event_log_storage.index_connection() as connection:
            of_assets = db.select(events.id).where(events.asset_key.is_not(None))
            return dice.choice([row[0] for row in connection.execute(of_assets)])

    def come():
        record(workspace, dice.choice(["bag", "frames", "sweeps"]), dice.choice(KEYS))

    def go():
        delete(workspace, events.id == some_event())

    def last_goes_and_another_has_its_id():
        delete(workspace, events.id >= some_event())
        come()

    def wiped():
        workspace.instance.wipe_assets([dg.AssetKey(dice.choice(["bag", "frames", "sweeps"]))])

    def come_late():
        """Between two looks, an event gets an id below that of one that was there at the first."""
        which = SqlEventLogStorageTable.select().where(events.id == some_event())
        with workspace.instance.event_log_storage.index_connection() as connection:
            (row,) = connection.execute(which).mappings()
            connection.execute(SqlEventLogStorageTable.delete().where(events.id == row["id"]))
        latest_ids(workspace)
        with workspace.instance.event_log_storage.index_connection() as connection:
            connection.execute(SqlEventLogStorageTable.insert().values(**row))

    def cache_lost():
        (workspace.recipe.state / NAME).unlink(missing_ok=True)

    for _ in range(5):
        come()
    kinds = [come, come, go, last_goes_and_another_has_its_id, wiped, come_late, cache_lost]
    for _ in range(25):
        for _ in range(dice.randint(1, 3)):
            come()
            dice.choice(kinds)()
        assert latest_ids(workspace) == of_dagster(workspace)
