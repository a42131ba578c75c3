"""The build driver: which recordings need a run, running them side by side, then the dataset.

A run is created only when a worker is free for it. One recording's failure does not stop the
others, and an interrupt loses nothing that was finished.
"""

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import dagster as dg

from bagassets.defs.dataset import dataset_is_current, record_inputs
from bagassets.defs.partitions import add_partitions, remove_partition
from bagassets.defs.planning import Planned, plan_now
from bagassets.defs.runs import open_instance
from bagassets.defs.workspace import Workspace
from bagassets.engine.build_report import DATASET, BagOutcome, BuildOptions, BuildReport, Event
from bagassets.engine.dataset_build import dataset_code_versions
from bagassets.engine.plan_model import Plan, Recorded
from bagassets.forkserver.client import Client
from bagassets.forkserver.tasks import connect, server_spec, submit_build
from bagassets.recipe.project import dagster_home

__all__ = ["Situation", "build", "survey"]

SUCCESS = "SUCCESS"
_CANCEL_GRACE_S = 20.0
_POLL_S = 0.5

Listener = Callable[[Event], None]


@dataclass(frozen=True)
class Situation:
    """The state of everything as it is now.

    Attributes:
        planned: states of recordings, and what a dataset would be made from.
        dataset_is_current: the datasets on disk were made from just that.
    """

    planned: Planned
    dataset_is_current: bool

    @property
    def plan(self) -> Plan:
        """The states of all recordings."""
        return self.planned.plan


def survey(
    instance: dg.DagsterInstance, workspace: Workspace, live: frozenset[str] | None = None
) -> Situation:
    """Look at everything and decide, changing nothing.

    Raises:
        BagAssetsError: the recipe or the bag root is not usable.
    """
    planned = plan_now(instance, workspace, live)
    return Situation(planned, dataset_is_current(instance, workspace.recipe, planned.inputs))


def build(recipe_file: Path, options: BuildOptions, on_event: Listener) -> BuildReport:
    """Bring all recordings and the dataset up to date.

    Raises:
        BagAssetsError: the recipe, the bag root or the server is not usable.
    """
    started = time.monotonic()
    recipe_file = recipe_file.absolute()
    workspace = Workspace(recipe_file=str(recipe_file))
    recipe = workspace.recipe
    home = str(dagster_home(recipe_file, recipe))
    os.environ["BAGASSETS_RECIPE"] = str(recipe_file)
    with open_instance(home) as instance:
        before = survey(instance, workspace)
        removed = _register(instance, workspace, before.planned)
        todo = {
            key: bag.to_run(retry_failed=options.retry_failed, select=options.select)
            for key, bag in before.plan.bags.items()
            if options.bags is None or key in options.bags
        }
        todo = {key: assets for key, assets in todo.items() if assets}
        report = BuildReport(before.plan, dataset_path=recipe.nuscenes.output, removed=removed)
        with_dataset = options.select is None or DATASET in options.select
        now = before
        if todo or (with_dataset and not before.dataset_is_current):
            with connect(server_spec(recipe.state, recipe_file), home) as client:
                sizes = {key: before.planned.discovery.found[key].size for key in todo}
                on_event(Event("planned", sizes=sizes))
                runs = _Runs(client, home, options.jobs, on_event)
                runs.work(todo)
                now = survey(instance, workspace)
                if with_dataset and not now.dataset_is_current and not runs.interrupted:
                    record_inputs(instance, now.planned.inputs)
                    runs.work({"": tuple(dataset_code_versions(recipe))})
            report.interrupted = runs.interrupted
            report.outcomes = {
                key: _outcome(now.planned.recorded.get(key, {}), ended)
                for key, ended in runs.ended.items()
                if key
            }
            report.dataset, report.dataset_problem = _dataset_outcome(runs.ended.get(""))
        if not with_dataset:
            report.dataset = "not selected"
        report.plan = now.plan
        _add_idle(report, options)
    report.seconds = time.monotonic() - started
    return report


def _register(instance: dg.DagsterInstance, workspace: Workspace, planned: Planned) -> tuple[str, ...]:
    """Make partitions of what is new, drop those of what is gone, and return the latter."""
    for key in planned.plan.removed:
        remove_partition(instance, workspace.recipe, key)
    add_partitions(instance, workspace.recipe, sorted(planned.discovery.found.keys() - planned.live))
    return planned.plan.removed


@dataclass(frozen=True)
class _Ended:
    """How one run ended: its id, why it failed (None if it did not), whether it was stopped."""

    run_id: str
    problem: str | None
    stopped: bool
    seconds: float


@dataclass
class _Runs:
    """Runs on the workers of a server, a limited number at a time."""

    client: Client
    home: str
    jobs: int
    on_event: Listener
    ended: dict[str, _Ended] = field(default_factory=dict)
    interrupted: bool = False

    def work(self, todo: dict[str, tuple[str, ...]]) -> None:
        """Run the assets of each recording; the key of unpartitioned assets is empty.

        On an interrupt the runs are cancelled and their end is awaited; a second one does not wait.
        """
        waiting = list(reversed(todo.items()))
        running: dict[str, tuple[str, str, float]] = {}
        try:
            while waiting or running:
                while waiting and len(running) < self.jobs:
                    key, assets = waiting.pop()
                    job, run_id = submit_build(self.client, self.home, assets, partition_key=key or None)
                    running[job] = (key, run_id, time.monotonic())
                    self.on_event(Event("started", key))
                self._take(running, None)
        except KeyboardInterrupt:
            self.interrupted = True
            self._stop(running)
            for key, _ in waiting:
                self.ended[key] = _Ended("", None, stopped=True, seconds=0.0)

    def _stop(self, running: dict[str, tuple[str, str, float]]) -> None:
        for job in running:
            self.client.cancel(job, grace_s=_CANCEL_GRACE_S)
        deadline = time.monotonic() + _CANCEL_GRACE_S + 5.0
        while running and time.monotonic() < deadline:
            self._take(running, _POLL_S)

    def _take(self, running: dict[str, tuple[str, str, float]], timeout_s: float | None) -> None:
        """Wait for one event and note the end of a run."""
        event = self.client.wait(timeout_s)
        if event is None or event["event"] not in {"finished", "killed"} or event["job"] not in running:
            return
        key, run_id, since = running.pop(event["job"])
        problem = _problem(event)
        stopped = problem is not None and self.interrupted
        self.ended[key] = _Ended(run_id, problem, stopped, time.monotonic() - since)
        if stopped:
            self.on_event(Event("stopped", key))
        elif problem is not None:
            self.on_event(Event("failed", key, problem))
        else:
            self.on_event(Event("done", key))


def _outcome(recorded: Mapping[str, Recorded], ended: _Ended) -> BagOutcome:
    if ended.stopped:
        return BagOutcome("stopped", "the build was interrupted; the next one carries on", ended.seconds)
    if ended.problem is not None:
        return BagOutcome("failed", ended.problem, ended.seconds)
    ran = any(record.run_id == ended.run_id and record.cached is False for record in recorded.values())
    return BagOutcome("built" if ran else "hit", seconds=ended.seconds)


def _dataset_outcome(ended: _Ended | None) -> tuple[str, str]:
    if ended is None:
        return "fresh", ""
    if ended.stopped:
        return "stopped", ""
    return ("updated", "") if ended.problem is None else ("failed", ended.problem)


def _add_idle(report: BuildReport, options: BuildOptions) -> None:
    """Add the recordings that had no run, and tell of those with one that they take no part."""
    for key, bag in report.plan.bags.items():
        ran = report.outcomes.get(key)
        if options.bags is not None and key not in options.bags:
            continue
        if bag.skipped is not None and (ran is None or ran.result in {"built", "hit"}):
            report.outcomes[key] = BagOutcome("skipped", bag.skipped, ran.seconds if ran else 0.0)
        elif ran is None and bag.failed is not None:
            report.outcomes[key] = BagOutcome(
                "failed", f"{bag.failed} (failed before; --retry-failed tries again)"
            )
        elif ran is None:
            report.outcomes[key] = BagOutcome("fresh")
    report.outcomes = dict(sorted(report.outcomes.items()))


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
