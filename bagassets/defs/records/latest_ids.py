"""The ids of Dagster's latest records of recordings, of which only newer ones are read than the last time.

There are a dozen for each recording, and hardly any is new. Those that were read are kept in the cache file, with a mark of the
events that they were read from: if any of these is gone, or one came late, or an asset was wiped, all are read anew.
"""

import json
from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import dagster as dg
from sqlalchemy import Connection, func, select

from bagassets.base.cache import Cache, Changes
from bagassets.base.fingerprints import PlanNeeded, digest_lines
from bagassets.defs.dagster_private import AssetKeyTable, SqlEventLogStorage, SqlEventLogStorageTable
from bagassets.defs.records.events import Records, all_assets
from bagassets.defs.records.workspace import Workspace

_KIND = "latest ids"


class _Kept(NamedTuple):
    """The ids that were read last.

    Attributes:
        last: id of the newest event of an asset before they were read; they may be newer.
        mark: of the events up to that one (`_mark`).
        ids: asset -> partition key -> id.
    """

    last: int
    mark: str
    ids: Mapping[str, Mapping[str, int]]


def latest_ids(workspace: Workspace) -> Mapping[str, Mapping[str, int]]:
    """Return what `Records.latest_ids` does of the assets of recordings."""
    records, storage = workspace.records, workspace.instance.event_log_storage
    assets = all_assets()
    if not isinstance(storage, SqlEventLogStorage):
        return records.latest_ids(assets)
    cache, name = Cache(workspace.recipe.state), records.names.partitions
    kept = _Kept(0, "", {})
    with suppress(PlanNeeded):
        kept = _read(cache.get(_KIND, name)[0])
    events = SqlEventLogStorageTable.c
    with storage.index_connection() as connection:
        newest = select(func.max(events.id)).where(events.asset_key.is_not(None))
        last = connection.execute(newest).scalar() or 0
        mark = _mark(connection, last)
        holds = (mark if last == kept.last else _mark(connection, kept.last)) == kept.mark
    if not holds or kept.ids.keys() != {*assets}:
        found: Mapping[str, Mapping[str, int]] = records.latest_ids(assets)
    elif last != kept.last:
        newer = _newer(storage, records, kept.last)
        found = {asset: {**ids, **newer.get(asset, {})} for asset, ids in kept.ids.items()}
    else:
        return kept.ids
    changes = Changes()
    changes.put(_KIND, name, _written(_Kept(last, mark, found)))
    cache.write(changes)
    return found


def _newer(storage: SqlEventLogStorage, records: Records, last: int) -> Mapping[str, Mapping[str, int]]:
    """Return the ids of events after some id; none can be of before an asset was wiped, as that was read later."""
    events = SqlEventLogStorageTable.c
    names = {records.names.key(one).to_string(): one for one in all_assets()}
    newest = select(events.asset_key, events.partition, func.max(events.id)).where(
        events.id > last,
        events.dagster_event_type == dg.DagsterEventType.ASSET_MATERIALIZATION.value,
        events.asset_key.in_(names),
        events.partition.is_not(None),
    )
    found = defaultdict[str, dict[str, int]](dict)
    with storage.index_connection() as connection:
        for name, key, number in connection.execute(newest.group_by(events.asset_key, events.partition)):
            found[names[name]][key] = number
    return found


def _mark(connection: Connection, last: int) -> str:
    """Return what changes when an event of an asset up to this id comes or goes, or an asset is wiped.

    PostgreSQL gives out ids before it commits, so one may come late; SQLite gives that of a deleted event to another.
    """
    events, assets = SqlEventLogStorageTable.c, AssetKeyTable.c
    of_assets = select(func.count()).where(events.asset_key.is_not(None))
    # Only the index is read of all, and only what is newer of the events themselves.
    total, newer = connection.execute(of_assets), connection.execute(of_assets.where(events.id > last))
    number = total.scalar_one() - newer.scalar_one()
    ours = connection.execute(select(events.run_id, events.timestamp).where(events.id == last)).all()
    wiped = select(assets.asset_key, assets.asset_details).where(assets.asset_details.is_not(None))
    rows: list[Any] = [number, *ours, *connection.execute(wiped.order_by(assets.asset_key))]
    return digest_lines([*map(repr, rows)])


def _written(kept: _Kept) -> bytes:
    keys = sorted({key for ids in kept.ids.values() for key in ids})
    rows = {asset: [ids.get(key, 0) for key in keys] for asset, ids in kept.ids.items()}
    return json.dumps([kept.last, kept.mark, keys, rows]).encode()


def _read(content: bytes) -> _Kept:
    last, mark, keys, rows = json.loads(content)
    ids = {
        asset: {key: one for key, one in zip(keys, row, strict=True) if one} for asset, row in rows.items()
    }
    return _Kept(last, mark, ids)
