"""A build of a project: runs for the recordings that need one, side by side, then a run for the datasets.

A run is created only when a worker is free for it. One recording's failure does not stop the
others, and an interrupt loses nothing that was finished.
"""

import signal
import time
from collections.abc import Collection, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import dagster as dg

from bagassets.assets.inventory import INVENTORY
from bagassets.base.alike import names_text
from bagassets.base.errors import RecordingError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.base.trace import span
from bagassets.defs.builds.made_ahead import making_ahead
from bagassets.defs.builds.own_build import OwnBuild
from bagassets.defs.builds.own_states import OwnProject, load_own
from bagassets.defs.builds.pending_work import (
    PendingWork,
    find_pending_work,
    find_touched,
    open_project,
    update_pending_work,
)
from bagassets.defs.builds.snapshot import Snapshot
from bagassets.defs.graph.check_records import remarks_of_runs
from bagassets.defs.graph.dataset import dataset_states, record_inputs
from bagassets.defs.records.batches import WORTH_STEPS_BYTES, Batch
from bagassets.defs.records.events import recordings_made
from bagassets.defs.records.instance_plan import InstancePlan, InstancePlanning
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import DATASET, active_runs, add_partitions, remove_partition
from bagassets.defs.records.projects import forget_other_prefixes, require_own_keys
from bagassets.defs.records.touched import record_touched
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.orphaned_runs import end_orphaned_runs
from bagassets.defs.runs.run_pool import EndedRun, Listener, RunPool
from bagassets.engine.build_report import BagOutcome, BuildOptions, BuildReport, Event, Remark
from bagassets.engine.disk_space import folders_written, require_disk_space, space_needed
from bagassets.engine.plan import Plan
from bagassets.engine.splits import SplitShare, moves
from bagassets.engine.summary_rows import summary_rows
from bagassets.engine.unsettled import Unsettled
from bagassets.forkserver.worker import note
from bagassets.formats.after_crash import noted_build
from bagassets.formats.catalogue import problems_of, recording_assets
from bagassets.formats.checking import remarks_on_record
from bagassets.formats.dataset_build import dataset_folders, first_lock, split_on_disk
from bagassets.formats.dataset_integrity import remove_changed_sources
from bagassets.formats.emptiness import left_behind, why_empty
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Recipe
from bagassets.store.store import Store

__all__ = ["build_project", "build_project_in_worker"]


def build_project(recipe_file: Path, options: BuildOptions, on_event: Listener) -> BuildReport:
    """Bring all recordings and datasets up to date, and return a report.

    Raises:
        BagAssetsError: the recipe, the bag root or the server is not usable.
    """
    started = time.monotonic()
    with (
        making_ahead(recipe_file, options) as made_ahead,
        open_project(recipe_file) as (instance, known_as),
        ExitStack() as stack,
    ):
        own = load_own(known_as, options)  # first, as it knows the prefix
        workspace = own.workspace
        recipe = workspace.recipe
        require_own_keys(instance, workspace.names.prefix, recipe_file)
        if workspace.key_prefix:
            forget_other_prefixes(instance, workspace.names.prefix, recipe_file)
        end_orphaned_runs(instance)
        repaired = {"after_crash": stack.enter_context(noted_build(recipe, recipe_file))}
        repaired["changed_in_place"] = remove_changed_sources(recipe, workspace.store)

        def on_planned(done: int, total: int) -> None:
            on_event(Event.planning(done, total))

        def begin_plan() -> tuple[Snapshot, InstancePlanning]:
            snapshot = Snapshot(instance, workspace, own.files)  # of what there is before it is planned
            with span("read records"):
                return snapshot, InstancePlanning(instance, workspace)

        def plan_all() -> tuple[Snapshot, PendingWork]:
            snapshot, planning = begin_plan()
            return snapshot, find_pending_work(instance, workspace, None, own, planning, on_planned)

        snapshot, planning = begin_plan()
        touched = find_touched(workspace, planning, options, own)
        unchanged = record_touched(instance, workspace, touched, options.jobs, on_event)
        if unchanged:
            snapshot, planning = begin_plan()
        before = find_pending_work(instance, workspace, options, own, planning, on_planned)
        now, has_run, is_replanned = before, False, False
        ran: frozenset[str] = frozenset()
        report = BuildReport(before.plan, dataset_path=recipe.output)
        split_before = split_on_disk(recipe)
        report.outcomes = {key: BagOutcome("hit", seconds=seconds) for key, seconds in unchanged.items()}
        if not options.allow_empty:
            _refuse_empty(recipe, before.planned)
        # These hold until somebody does something about them.
        standing = _warnings(
            {
                "installed_packages": problems_of(recipe),
                "left_behind": left_behind(recipe),
                "series": before.plan.asked.values(),
            }
        )
        held = {"removed": [f"{key} is gone: {why}." for key, why in before.held.items()]}
        report.remarks = (*_warnings(repaired), *standing, *_warnings(held))
        report.removed = _register(instance, workspace, before)
        if before.todo or (before.datasets and not before.dataset_is_current):
            log = recipe.state / "code-server.log"
            runs = stack.enter_context(
                RunPool(instance, workspace.names, options.jobs, on_event, log, own.location)
            )
            sizes = {key: before.planned.discovery.recordings[key].size for key in before.todo}
            said = (
                *_joined(before.plan),
                before.made_again(workspace, options.jobs),
                _disk_space(before, workspace, options),
            )
            on_event(Event("planned", sizes=sizes, message="\n".join(filter(None, said))))
            going_on = _going_on(instance, workspace.names, before.datasets)
            followed = {key for keys in going_on.values() for key in keys}
            todo = {key: assets for key, assets in before.todo.items() if key not in followed}
            batches = runs.deal(todo, sizes)
            one_run = len(batches) == 1 and not going_on and _is_quick(before, batches[0], sizes)
            if one_run:
                batches = [{**batches[0], DATASET: before.datasets}]
            runs.work(batches, following=going_on)
            _note_unsettled(recipe, runs.ended)
            if one_run:  # which is likely to have left nothing to do, as only a whole plan can tell
                snapshot, now = plan_all()
                is_replanned = True
            else:
                now = update_pending_work(instance, workspace, before, runs.ended.keys(), on_planned)
            # Runs of an earlier build may have begun before the recipe or the recording changed.
            again = {key: now.todo[key] for key in followed & now.todo.keys() & before.chosen}
            if again and not runs.interrupted:
                runs.work([{key: assets} for key, assets in again.items()])
                _note_unsettled(recipe, runs.ended)
                now = update_pending_work(instance, workspace, now, runs.ended.keys(), on_planned)
            _add_outcomes(report, instance, now.planned, runs, made_ahead())
            was_tried = one_run and DATASET in runs.ended
            if before.datasets and not was_tried and not runs.interrupted:
                record_inputs(instance, workspace, now.planned.inputs)
                if not now.dataset_is_current:
                    runs.work([{DATASET: before.datasets}])
                    is_replanned = False
            report.interrupted = runs.interrupted
            ran = frozenset(runs.ended) - {DATASET}
            report.remarks += (*remarks_of_runs(instance, {one.run_id for one in runs.ended.values()}),)
            report.dataset, report.dataset_problem = _dataset_outcome(runs.ended.get(DATASET))
            has_run = True
        chosen = replace(now, chosen=before.chosen)
        own_work, own_has_run = _build_own(instance, own, chosen, options, report, on_event)
        if (has_run or own_has_run) and report.succeeded and options.is_whole:
            if own_has_run or not is_replanned:
                snapshot, now = plan_all()
            own_work = own.survey(instance, now, options)
        bags = [bag for key, bag in sorted(now.plan.bags.items()) if key in before.chosen]
        checked = [*remarks_on_record(recipe, workspace.store, now.planned.discovery, bags)]
        report.remarks += tuple(one for one in checked if one.key not in ran)
        lock = first_lock(recipe)
        report.duplicates = {} if lock is None else lock.value["duplicates"]
        failed = {} if lock is None else lock.value.get("failed", {})
        report.left_out = {key: reason for key, reason in failed.items() if key not in before.chosen}
        report.splits = {} if lock is None else _shares(lock.value["shares"])
        report.moved = moves(split_before, split_on_disk(recipe))
        report.pinned = tuple(key for key in report.moved if now.plan.ties.pinned(key, recipe.splits))
        if not before.datasets:
            report.dataset = "not selected"
        elif report.dataset == "fresh" and lock is None:
            report.dataset = "not made"
        elif report.dataset == "fresh" and report.interrupted:
            report.dataset = "stopped"
        else:
            problem = why_empty(recipe, recipe_file, workspace.store, before.datasets)
            report.dataset_problem = report.dataset_problem or problem
        report.datasets = _dataset_states(instance, workspace, now, before.datasets, report.dataset)
        report.plan, report.excluded = now.plan, now.plan.excluded
        _add_idle(report, now.plan, before.chosen, is_whole=options.is_whole)
        Unsettled(recipe.state).forget_settled(now.plan)
        if options.is_whole and now.is_settled and own_work.is_up_to_date and not report.dataset_problem:
            snapshot.save(now.plan, own.wanted, [*standing, *checked])
    report.seconds = time.monotonic() - started
    return report


def build_project_in_worker(args: JsonObject) -> JsonObject:
    """Build in a worker of the fork server; return the report as JSON, with the rows of its table as `summary`.

    So the command line need not import Dagster, which takes longer than many a build. Events are sent as notes with
    the single entry `build`. A build that is cancelled stops its runs, waits until they have ended, and reports what
    was done.

    Args:
        args: `recipe` (file), `options` (`BuildOptions.as_json`), `most` (most rows of the table; None = all).
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    recipe_file = Path(args["recipe"])

    def send(event: Event) -> None:
        note({"build": event.as_json()})

    report = build_project(recipe_file, BuildOptions.from_json(args["options"]), send)
    recipe = load_recipe(recipe_file)
    rows = summary_rows(report, Store(recipe.store_path), recording_assets(recipe), most=args["most"])
    return {**report.as_json(), "summary": [row.as_json() for row in rows]}


def _is_quick(before: PendingWork, batch: Batch, sizes: Mapping[str, int]) -> bool:
    """Return whether a second run, for the datasets, would take a good part of the time that a first one takes.

    So it is unless a recording is very large, and new: else little is to be made again. There a step for each asset shows
    more in the web UI.
    """
    recorded = before.planned.recorded
    return bool(before.datasets) and all(
        sizes[key] <= WORTH_STEPS_BYTES or INVENTORY.name in recorded.get(key, {}) for key in batch
    )


def _build_own(
    instance: dg.DagsterInstance,
    own: OwnProject,
    now: PendingWork,
    options: BuildOptions,
    report: BuildReport,
    on_event: Listener,
) -> tuple[OwnProject, bool]:
    """Bring the user's own assets up to date, and say in the report what became of them.

    Returns:
        How they stand, and whether there were any runs.
    """
    report.own_problem, report.own_left_out = own.problem, own.left_out
    if not own.wanted or report.interrupted:
        return own, False
    building = OwnBuild(instance, own, options, on_event)
    work = building.work(now, is_dataset_current=now.dataset_is_current or report.dataset == "updated")
    report.own = building.outcomes(work)
    report.interrupted = building.interrupted
    return work, building.has_run


def _going_on(
    instance: dg.DagsterInstance, names: Naming, datasets: Iterable[str]
) -> dict[str, tuple[str, ...]]:
    """Return run -> keys for the runs of earlier builds that go on: those of launchers whose runs survive the build."""
    spooled_runs = getattr(instance.run_launcher, "spooled_runs", None)
    if spooled_runs is None:
        return {}
    spooled = spooled_runs()
    return {
        run_id: keys for run_id, keys in active_runs(instance, names, datasets).items() if run_id in spooled
    }


def _shares(locked: Mapping[str, JsonMapping]) -> dict[str, JsonObject]:
    """Return the share of each split, and whether it is far from what the recipe asks for."""
    shares = [SplitShare.from_json(name, value) for name, value in locked.items()]
    return {share.name: {**share.as_json(), "is_far": share.is_far} for share in shares}


def _disk_space(pending: PendingWork, workspace: Workspace, options: BuildOptions) -> str:
    """Return one line on the disk space that a build needs and has; "" if it needs hardly any.

    Raises:
        StoreError: there is much too little.
    """
    recipe, store = workspace.recipe, workspace.store
    sizes = {key: one.size for key, one in pending.planned.discovery.recordings.items()}
    needed = space_needed(pending.plan, sizes, pending.todo, store, workspace.assets)
    if needed is None:
        return ""
    folders = folders_written(store.root, recipe)
    return require_disk_space(needed, folders, ignore=options.ignore_disk_space)


def _warnings(found: Mapping[str, Iterable[str]]) -> tuple[Remark, ...]:
    """Return what is not about a single recording, given as name -> sentences."""
    return tuple(Remark("", "warn", name, one) for name, sentences in found.items() for one in sentences)


def _refuse_empty(recipe: Recipe, planned: InstancePlan) -> None:
    """Refuse an empty bag root where there were recordings: a disk may not be mounted.

    Raises:
        RecordingError: all recordings are gone at once.
    """
    gone = len(planned.plan.removed)
    if gone and not planned.discovery.recordings:
        recordings = "the recording that was" if gone == 1 else f"all {gone} recordings that were"
        subject = "it is" if gone == 1 else "they are"
        raise RecordingError(
            f"{recipe.bags.root}: {recordings} here before cannot be found; is the disk mounted, and are "
            f"bags.include and bags.exclude right? If {subject} gone for good, use --allow-empty."
        )


def _joined(plan: Plan) -> list[str]:
    """Return sentences about the recordings that become parts of series."""
    return [f"{names_text(keys)}: joined into {whole}, as its parts." for whole, keys in plan.joined.items()]


def _register(instance: dg.DagsterInstance, workspace: Workspace, before: PendingWork) -> tuple[str, ...]:
    """Add partitions for new recordings, remove those of recordings that are gone, and return the keys of these.

    Those that have become parts of series are not gone.
    """
    planned = before.planned
    gone = [key for key in planned.plan.removed if key not in before.held]
    for key in gone:
        remove_partition(instance, workspace.names, key)
    add_partitions(instance, workspace.names, sorted(planned.discovery.recordings.keys() - planned.live))
    return tuple(key for key in planned.plan.gone if key not in before.held)


def _note_unsettled(recipe: Recipe, ended: Mapping[str, EndedRun]) -> None:
    """Note the recordings whose runs did not end well, also those of a worker that was killed."""
    unsettled = Unsettled(recipe.state)
    noted = unsettled.noted()  # of most recordings nothing is: their worker has seen to it
    for key, one in ended.items():
        if key == DATASET or not one.run_id:
            continue
        if one.problem is not None or one.stopped:
            unsettled.add(key)
        elif key in noted:
            unsettled.discard(key)


def _add_outcomes(
    report: BuildReport,
    instance: dg.DagsterInstance,
    planned: InstancePlan,
    runs: RunPool,
    made_ahead: Mapping[str, str],
) -> None:
    """Add the outcome of each recording that had a run to the report.

    Args:
        report: what to add to.
        instance: where the runs recorded what they made.
        planned: the state after the runs.
        runs: the runs.
        made_ahead: recordings whose inventories were made ahead of them -> digest of their content.
    """
    ended = {key: one for key, one in runs.ended.items() if key != DATASET}
    # A run that made the datasets, too, has planned its recordings since they were recorded.
    unknown = ended.keys() - planned.recorded.keys()
    made_by_run = {
        run_id: recordings_made(instance, run_id) for run_id in {ended[key].run_id for key in unknown} - {""}
    }
    for key, one in ended.items():
        bag = planned.plan.bags.get(key)
        was_made_ahead = bag is not None and made_ahead.get(key) == bag.recorded.get("bag", "")
        has_made = (
            was_made_ahead
            or key in made_by_run.get(one.run_id, ())
            or any(
                record.run_id == one.run_id and record.cached is False
                for record in planned.recorded.get(key, {}).values()
            )
        )
        report.outcomes[key] = _outcome(one, has_made=has_made)


def _outcome(ended: EndedRun, *, has_made: bool) -> BagOutcome:
    if ended.stopped:
        return BagOutcome("stopped", "the build was interrupted; the next one carries on", ended.seconds)
    if ended.problem is not None:
        return BagOutcome("failed", ended.problem, ended.seconds)
    return BagOutcome("built" if has_made else "hit", seconds=ended.seconds)


def _dataset_outcome(ended: EndedRun | None) -> tuple[str, str]:
    if ended is None:
        return "fresh", ""
    if ended.stopped:
        return "stopped", ""
    return ("updated", "") if ended.problem is None else ("failed", ended.problem)


def _dataset_states(
    instance: dg.DagsterInstance,
    workspace: Workspace,
    now: PendingWork,
    asked: Collection[str],
    outcome: str,
) -> dict[str, JsonMapping]:
    """See `BuildReport.datasets`. One run makes all of them; if it failed, some may be up to date."""
    left = {*asked}
    # Where results are yet to come, nobody knows whether a dataset that is not behind is up to date.
    is_waiting = any(one.state == "unknown" for one in now.states.values())
    if outcome == "failed" or (outcome == "stopped" and not is_waiting):
        states = dataset_states(instance, workspace, now.planned.inputs)
        left &= {asset for asset, one in states.items() if one.state != "fresh"}

    def state(asset: str) -> str:
        return outcome if asset in left else "fresh" if asset in asked else "not selected"

    folders = dataset_folders(workspace.recipe)
    return {asset: {"path": str(folder), "state": state(asset)} for asset, folder in folders.items()}


def _add_idle(report: BuildReport, plan: Plan, chosen: frozenset[str], *, is_whole: bool) -> None:
    """Add the recordings without a run, and correct those with one that take no part or have changed since."""
    for key, bag in plan.bags.items():
        ran = report.outcomes.get(key)
        if key not in chosen:
            continue
        if ran is not None and ran.result in {"built", "hit"} and bag.assets["bag"].state != "fresh":
            reason = "it changed after it had been read; the next build carries on"
            report.outcomes[key] = BagOutcome("stopped", reason, ran.seconds)
        elif bag.skipped is not None and (ran is None or ran.result in {"built", "hit"}):
            report.outcomes[key] = BagOutcome("skipped", bag.skipped, ran.seconds if ran else 0.0)
        elif ran is None and bag.failed is not None:
            hint = " (failed before; --retry-failed tries again)" if bag.can_be_retried else ""
            report.outcomes[key] = BagOutcome("failed", bag.failed + hint)
        elif ran is None and (bag.settled or not is_whole):
            report.outcomes[key] = BagOutcome("fresh")
        elif ran is None:
            waiting = next(one.reason for one in bag.assets.values() if not one.is_settled)
            report.outcomes[key] = BagOutcome("stopped", f"{waiting}; the next build carries on")
    report.outcomes = dict(sorted(report.outcomes.items()))
