"""A scan by the sensor: compares the recordings on disk with Dagster's records and requests runs."""

import datetime as dt
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import dagster as dg

from bagassets.base.alike import names_text
from bagassets.base.errors import RecordingError
from bagassets.base.quantities import count_text
from bagassets.defs.graph.dataset import dataset_is_current, record_inputs
from bagassets.defs.graph.sensor_cursor import Cursor
from bagassets.defs.records.batches import batch_config, batch_of, batches
from bagassets.defs.records.events import all_assets, live_partitions
from bagassets.defs.records.instance_plan import InstancePlan, plan_instance, workspace_fingerprint
from bagassets.defs.records.partitions import (
    DATASET,
    PARTITION_TAG,
    active_runs,
    add_partitions,
    held_by_backfills,
    remove_partition,
)
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.launching import launching_of
from bagassets.defs.runs.orphaned_runs import end_orphaned_runs
from bagassets.engine.freshness.plan_cache import recording_fingerprint
from bagassets.engine.inputs import files_beside
from bagassets.engine.plan import AssetState, BagPlan, Plan
from bagassets.engine.unsettled import Unsettled
from bagassets.formats.dataset_build import DatasetInputs, dataset_code_versions
from bagassets.recordings.digest import RecordingStat, recording_stat
from bagassets.recordings.discover import Discovery
from bagassets.store.canonical import digest_json

__all__ = ["Scan"]

# Small recordings that share a run, unless the launcher says how many.
_RECORDINGS_PER_RUN = 10
# Creating a hundred runs takes longer than a tick may, and thousands in the queue make everything slow; the rest
# is requested when some have ended.
MOST_RUNS = 50
# The datasets wait for recordings that have a run, but not for ever.
PATIENCE_S = 60.0
_LONGEST_REASON = 80
_LATEST = 50
# Runs that ended so long before the last scan are looked at again: the clock of a database may be behind ours.
_CLOCKS_DIFFER_S = 60.0
_ENDED = [dg.DagsterRunStatus.SUCCESS, dg.DagsterRunStatus.FAILURE, dg.DagsterRunStatus.CANCELED]


@dataclass(frozen=True)
class _Wanted:
    """What a run is to make of a recording: the assets, a digest of the request, and why."""

    assets: tuple[str, ...]
    what: str
    why: str


class Scan:
    """Scans recordings, records and runs, once or several times; the cursor carries over from one scan to the next."""

    def __init__(self, instance: dg.DagsterInstance, workspace: Workspace, cursor: Cursor) -> None:
        self.cursor = cursor
        self._instance = instance
        self._workspace = workspace
        self._names = workspace.names
        self._datasets = tuple(dataset_code_versions(workspace.recipe))
        self._next_settled_s: float | None = None
        self._active: set[str] = set()
        self._runs = 0
        self._unsettled = Unsettled(workspace.recipe.state)
        self._ended: dict[str, dg.DagsterRun] = {}
        self._noted: frozenset[str] = frozenset()
        self._joined: dict[str, list[str]] = {}
        self._held: dict[str, str] = {}

    def is_worth_waiting(self, until_s: float) -> bool:
        """Return whether a run is active, or a recording may settle before `until_s`."""
        soon = self._next_settled_s is not None and self._next_settled_s <= until_s
        return soon or bool(self._active)

    def scan(self, now_s: float) -> list[dg.RunRequest]:
        """Bring the partitions up to date and return the runs to request."""
        recipe, cursor = self._workspace.recipe, self.cursor
        discovery = self._workspace.discover()
        stats = _stats(discovery)
        live = live_partitions(self._instance, self._names)
        # A recording in a folder that cannot be read at the moment is not gone.
        there = frozenset(stats) | discovery.unseen(live)
        if self._is_disk_gone(live, there, now_s):
            return []
        former = discovery.former_keys.items()
        self._joined = {
            whole: found for whole, keys in former if (found := [key for key in keys if key in live])
        }
        live = self._drop_removed(live, there)
        active = active_runs(self._instance, self._names, self._datasets)
        if active and end_orphaned_runs(self._instance)[0]:
            active = active_runs(self._instance, self._names, self._datasets)
        self._active, self._runs = {key for keys in active.values() for key in keys}, len(active)
        self._note_unsettled()
        records, project = self._state_of_records(), workspace_fingerprint(self._workspace)
        quiet = digest_json(
            [
                records,
                project,
                {
                    key: recording_fingerprint(
                        project or "", one.relative, one.files, files_beside(recipe, one), {}
                    )
                    for key, one in discovery.recordings.items()
                },
                discovery.unreadable,
                sorted(live),
                sorted(active),
                sorted(self._noted),
            ]
        )
        if cursor.quiet == quiet and project is not None:
            cursor.looked_s = now_s
            self._next_settled_s = None
            return []
        planned = plan_instance(self._instance, self._workspace, live)
        self._unsettled.forget_settled(planned.plan)
        known = {key for key, bag in planned.plan.bags.items() if bag.assets["bag"].state == "fresh"}
        finished = cursor.settle(stats, known, recipe.bags.settle_s, now_s)
        self._next_settled_s = cursor.next_settled_s(recipe.bags.settle_s, finished)
        add_partitions(self._instance, self._names, sorted(finished - live))
        requests = self._requests(planned, {key: stats[key] for key in finished}, now_s)
        is_settling = self._next_settled_s is not None
        is_over = not (requests or self._active or is_settling or cursor.may_ask_again)
        cursor.quiet = quiet if is_over else ""
        return requests

    # --- partitions ----------------------------------------------------------------------

    def _is_disk_gone(self, live: frozenset[str], found: frozenset[str], now_s: float) -> bool:
        """Return whether all recordings disappeared at once a moment ago: more likely a disk is not mounted."""
        cursor = self.cursor
        if found or len(live) < 2:
            cursor.empty_since_s = None
            return False
        cursor.empty_since_s = cursor.empty_since_s or now_s
        left_s = PATIENCE_S - (now_s - cursor.empty_since_s)
        if left_s <= 0:
            return False
        cursor.quiet, self._next_settled_s, self._active = "", None, set()
        cursor.said = (
            f"All {len(live)} recordings below {self._workspace.recipe.bags.root} disappeared at once; is its disk mounted? "
            f"They will be dropped in {left_s:.0f} s."
        )
        return True

    def _drop_removed(self, live: frozenset[str], found: frozenset[str]) -> frozenset[str]:
        self._held = held_by_backfills(self._instance, live - found)
        for key in sorted(live - found - self._held.keys()):
            remove_partition(self._instance, self._names, key)
        self.cursor.forget([key for key in self.cursor.asked if key not in found and key != DATASET])
        return live & found

    # --- records -------------------------------------------------------------------------

    def _state_of_records(self) -> str:
        """Return a digest that changes whenever one of our assets is materialized or wiped."""
        keys = [self._names.key(name) for name in (*all_assets(), "dataset_inputs", *self._datasets)]
        entries = [record.asset_entry for record in self._instance.get_asset_records(keys)]
        return digest_json(
            sorted([e.asset_key.to_user_string(), e.last_materialization_storage_id] for e in entries)
        )

    # --- runs that ended -----------------------------------------------------------------

    def _ended_runs(self) -> dict[str, dg.DagsterRun]:
        """Return the last run of each recording that ended since the last scan, whoever launched it.

        None where it was a shared one: its worker sees to it how each recording ends.
        """
        if self.cursor.looked_s is None:
            return {}
        since = dt.datetime.fromtimestamp(self.cursor.looked_s - _CLOCKS_DIFFER_S, dt.UTC)
        filters = dg.RunsFilter(statuses=_ENDED, updated_after=since)
        assets = frozenset(all_assets())
        ended: dict[str, dg.DagsterRun] = {}
        for record in self._instance.get_run_records(filters, order_by="update_timestamp", ascending=True):
            run = record.dagster_run
            if PARTITION_TAG in run.tags and self._names.is_about(run, assets):
                ended[run.tags[PARTITION_TAG]] = run
            for key in batch_of(run, self._names):
                ended.pop(key, None)
        return ended

    def _note_unsettled(self) -> None:
        """Note the recordings whose run failed: all they have may be up to date, and yet Dagster shows them as failed."""
        self._ended = self._ended_runs()
        for key, run in self._ended.items():
            if run.status == dg.DagsterRunStatus.FAILURE:
                self._unsettled.add(key)
        self._noted = self._unsettled.noted()

    def _is_settled(self, bag: BagPlan) -> bool:
        """Return whether a recording was noted, and a run that ended well has recorded all of it since."""
        run = self._ended.get(bag.key)
        if run is None or run.status != dg.DagsterRunStatus.SUCCESS or bag.key not in self._noted:
            return False
        made = {self._names.asset_of(key) for key in run.asset_selection or ()}
        return made.issuperset(bag.to_run())

    # --- requests ------------------------------------------------------------------------

    def _requests(
        self, planned: InstancePlan, finished: Mapping[str, RecordingStat], now_s: float
    ) -> list[dg.RunRequest]:
        plan, cursor = planned.plan, self.cursor
        wanted = {
            key: request
            for key in sorted((finished.keys() & plan.bags.keys()) - self._active)
            if (request := self._wanted(plan.bags[key], finished[key], now_s)) is not None
        }
        sizes = {key: sum(size for _, size, _ in finished[key].files) for key in wanted}
        most = launching_of(self._instance).recordings_per_run or _RECORDINGS_PER_RUN
        dealt = batches({key: one.assets for key, one in wanted.items()}, sizes, 1, most)
        requests = [
            self._request({key: wanted[key] for key in batch}, now_s)
            for batch in dealt[: max(0, MOST_RUNS - self._runs)]
        ]
        is_busy = bool(requests or self._active)
        cursor.busy_since_s = (cursor.busy_since_s or now_s) if is_busy else None
        if not is_busy or now_s - (cursor.busy_since_s or now_s) > PATIENCE_S:
            requests += self._dataset_request(planned.inputs, now_s)
            cursor.busy_since_s = None
        cursor.said = self._describe(plan, finished)
        return requests

    def _wanted(self, bag: BagPlan, stat: RecordingStat, now_s: float) -> _Wanted | None:
        """Return what a run is to make of a recording, unless it was requested and nothing has changed since.

        A recording of which only the time changed is read in a run of `bag` alone: a tick must not take so long, and
        most often nothing else is to be done.
        """
        if self._is_settled(bag):
            self._unsettled.discard(bag.key)
            self.cursor.forget([bag.key])
            return None
        if not bag.to_run():
            self.cursor.forget([bag.key])
            return None
        stale = {name: asset for name, asset in bag.assets.items() if not asset.is_settled}
        states = {name: [asset.state, asset.reason] for name, asset in stale.items()}
        what = digest_json([stat.as_json(), states])
        if self._was_cancelled(bag.key, what):
            self.cursor.give_up(bag.key, what)
            return None
        if not self.cursor.may_ask(bag.key, what, now_s):
            return None
        return _Wanted(("bag",) if bag.touched else tuple(bag.to_run()), what, _why(list(stale.values())))

    def _request(self, batch: Mapping[str, _Wanted], now_s: float) -> dg.RunRequest:
        """Return the run for a large recording, or for several small ones."""
        for key, one in batch.items():
            self.cursor.ask(key, one.what, now_s)
        (key, first), count = next(iter(batch.items())), len(batch)
        if count == 1:
            return dg.RunRequest(
                run_key=f"{key}:{first.what[:16]}:{self.cursor.runs}",
                job_name=self._names.assets_job,
                partition_key=key,
                asset_selection=[self._names.key(name) for name in first.assets],
                tags={"why": first.why},
            )
        what = digest_json([[key, one.what] for key, one in batch.items()])
        return dg.RunRequest(
            run_key=f"{count} recordings:{what[:16]}:{self.cursor.runs}",
            job_name=self._names.batch_job,
            run_config=batch_config({key: one.assets for key, one in batch.items()}, self._names),
            tags={"why": f"{count_text(count, 'recording')}; {key}: {first.why}"[:_LONGEST_REASON]},
        )

    def _was_cancelled(self, key: str, what: str) -> bool:
        """Return whether the run of this request was cancelled: then it is not requested again."""
        asked = self.cursor.asked.get(key)
        if asked is None or asked.what != what:
            return False
        assets, names = frozenset(all_assets()), self._names
        alone = self._instance.get_run_records(dg.RunsFilter(tags={PARTITION_TAG: key}), limit=_LATEST)
        shared = self._instance.get_run_records(dg.RunsFilter(job_name=names.batch_job), limit=_LATEST)
        records = [record for record in alone if names.is_about(record.dagster_run, assets)]
        records += [record for record in shared if key in batch_of(record.dagster_run, names)]
        latest = max(records, key=lambda record: record.storage_id, default=None)
        return latest is not None and latest.dagster_run.status == dg.DagsterRunStatus.CANCELED

    def _dataset_request(self, inputs: DatasetInputs, now_s: float) -> list[dg.RunRequest]:
        record_inputs(self._instance, self._workspace, inputs)
        if dataset_is_current(self._instance, self._workspace, inputs):
            self.cursor.forget([DATASET])
            return []
        if DATASET in self._active or not self.cursor.ask(DATASET, inputs.digest, now_s):
            return []
        return [
            dg.RunRequest(
                run_key=f"dataset:{inputs.digest[:16]}:{self.cursor.runs}",
                job_name=self._names.assets_job,
                asset_selection=[self._names.key(name) for name in self._datasets],
                tags={"why": "its recordings or the recipe changed"},
            )
        ]

    def _describe(self, plan: Plan, finished: Iterable[str]) -> str:
        """Return the state of the recordings as one line."""
        writing = sorted(plan.bags.keys() - set(finished))
        failed = sorted(key for key, bag in plan.bags.items() if bag.failed is not None)
        parts = [count_text(len(plan.bags), "recording")]
        parts += [f"{names_text(keys)} joined into {whole}" for whole, keys in self._joined.items()]
        parts += [f"{key} is gone: {why}" for key, why in self._held.items()]
        parts += [f"to be decided: {len(plan.asked)}, which `bagassets status` names"] if plan.asked else []
        parts += [f"waiting for {names_text(writing)} to settle"] if writing else []
        parts += [f"waiting for {count_text(self._runs, 'run')}"] if self._runs else []
        parts += [f"failed: {names_text(failed)}"] if failed else []
        return "; ".join(parts if len(parts) > 1 else [*parts, "up to date"]) + "."


def _why(stale: list[AssetState]) -> str:
    """Return the reason for a run; that of an asset to be made goes before that of one to be recorded."""
    first = next((asset for asset in stale if asset.state != "record-only"), stale[0])
    return first.reason[:_LONGEST_REASON]


def _stats(discovery: Discovery) -> dict[str, RecordingStat]:
    stats = {}
    for key, recording in discovery.recordings.items():
        try:
            stats[key] = recording_stat(recording)
        except RecordingError:  # it was removed during the scan; the next one will not find it
            continue
    return stats
