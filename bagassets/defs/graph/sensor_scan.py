"""A scan by the sensor: compares the recordings on disk with Dagster's records and requests runs."""

import datetime as dt
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace

import dagster as dg

from bagassets.base.alike import names_text
from bagassets.base.errors import RecordingError
from bagassets.base.fingerprints import PlanNeeded, tree_fingerprint
from bagassets.base.quantities import count_text
from bagassets.defs.graph.dataset import dataset_is_current, record_inputs
from bagassets.defs.graph.sensor_cursor import Cursor, Request
from bagassets.defs.records.batches import PARTITION_TAG, batch_config, recordings_of
from bagassets.defs.records.events import all_assets
from bagassets.defs.records.instance_plan import planner_of, workspace_fingerprint
from bagassets.defs.records.naming import WHOLE_GRAPH
from bagassets.defs.records.partitions import (
    active_runs,
    add_partitions,
    held_by_backfills,
    remove_partitions,
)
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.launching import launching_of
from bagassets.defs.runs.orphaned_runs import end_orphaned_runs
from bagassets.engine.batches import DATASET, Batch
from bagassets.engine.freshness.plan_cache import recording_fingerprint
from bagassets.engine.inputs import files_beside
from bagassets.engine.next_steps import Rules, State, Work, next_steps
from bagassets.engine.plan import BagPlan, Plan
from bagassets.engine.unsettled import Unsettled
from bagassets.formats.dataset_build import DatasetInputs, dataset_code_versions, select_inputs
from bagassets.recordings.digest import RecordingStat, recording_stat
from bagassets.recordings.discover import Discovery
from bagassets.store.canonical import digest_json

# Creating a hundred runs takes longer than a tick may, and thousands in the queue make everything slow; the rest
# is requested when some have ended. The launcher may say how many recordings share one.
RULES = Rules(
    most_per_run=10,
    most_runs=50,
    most_tries=3,
    retry_s=60.0,
    patience_s=60.0,
    fewest_doubted=2,
    bag_first=True,
)
_LONGEST_REASON = 80
_LATEST = 50
# Runs that ended so long before the last scan are looked at again: the clock of a database may be behind ours.
_CLOCKS_DIFFER_S = 60.0
_ENDED = [dg.DagsterRunStatus.SUCCESS, dg.DagsterRunStatus.FAILURE, dg.DagsterRunStatus.CANCELED]


class Scan:
    """Scans recordings, records and runs, once or several times; the cursor carries over from one scan to the next."""

    def __init__(self, workspace: Workspace, cursor: Cursor) -> None:
        self.cursor = cursor
        self._workspace, self._records = workspace, workspace.records
        self._instance, self._names = workspace.instance, workspace.names
        self._next_settled_s: float | None = None
        self._active: frozenset[str] = frozenset()
        self._unsettled = Unsettled(workspace.recipe.state)

    def is_worth_waiting(self, until_s: float) -> bool:
        """Return whether a run is active, or a recording may settle before `until_s`."""
        soon = self._next_settled_s is not None and self._next_settled_s <= until_s
        return soon or bool(self._active)

    def scan(self, now_s: float) -> list[dg.RunRequest]:
        """Bring the partitions up to date and return the runs to request."""
        cursor, settle_s = self.cursor, self._workspace.recipe.bags.settle_s
        self._next_settled_s, self._active = None, frozenset()
        live = self._records.live()
        active = self._active_runs()
        self._active = frozenset(key for keys in active.values() for key in keys)
        ended, noted = self._ended_runs(), self._unsettled.noted()
        quiet = self._digest(live, active, noted)
        if quiet and cursor.quiet == quiet:
            cursor.looked_s = now_s
            return []
        discovery = self._workspace.discover()
        stats = _stats(discovery)
        # A recording in a folder that cannot be read at the moment is not gone.
        there = frozenset(stats) | discovery.unseen(live)
        state = self._without_gone(live, there, now_s)
        if state is None:
            return []
        plan = planner_of(self._workspace, live, discovery, checked="sample").plan()
        inputs = select_inputs(plan)
        self._unsettled.forget_settled(plan)
        known = {key for key, bag in plan.bags.items() if bag.assets["bag"].state == "fresh"}
        finished = cursor.settle(stats, known, settle_s, now_s)
        self._next_settled_s = cursor.next_settled_s(settle_s, finished)

        bags = {key: plan.bags[key] for key in sorted(finished - self._active)}
        todo = self._recordings(bags, stats, {key: ended.get(key) for key in noted})
        todo |= self._datasets(inputs)
        state = replace(
            state,
            new=finished - live,
            todo=todo,
            active=self._active,
            runs=len(active),
            busy_since_s=cursor.busy_since_s,
        )
        steps = next_steps(state, self._rules())
        add_partitions(self._records, steps.register)
        if steps.is_over:
            record_inputs(self._workspace, inputs)
        requests = [self._request(run, todo, now_s) for run in steps.runs]
        cursor.busy_since_s = steps.busy_since_s
        cursor.said = self._describe(plan, finished, state.held, len(active))
        asks_again = any(one.tries < RULES.most_tries for one in cursor.asked.values())
        is_over = not (requests or active or asks_again or state.held or self._next_settled_s is not None)
        cursor.quiet = quiet if is_over else ""
        return requests

    def _without_gone(self, live: frozenset[str], there: frozenset[str], now_s: float) -> State | None:
        """Remove the partitions of recordings that are gone; return the state then, or None if that is not to be believed."""
        cursor = self.cursor
        held = held_by_backfills(self._instance, live - there)
        state = State(now_s, len(there), live - there, held, empty_since_s=cursor.empty_since_s)
        steps = next_steps(state, RULES)
        cursor.empty_since_s = steps.empty_since_s
        if steps.doubted_s is not None:
            cursor.quiet = ""
            cursor.said = (
                f"All {len(live)} recordings below {self._workspace.recipe.bags.root} disappeared at once; is its disk mounted? "
                f"They will be dropped in {steps.doubted_s:.0f} s."
            )
            return None
        remove_partitions(self._records, steps.remove)
        cursor.forget([key for key in cursor.asked if key not in there and key != DATASET])
        return replace(state, gone=tuple(held))

    # --- looking -------------------------------------------------------------------------

    def _rules(self) -> Rules:
        most = launching_of(self._instance).recordings_per_run or RULES.most_per_run
        return replace(RULES, most_per_run=most)

    def _active_runs(self) -> dict[str, tuple[str, ...]]:
        datasets = dataset_code_versions(self._workspace.recipe)
        active = active_runs(self._records, datasets)
        if active and end_orphaned_runs(self._instance)[0]:
            active = active_runs(self._records, datasets)
        return active

    def _ended_runs(self) -> dict[str, dg.DagsterRun]:
        """Return the last run of each recording that ended since the last scan, whoever launched it; note those that failed.

        None where it was a shared one: its worker sees to it how each recording ends.
        """
        if self.cursor.looked_s is None:
            return {}
        since = dt.datetime.fromtimestamp(self.cursor.looked_s - _CLOCKS_DIFFER_S, dt.UTC)
        filters = dg.RunsFilter(statuses=_ENDED, updated_after=since)
        keys_of = recordings_of(self._records)
        ended: dict[str, dg.DagsterRun] = {}
        for record in self._instance.get_run_records(filters, order_by="update_timestamp", ascending=True):
            run = record.dagster_run
            for key in keys_of(run):
                if PARTITION_TAG in run.tags:
                    ended[key] = run
                else:
                    ended.pop(key, None)
        for key, run in ended.items():
            # All that it has may be up to date, and yet Dagster shows it as failed.
            if run.status == dg.DagsterRunStatus.FAILURE:
                self._unsettled.add(key)
        return ended

    def _digest(self, live: Iterable[str], active: Iterable[str], noted: Iterable[str]) -> str:
        """Return a digest of everything that a scan depends on; "" if that is not known.

        It changes whenever one of our assets is materialized or wiped.
        """
        project = workspace_fingerprint(self._workspace)
        if project is None:
            return ""
        assets = (*all_assets(), "dataset_inputs", *dataset_code_versions(self._workspace.recipe))
        records = self._instance.get_asset_records([self._names.key(name) for name in assets])
        entries = [record.asset_entry for record in records]
        newest = sorted([e.asset_key.to_user_string(), e.last_materialization_storage_id] for e in entries)
        facts = [newest, project, self._files(), sorted(live), sorted(active), sorted(noted)]
        return digest_json(facts)

    def _files(self) -> object:
        """Return what changes with the files of recordings, and with those beside them."""
        recipe = self._workspace.recipe
        if not any(rig.annotation_files for rig in recipe.rigs):  # which may lie anywhere
            with suppress(PlanNeeded):  # a folder that cannot be read may be one of many
                return tree_fingerprint(str(recipe.bags.root))
        found = self._workspace.discover()
        files = {
            key: recording_fingerprint("", one.relative, one.files, files_beside(recipe, one), {})
            for key, one in found.recordings.items()
        }
        return [files, found.unreadable]

    def _recordings(
        self,
        bags: Mapping[str, BagPlan],
        stats: Mapping[str, RecordingStat],
        noted: Mapping[str, dg.DagsterRun | None],
    ) -> dict[str, Work]:
        """Return what is to be made of recordings that are finished and have no run; requests that were met are dropped.

        Args:
            bags: their states.
            stats: sizes and times of their files.
            noted: recording whose last run did not end well -> its run that ended since.
        """
        todo = {}
        for key, bag in bags.items():
            if self._has_recorded_all(noted.get(key), bag):
                self._unsettled.discard(key)
            elif bag.to_run():
                todo[key] = self._work(bag, stats[key])
        self.cursor.forget(bags.keys() - todo.keys())
        return todo

    def _has_recorded_all(self, run: dg.DagsterRun | None, bag: BagPlan) -> bool:
        """Return whether a run ended well that has recorded all that is to be made."""
        if run is None or run.status != dg.DagsterRunStatus.SUCCESS:
            return False
        return {self._names.asset_of(key) for key in run.asset_selection or ()}.issuperset(bag.to_run())

    def _work(self, bag: BagPlan, stat: RecordingStat) -> Work:
        """Return what is to be made of a recording, and how often just that was requested."""
        stale = {name: asset for name, asset in bag.assets.items() if not asset.is_settled}
        what = digest_json([stat.as_json(), {name: [one.state, one.reason] for name, one in stale.items()}])
        tries, tried_s = self.cursor.tried(bag.key, what)
        if 0 < tries < RULES.most_tries and self._was_cancelled(bag.key):
            tries = RULES.most_tries
            self.cursor.asked[bag.key] = Request(what, tries, tried_s)
        # That of an asset to be made goes before that of one to be recorded.
        why = min(stale.values(), key=lambda asset: asset.state == "record-only").reason[:_LONGEST_REASON]
        size = sum(size for _, size, _ in stat.files)
        return Work(
            bag.to_run(), size, is_touched=bag.touched, tries=tries, tried_s=tried_s, what=what, why=why
        )

    def _was_cancelled(self, key: str) -> bool:
        """Return whether the last run of a recording was cancelled: then the same is not requested again."""
        names, keys_of = self._names, recordings_of(self._records)
        asked = [dg.RunsFilter(tags={PARTITION_TAG: key})]
        asked += [dg.RunsFilter(job_name=name) for name in (names.batch_job, WHOLE_GRAPH)]
        records = [
            record
            for filters in asked
            for record in self._instance.get_run_records(filters, limit=_LATEST)
            if key in keys_of(record.dagster_run)
        ]
        latest = max(records, key=lambda record: record.storage_id, default=None)
        return latest is not None and latest.dagster_run.status == dg.DagsterRunStatus.CANCELED

    def _datasets(self, inputs: DatasetInputs) -> dict[str, Work]:
        """Return that the datasets are to be made, all of them, if one of them is behind."""
        if dataset_is_current(self._workspace, inputs):
            self.cursor.forget([DATASET])
            return {}
        what = inputs.digest
        tries, tried_s = self.cursor.tried(DATASET, what)
        assets = tuple(dataset_code_versions(self._workspace.recipe))
        why = "its recordings or the recipe changed"
        return {DATASET: Work(assets, tries=tries, tried_s=tried_s, what=what, why=why)}

    # --- doing ---------------------------------------------------------------------------

    def _request(self, run: Batch, todo: Mapping[str, Work], now_s: float) -> dg.RunRequest:
        """Return the request for a run about a large recording, several small ones, or the datasets."""
        for key in run:
            self.cursor.ask(key, todo[key].what, now_s)
        (key, assets), count = next(iter(run.items())), len(run)
        what, why = todo[key].what, todo[key].why
        if count == 1:
            return dg.RunRequest(
                run_key=f"{key or 'dataset'}:{what[:16]}:{self.cursor.runs}",
                job_name=self._names.assets_job,
                partition_key=key or None,
                asset_selection=[self._names.key(name) for name in assets],
                tags={"why": why},
            )
        what = digest_json([[key, todo[key].what] for key in run])
        return dg.RunRequest(
            run_key=f"{count} recordings:{what[:16]}:{self.cursor.runs}",
            job_name=self._names.batch_job,
            run_config=batch_config(run, self._names),
            tags={"why": f"{count_text(count, 'recording')}; {key}: {why}"[:_LONGEST_REASON]},
        )

    def _describe(self, plan: Plan, finished: Iterable[str], held: Mapping[str, str], runs: int) -> str:
        """Return the state of the recordings as one line."""
        writing = sorted(plan.bags.keys() - set(finished))
        failed = sorted(key for key, bag in plan.bags.items() if bag.failed is not None)
        parts = [count_text(len(plan.bags), "recording")]
        parts += [f"{names_text(keys)} joined into {whole}" for whole, keys in plan.joined.items()]
        parts += [f"{key} is gone: {why}" for key, why in held.items()]
        parts += [f"to be decided: {len(plan.asked)}, which `bagassets status` names"] if plan.asked else []
        parts += [f"waiting for {names_text(writing)} to settle"] if writing else []
        parts += [f"waiting for {count_text(runs, 'run')}"] if runs else []
        parts += [f"failed: {names_text(failed)}"] if failed else []
        return "; ".join(parts if len(parts) > 1 else [*parts, "up to date"]) + "."


def _stats(discovery: Discovery) -> dict[str, RecordingStat]:
    stats = {}
    for key, recording in discovery.recordings.items():
        try:
            stats[key] = recording_stat(recording)
        except RecordingError:  # it was removed during the scan; the next one will not find it
            continue
    return stats
