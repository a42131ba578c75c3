"""A build of a project: runs for the recordings that need one, side by side, then a run for the datasets.

A run is created only when a worker is free for it. One recording's failure does not stop the
others, and an interrupt loses nothing that was finished.
"""

import signal
import time
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path

from bagassets.base.json_types import JsonObject
from bagassets.defs.builds.loop import BuildLoop
from bagassets.defs.builds.made_ahead import making_ahead
from bagassets.defs.builds.own_build import OwnBuild
from bagassets.defs.builds.own_states import load_own
from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.builds.report import checked_remarks, left_over, report_of, standing_remarks, warnings
from bagassets.defs.graph.dataset import write_report
from bagassets.defs.records.projects import forget_other_prefixes, require_own_keys
from bagassets.defs.runs.orphaned_runs import end_orphaned_runs
from bagassets.defs.runs.run_pool import Listener
from bagassets.engine.batches import DATASET
from bagassets.engine.build_report import BuildOptions, BuildReport
from bagassets.engine.summary_rows import summary_rows
from bagassets.engine.unsettled import Unsettled
from bagassets.forkserver.worker import note
from bagassets.formats.after_crash import noted_build
from bagassets.formats.catalogue import recording_assets
from bagassets.formats.dataset_build import datasets_of, first_lock, split_on_disk
from bagassets.formats.dataset_integrity import remove_changed_sources
from bagassets.formats.emptiness import replaced
from bagassets.formats.report_data import report_path
from bagassets.recipe import load_recipe


def build_project(recipe_file: Path, options: BuildOptions, on_event: Listener) -> BuildReport:
    """Bring all recordings and datasets up to date, and return a report.

    Raises:
        BagAssetsError: the recipe, the bag root or the server is not usable.
    """
    started = time.monotonic()
    with (
        making_ahead(recipe_file, options),
        open_project(recipe_file) as known_as,
        ExitStack() as stack,
    ):
        own = load_own(known_as, options)  # first, as it knows the prefix
        workspace = own.workspace
        recipe, instance = workspace.recipe, workspace.instance
        require_own_keys(instance, workspace.names.prefix, recipe_file)
        if workspace.key_prefix:
            forget_other_prefixes(instance, workspace.names.prefix, recipe_file)
        end_orphaned_runs(instance)
        repaired = warnings("after_crash", stack.enter_context(noted_build(recipe, recipe_file)))
        repaired += warnings("replaced", replaced(recipe))
        repaired += warnings("changed_in_place", remove_changed_sources(recipe, workspace.store))

        build = BuildLoop(own, options, on_event)
        split_before = split_on_disk(recipe)
        build.work()

        own_build, own_work = OwnBuild(own, options, on_event), own
        if own.wanted and not build.interrupted:
            # Recordings that came meanwhile are left to the next build.
            own_work = own_build.work(replace(build.now, asked=build.before.asked))
        own_outcomes = own_build.outcomes(own_work) if own_work.states else {}
        is_partial = build.is_partial or own_build.has_run
        if is_partial and options.is_whole and build.has_succeeded and not own_work.failed:
            own_work = own.survey(build.look_on())

        before, now = build.before, build.now
        if options.is_whole and now.plan.bags and not report_path(recipe).exists():
            write_report(workspace, now.plan)  # a crash tore it, or it could not be written
        interrupted = build.interrupted or own_build.interrupted
        lock = first_lock(datasets_of(recipe))
        report = report_of(build, lock, split_before, interrupted=interrupted)
        report.own_problem, report.own_left_out = own.problem, own.left_out
        report.own = own_outcomes
        standing, checked = standing_remarks(recipe, lock, before, now), checked_remarks(build)
        held = warnings("removed", [f"{key} is gone: {why}." for key, why in before.held.items()])
        others = [one for one in checked if one.key not in build.ended.keys() - {DATASET}]
        left = left_over(build, report) if options.is_whole and not interrupted else ()
        report.remarks = (*left, *repaired, *standing, *held, *report.remarks, *others)
        Unsettled(recipe.state).forget_settled(now.plan)
        if options.is_whole and now.is_settled and own_work.is_up_to_date and not report.dataset_problem:
            build.snapshot.save(now.plan, own.wanted, [*standing, *checked])
    report.seconds = time.monotonic() - started
    return report


def build_project_in_worker(args: JsonObject) -> JsonObject:
    """Build in a worker of the fork server; return the report as JSON, with the rows of its table as `summary`.

    So the command line need not import Dagster, which takes longer than many a build. Events are sent as notes with
    the single entry `build`. A build that is cancelled stops its runs, waits until they have ended, and reports what
    was done.

    Args:
        args: `recipe` (file), `options` (`BuildOptions` as JSON), `most` (most rows of the table; None = all).
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    recipe_file = Path(args["recipe"])
    options = BuildOptions.from_json(args["options"])
    report = build_project(recipe_file, options, lambda event: note({"build": asdict(event)}))
    rows = summary_rows(report, recording_assets(load_recipe(recipe_file)), most=args["most"])
    return {**report.as_json(), "summary": [row.as_json() for row in rows]}
