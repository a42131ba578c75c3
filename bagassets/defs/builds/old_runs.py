"""Runs of long ago that no current record is from: Dagster keeps every run for ever, unless somebody deletes it."""

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress

import dagster as dg

from bagassets.defs.dagster_private import AssetCheckExecutionsTable, SqlEventLogStorage
from bagassets.defs.records.batches import recordings_of
from bagassets.defs.records.events import Records, all_assets, event_database
from bagassets.engine.batches import DATASET
from bagassets.formats.dataset_build import dataset_code_versions
from bagassets.recipe.model import Recipe

_PAGE = 1000
_BUSY_S = 60.0


def superseded_runs(records: Records, recipe: Recipe, ended_before_s: float) -> list[str]:
    """Return the ids of runs of a recipe that ended long ago, and that nothing needs any more, the oldest last.

    Needed is a run that has the latest record of an asset of a recording, or of a dataset, and the last run about each,
    which says why it failed. Runs that make users' own assets, are about asset checks only, or about recordings that are
    gone (another project may have them) are never returned.

    Args:
        records: of the project, in the instance where the runs are.
        recipe: whose runs.
        ended_before_s: Unix time; runs that ended later are kept.
    """
    datasets = ("dataset_inputs", *dataset_code_versions(recipe))
    live, names = records.live(), records.names
    recorded = records.states(all_assets())
    needed = {one.run_id for by_key in recorded.values() for one in by_key.values()}
    for name in datasets:
        latest = records.instance.get_latest_materialization_event(names.key(name))
        needed |= {latest.run_id} if latest is not None else set()
    ours = {names.key(name) for name in (*all_assets(), *datasets)}
    seen: set[str] = set()
    found, keys_of = [], recordings_of(records)
    for record in _runs(records.instance):
        run = record.dagster_run
        keys = keys_of(run)
        is_batch = bool(keys) and run.job_name == names.batch_job
        if not is_batch and not (run.asset_selection and run.asset_selection <= ours):
            continue
        about = set(keys) or {DATASET}
        is_last = not about <= seen
        seen |= about
        if is_last or run.run_id in needed or not run.is_finished or not about <= live | {DATASET}:
            continue
        if (record.end_time or record.update_timestamp.timestamp()) < ended_before_s:
            found.append(run.run_id)
    return found


def delete_runs(instance: dg.DagsterInstance, run_ids: Sequence[str]) -> None:
    """Delete runs with their events, results of checks and logs, and give back the disk space where SQLite can."""
    index, storage = event_database(instance), instance.event_log_storage
    for run_id in run_ids:
        instance.delete_run(run_id)
        if isinstance(storage, SqlEventLogStorage):  # Dagster itself leaves the results of checks
            with storage.index_connection() as connection:
                connection.execute(
                    AssetCheckExecutionsTable.delete().where(AssetCheckExecutionsTable.c.run_id == run_id)
                )
        with suppress(NotImplementedError):  # where logs are, only their manager knows
            instance.compute_log_manager.delete_logs(prefix=[run_id])
        if index is not None:  # what is left is a database without rows
            for kind in ("", "-wal", "-shm"):
                index.with_name(f"{run_id}.db{kind}").unlink(missing_ok=True)
    if index is not None and run_ids:
        with closing(sqlite3.connect(index, timeout=_BUSY_S, isolation_level=None)) as connection:
            connection.executescript("PRAGMA incremental_vacuum")  # `execute` would stop after one page


def _runs(instance: dg.DagsterInstance) -> Iterator[dg.RunRecord]:
    """Yield all runs, the newest first."""
    cursor: str | None = None
    while page := instance.get_run_records(cursor=cursor, limit=_PAGE):
        yield from page
        cursor = page[-1].dagster_run.run_id
