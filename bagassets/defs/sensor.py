"""The sensor: notices new, changed and removed recordings, and asks for runs.

A tick looks at names, sizes and times only; hashing happens inside the run. A file whose size
or time changed since the tick before is still being written and waits.
"""

import json
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import dagster as dg

from bagassets.bags.digest import recording_stat
from bagassets.bags.model import Found
from bagassets.defs.dataset import current_inputs, dataset_is_current, record_inputs
from bagassets.defs.events import live_partitions, recorded_states
from bagassets.defs.partitions import add_partitions, remove_partition
from bagassets.defs.reporting import failures_in_words
from bagassets.defs.workspace import Workspace
from bagassets.engine.dataset_build import DatasetInputs
from bagassets.engine.plan import RECORDING_ASSETS, BagPlan, make_plan
from bagassets.store.canonical import digest_json

__all__ = ["recordings_sensor"]

# Creating a hundred runs in one tick takes longer than a tick may.
MOST_REQUESTS = 50
INTERVAL_S = 10
# The dataset waits for recordings that are being worked on, but not for ever.
PATIENCE_S = 60

ACTIVE = [
    dg.DagsterRunStatus.QUEUED,
    dg.DagsterRunStatus.NOT_STARTED,
    dg.DagsterRunStatus.STARTING,
    dg.DagsterRunStatus.STARTED,
    dg.DagsterRunStatus.CANCELING,
]


@dataclass
class Cursor:
    """What a tick remembers for the next.

    Attributes:
        seen: partition key -> digest of sizes and times, and since when they hold (Unix seconds).
        asked: partition key -> what a run was asked for last.
        attempts: number of runs asked for, which makes run keys unique.
        busy_since: since when runs have been active without a pause, or None.
    """

    seen: dict[str, tuple[str, float]]
    asked: dict[str, str]
    attempts: int
    busy_since: float | None

    @classmethod
    def parse(cls, text: str | None) -> "Cursor":
        """Return the cursor in `text`; an unreadable one is as good as none."""
        try:
            value = json.loads(text or "{}")
            seen = {key: (str(entry[0]), float(entry[1])) for key, entry in value["seen"].items()}
            return cls(seen, dict(value["asked"]), int(value["attempts"]), value["busy_since"])
        except (ValueError, KeyError, TypeError, AttributeError):
            return cls({}, {}, 0, None)

    def text(self) -> str:
        """Return the cursor as text."""
        return json.dumps(self.__dict__, sort_keys=True)

    def settle(self, found: Mapping[str, Found], settle_s: float, now_s: float) -> set[str]:
        """Note what lies on disk now and return the keys that have kept size and time long enough."""
        settled = set()
        seen = {}
        for key, recording in found.items():
            state = digest_json(recording_stat(recording).as_json())
            before = self.seen.get(key)
            since_s = before[1] if before is not None and before[0] == state else now_s
            # An old file was not written just now: it need not be watched first.
            quiet_s = max(now_s - since_s, now_s - recording.mtime_ns / 1e9)
            seen[key] = (state, since_s)
            if quiet_s >= settle_s:
                settled.add(key)
        self.seen = seen
        return settled


def recordings_sensor() -> dg.SensorDefinition:
    """Return the sensor; the recipe it works for is its workspace's."""

    @dg.sensor(
        name="recordings",
        target=dg.AssetSelection.all(),
        minimum_interval_seconds=INTERVAL_S,
        default_status=dg.DefaultSensorStatus.RUNNING,
        description="Registers new recordings, builds what is stale, drops what was removed, updates the dataset.",
    )
    def recordings(context: dg.SensorEvaluationContext, workspace: Workspace) -> dg.SensorResult:
        with failures_in_words():
            return _tick(context, workspace)

    return recordings


def _tick(context: dg.SensorEvaluationContext, workspace: Workspace) -> dg.SensorResult:
    recipe, instance = workspace.recipe, context.instance
    now_s = time.time()
    cursor = Cursor.parse(context.cursor)
    discovery = workspace.discover()
    settled = cursor.settle(discovery.found, recipe.bags.settle_s, now_s)
    live = live_partitions(instance, recipe)
    for key in sorted(live - discovery.found.keys()):
        remove_partition(instance, recipe, key)
        cursor.asked.pop(key, None)
    add_partitions(instance, recipe, sorted(settled - live))
    live = (live & discovery.found.keys()) | settled

    recorded = recorded_states(instance)
    plan = make_plan(recipe, workspace.store, discovery, recorded, live, workspace.index)
    active = _active_partitions(instance)
    requests: list[dg.RunRequest] = []
    for key in sorted(settled - active):
        request = _request(cursor, plan.bags[key], cursor.seen[key][0])
        if request is not None and len(requests) < MOST_REQUESTS:
            requests.append(request)
    busy = bool(requests or active)
    cursor.busy_since = None if not busy else (cursor.busy_since or now_s)
    if not busy or now_s - (cursor.busy_since or now_s) > PATIENCE_S:
        inputs = current_inputs(instance, workspace)
        record_inputs(instance, inputs)
        requests += _dataset_request(context, workspace, cursor, inputs)
        cursor.busy_since = None
    return dg.SensorResult(run_requests=requests, cursor=cursor.text())


def _request(cursor: Cursor, bag: BagPlan, state: str) -> dg.RunRequest | None:
    """Return the run that a recording needs, unless the same was asked for before and failed."""
    stale = bag.to_run()
    if not stale:
        return None
    asked = digest_json([state, {name: bag.assets[name].state for name in stale}, sorted(stale)])
    if cursor.asked.get(bag.key) == asked:
        return None
    cursor.asked[bag.key] = asked
    cursor.attempts += 1
    return dg.RunRequest(
        run_key=f"{bag.key}:{asked[:16]}:{cursor.attempts}",
        partition_key=bag.key,
        asset_selection=[dg.AssetKey(name) for name in RECORDING_ASSETS],
    )


def _dataset_request(
    context: dg.SensorEvaluationContext, workspace: Workspace, cursor: Cursor, inputs: DatasetInputs
) -> Iterable[dg.RunRequest]:
    if dataset_is_current(context.instance, workspace.recipe, inputs):
        return []
    if cursor.asked.get("") == inputs.digest:
        return []  # asked for already: it runs, or failed and waits for a change
    cursor.asked[""] = inputs.digest
    cursor.attempts += 1
    return [
        dg.RunRequest(
            run_key=f"dataset:{inputs.digest[:16]}:{cursor.attempts}",
            asset_selection=[dg.AssetKey("nuscenes_dataset")],
        )
    ]


def _active_partitions(instance: dg.DagsterInstance) -> set[str]:
    """Return partitions with a run that has not ended."""
    runs = instance.get_runs(filters=dg.RunsFilter(statuses=ACTIVE))
    return {run.tags["dagster/partition"] for run in runs if "dagster/partition" in run.tags}
