"""The build driver: which recordings need a run, running them side by side, then the dataset.

A run is created only when a worker is free for it. One recording's failure does not stop the
others.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import dagster as dg

from bagassets.defs.dataset import current_inputs, dataset_is_current, record_inputs
from bagassets.defs.events import live_partitions, recorded_states
from bagassets.defs.partitions import add_partitions, remove_partition
from bagassets.defs.runs import open_instance
from bagassets.defs.workspace import Workspace
from bagassets.engine.plan import RECORDING_ASSETS, Plan, make_plan
from bagassets.forkserver.client import Client
from bagassets.forkserver.tasks import connect, server_spec, submit_build
from bagassets.recipe.project import dagster_home

__all__ = ["BuildReport", "Event", "build"]

SUCCESS = "SUCCESS"


@dataclass(frozen=True)
class Event:
    """Progress: `started`, `done` or `failed` of a recording, or of the dataset (key empty)."""

    kind: str
    key: str
    message: str = ""


@dataclass
class BuildReport:
    """What a build came to.

    Attributes:
        built: recordings whose runs succeeded.
        failed: recording -> sentence.
        fresh: recordings that needed nothing.
        skipped: recording -> why it takes no part.
        removed: recordings that were gone.
        dataset: `updated`, `fresh` or `failed`.
    """

    built: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    fresh: list[str] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)
    removed: list[str] = field(default_factory=list)
    dataset: str = "fresh"


def build(
    recipe_file: Path, *, jobs: int, retry_failed: bool, on_event: Callable[[Event], None]
) -> BuildReport:
    """Bring all recordings and the dataset up to date.

    Raises:
        BagAssetsError: the recipe, the bag root or the server is not usable.
    """
    workspace = Workspace(recipe_file=str(recipe_file))
    recipe = workspace.recipe
    home = str(dagster_home(recipe_file, recipe))
    os.environ["BAGASSETS_RECIPE"] = str(recipe_file)
    report = BuildReport()
    with open_instance(home) as instance:
        plan = _plan(instance, workspace, report)
        todo = _todo(plan, report, retry_failed=retry_failed)
        inputs = current_inputs(instance, workspace)
        if not todo and dataset_is_current(instance, recipe, inputs):
            return report
        with connect(server_spec(recipe.state, recipe_file), home) as client:
            _run_all(client, home, todo, jobs, report, on_event)
            inputs = current_inputs(instance, workspace)
            report.skipped = dict(inputs.skipped)
            if not dataset_is_current(instance, recipe, inputs):
                record_inputs(instance, inputs)
                report.dataset = _run_dataset(client, home, report, on_event)
    return report


def _plan(instance: dg.DagsterInstance, workspace: Workspace, report: BuildReport) -> Plan:
    """Register what is new, drop what is gone, and decide."""
    recipe, discovery = workspace.recipe, workspace.discover()
    live = live_partitions(instance, recipe)
    for key in sorted(live - discovery.found.keys()):
        remove_partition(instance, recipe, key)
        report.removed.append(key)
    add_partitions(instance, recipe, sorted(discovery.found.keys() - live))
    live = frozenset(discovery.found)
    recorded = recorded_states(instance)
    return make_plan(recipe, workspace.store, discovery, recorded, live, workspace.index)


def _todo(plan: Plan, report: BuildReport, *, retry_failed: bool) -> list[str]:
    todo = []
    for key, bag in plan.bags.items():
        if bag.to_run(retry_failed=retry_failed):
            todo.append(key)
        elif bag.skipped is not None:
            report.skipped[key] = bag.skipped
        elif bag.failed is not None:
            report.failed[key] = f"{bag.failed} (failed before; --retry-failed tries again)"
        else:
            report.fresh.append(key)
    return todo


def _run_all(
    client: Client,
    home: str,
    todo: list[str],
    jobs: int,
    report: BuildReport,
    on_event: Callable[[Event], None],
) -> None:
    waiting = list(reversed(todo))
    running: dict[str, str] = {}
    while waiting or running:
        while waiting and len(running) < jobs:
            key = waiting.pop()
            job, _ = submit_build(client, home, RECORDING_ASSETS, partition_key=key)
            running[job] = key
            on_event(Event("started", key))
        event = client.wait()
        if event is None or event["event"] not in {"finished", "killed"} or event["job"] not in running:
            continue
        key = running.pop(event["job"])
        problem = _problem(event)
        if problem is None:
            report.built.append(key)
            on_event(Event("done", key))
        else:
            report.failed[key] = problem
            on_event(Event("failed", key, problem))


def _run_dataset(client: Client, home: str, report: BuildReport, on_event: Callable[[Event], None]) -> str:
    on_event(Event("started", ""))
    job, _ = submit_build(client, home, ["nuscenes_dataset"])
    while True:
        event = client.wait()
        if event is not None and event["event"] in {"finished", "killed"} and event["job"] == job:
            break
    problem = _problem(event)
    if problem is None:
        on_event(Event("done", ""))
        return "updated"
    report.failed["dataset"] = problem
    on_event(Event("failed", "", problem))
    return "failed"


def _problem(event: dict[str, Any]) -> str | None:
    """Return why a run failed, in words, or None if it succeeded."""
    if event["event"] == "killed":
        return str(event["reason"])
    if event["exit"] != 0:
        return str(event["error"]["message"])
    result = event["result"]
    if result["status"] == SUCCESS:
        return None
    messages = [failure["message"] for failure in result["failures"] if failure["message"]]
    return messages[0] if messages else f"run {result['run_id']} ended {result['status']}"
