"""What a build reports: functions of the state before, the state now and the runs that ended in between."""

import fnmatch
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import chain
from pathlib import Path

import dagster as dg

from bagassets.assets.inventory import INVENTORY
from bagassets.assets.quality.topic_rules import watched_topics
from bagassets.base.errors import StoreError
from bagassets.base.fingerprints import recipe_fingerprint
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.defs.builds.loop import BuildLoop
from bagassets.defs.builds.pending_work import PendingWork
from bagassets.defs.records.events import recordings_made
from bagassets.defs.runs.run_pool import EndedRun
from bagassets.engine.batches import DATASET
from bagassets.engine.build_report import BagOutcome, BuildReport, Remark
from bagassets.engine.plan import BagPlan, Plan
from bagassets.engine.splits import SplitShare, moves
from bagassets.engine.targets import TO_MAKE
from bagassets.formats.catalogue import problems_of
from bagassets.formats.checking import remarks_on_record
from bagassets.formats.dataset_build import Dataset, dataset_folders, datasets_of
from bagassets.formats.dataset_lock import DatasetLock
from bagassets.formats.emptiness import left_behind, why_empty
from bagassets.formats.same_data import LOOKED_AT, same_data
from bagassets.recipe.model import Recipe
from bagassets.recipe.schema import suggestion
from bagassets.recordings.globs import matches
from bagassets.store.store import Store

# There may be thousands of names, and thousands of recordings to compare each of these with.
_WILDCARDS = frozenset("*?[")
_MOST_LOOKED_AT = 20


def report_of(
    build: BuildLoop, lock: DatasetLock | None, split_before: Mapping[str, str], *, interrupted: bool
) -> BuildReport:
    """Return the report of a build, without the user's own assets, and with the remarks on what its runs have made.

    Args:
        build: what was found and done.
        lock: of the first dataset that has one.
        split_before: recording -> its split on disk when the build began.
        interrupted: somebody stopped the build.
    """
    workspace, before, now = build.workspace, build.before, build.now
    recipe = workspace.recipe
    datasets = datasets_of(recipe)
    locked: JsonMapping = {} if lock is None else lock.value
    left_out = locked.get("failed", {})
    misfits = _misfits(datasets, now)
    moved = moves(split_before, {} if lock is None else lock.splits)
    dataset, problem = _of_datasets(build.ended.get(DATASET))
    if not before.asked.datasets:
        dataset = "not selected"
    elif dataset == "fresh" and lock is None:
        dataset = "not made"
    elif dataset == "fresh" and (interrupted or _is_waiting(now)):
        dataset = "stopped"
    else:
        recipe_file = Path(workspace.recipe_file)
        problem = problem or why_empty(recipe, recipe_file, workspace.store, before.asked.datasets)
    return BuildReport(
        plan=now.plan,
        outcomes=_outcomes(build),
        excluded=now.plan.excluded,
        removed=tuple(key for key in before.plan.gone if key not in before.held),
        remarks=tuple(remarks_of_runs(workspace.instance, {one.run_id for one in build.ended.values()})),
        duplicates=locked.get("duplicates", {}),
        left_out={key: reason for key, reason in left_out.items() if key not in before.asked.chosen}
        | misfits,
        moved=moved,
        pinned=tuple(key for key in moved if now.plan.ties.pinned(key, recipe.splits)),
        splits=_shares(locked.get("shares", {})),
        dataset=dataset,
        dataset_problem=problem,
        dataset_path=recipe.output,
        datasets=_each_dataset(recipe, now, dataset),
        interrupted=interrupted,
    )


def _misfits(datasets: Mapping[str, Dataset], now: PendingWork) -> dict[str, str]:
    """Return the recordings that were made, but do not fit into a dataset -> why."""
    locks = [one.lock for one in datasets.values() if one.kind.misfits is not None]
    bags = now.plan.bags
    return {
        key: why
        for lock in locks
        if lock is not None
        for key, why in lock.value["skipped"].items()
        if key in bags and bags[key].skipped is None
    }


# --- remarks -----------------------------------------------------------------------------


def warnings(name: str, sentences: Iterable[str]) -> tuple[Remark, ...]:
    """Return sentences that are not about a single recording as remarks of a check with this name."""
    return tuple(Remark("", "warn", name, one) for one in sentences)


def standing_remarks(
    recipe: Recipe, lock: DatasetLock | None, before: PendingWork, now: PendingWork
) -> tuple[Remark, ...]:
    """Return what holds until somebody does something about it."""
    packages = warnings("installed_packages", problems_of(recipe))
    left = warnings("left_behind", left_behind(recipe).values())
    keys, bags = before.plan.bags.keys(), now.plan.bags
    doubts = (one for settings in recipe.dataset_settings.values() for one in settings.doubts(keys))
    unknown = warnings("unknown_recordings", [*_names_of_none(recipe, before.plan), *doubts])
    topics = warnings("unknown_topics", _topics_of_none(recipe, now.plan))
    used = [key for key, bag in lock.bags.items() if any(bag.counts.values())] if lock is not None else ()
    versions = {key: [*filter(None, map(bags[key].version, LOOKED_AT))] for key in used if key in bags}
    copies = warnings("same_content", same_data(versions, Store(recipe.store_path), recipe.state))
    return (*packages, *left, *unknown, *topics, *copies, *warnings("series", before.plan.asked.values()))


def _names_of_none(recipe: Recipe, plan: Plan) -> Iterator[str]:
    """Yield a sentence about each field of the recipe that names recordings of which there are none."""
    found = plan.discovery.recordings.values()
    for glob in recipe.bags.exclude:
        below = f"{glob.rstrip('/')}/**"
        if not set(glob) & _WILDCARDS and any(matches(below, one.relative) for one in found):
            yield f"bags.exclude: {glob} is a folder, whose recordings it does not leave out; {below} does"
    known = dict.fromkeys(chain(plan.bags, *plan.ties.former.values()))
    fields: list[tuple[str, Iterable[str]]] = [("splits.pinned", recipe.splits.pinned)]
    for one in recipe.datasets:
        of_scenes = [_recording_of(name, known) for name in one.scenes]
        fields.append((f"datasets: {one.name}", [*one.recordings, *of_scenes]))
    for field, names in fields:
        unknown = [
            name
            for name in names
            if name not in known and not (set(name) & _WILDCARDS and fnmatch.filter(known, name))
        ]
        if unknown:
            more = f" (nor what {len(unknown) - 1} more of its names stand for)" if unknown[1:] else ""
            hint = suggestion(unknown[0], [*known]) or "; `bagassets status --all` lists the keys."
            yield f"{field}: there is no recording {unknown[0]}{more}{hint}"


def _recording_of(scene: str, known: Collection[str]) -> str:
    """Return the recording of a scene or, of a glob of scenes, the beginning that stands for some; the glob itself if none does."""
    if not set(scene) & _WILDCARDS:
        return scene.rpartition("_")[0]
    heads = (scene[:end] for end in range(len(scene), 0, -1))
    return next((head for head in heads if fnmatch.filter(known, head)), scene)


def _topics_of_none(recipe: Recipe, plan: Plan) -> Iterator[str]:
    """Yield a sentence about each topic with limits that no recording has; of many recordings some are looked at."""
    unknown = {topic for topic, one in recipe.checks.topic_rates.limits.items() if not one.required}
    unknown -= {topic for rig in recipe.rigs for topic in watched_topics(rig)}
    bags, known = [*plan.bags.values()], set[str]()
    looked_at = bags[:: len(bags) // _MOST_LOOKED_AT + 1] if unknown else []
    for bag in looked_at:
        with suppress(StoreError):
            inventory = Store(recipe.store_path).artifact(bag.version(INVENTORY.name) or "")
            known.update(one["name"] for one in inventory.read_json("inventory.json")["topics"])
    for topic in sorted(unknown - known) if known else ():
        hint = f" ({len(looked_at)} of {len(bags)} were looked at){suggestion(topic, [*known])}"
        yield f"checks.topic_rates.limits: there is no topic {topic} in the recordings{hint}"


def left_over(build: BuildLoop, report: BuildReport) -> tuple[Remark, ...]:
    """Return what is left to the next build although this one was asked for everything, and nothing else says so."""
    if recipe_fingerprint(build.workspace.recipe_file) != build.workspace.recipe_fingerprint:
        # Some runs may have read it anew: what is left to do, only the next plan knows.
        name = Path(build.workspace.recipe_file).name
        return warnings("left_over", [f"{name} was edited while this was built; build again"])
    told = {key for key, one in report.outcomes.items() if one.result in {"failed", "stopped"}}
    told.update(report.removed)  # since the last look
    why = "it came, changed or went while this was built; build again"
    came = sorted({*build.now.todo, *build.now.leaving} - told)
    return tuple(Remark(key, "warn", "left_over", why) for key in came)


def remarks_of_runs(instance: dg.DagsterInstance, run_ids: Collection[str]) -> list[Remark]:
    """Return the findings of the asset checks in some runs; empty ids are of recordings that had none."""
    remarks = []
    for run_id in sorted(filter(None, run_ids)):
        for entry in instance.all_logs(run_id, of_type=dg.DagsterEventType.ASSET_CHECK_EVALUATION):
            found = entry.asset_check_evaluation
            if found is not None and not found.passed:
                # Users' own checks need not count their problems.
                number = found.metadata.get("problems")
                more = 0 if number is None else int(str(number.value)) - 1
                said = (found.description or "") + (f" (and {more} more)" if more > 0 else "")
                weight = found.severity.value.lower()
                remarks.append(Remark(found.partition or "", weight, found.check_name, said))
    return sorted(remarks, key=lambda remark: remark.key)


def checked_remarks(build: BuildLoop) -> list[Remark]:
    """Return what quick checks find in the recordings that the build was asked for."""
    plan = build.now.plan
    bags = [bag for key, bag in sorted(plan.bags.items()) if key in build.before.asked.chosen]
    return [*remarks_on_record(build.workspace.assets, plan.discovery, bags)]


# --- recordings --------------------------------------------------------------------------


def _outcomes(build: BuildLoop) -> dict[str, BagOutcome]:
    """Return recording -> its outcome, sorted, for those that the build was asked for, and others whose runs it followed."""
    bags = build.now.plan.bags
    ended = {key: one for key, one in build.ended.items() if key != DATASET}
    # A run about one recording notes no such thing in its log; its events show it.
    unknown = {one.run_id for one in ended.values() if one.has_made is None} - {""}
    made_by_run = {run_id: recordings_made(build.workspace.instance, run_id) for run_id in unknown}
    found = {key: BagOutcome("hit", seconds=seconds) for key, seconds in build.unchanged.items()}
    for key, one in ended.items():
        has_made = one.has_made or key in made_by_run.get(one.run_id, ())
        found[key] = _of_run(one, has_made=has_made)
    for key in build.before.asked.chosen & bags.keys():
        found[key] = _of_recording(bags[key], found.get(key), is_whole=build.options.is_whole)
    return dict(sorted(found.items()))


def _of_run(ended: EndedRun, *, has_made: bool) -> BagOutcome:
    if ended.stopped:
        return BagOutcome("stopped", "the build was interrupted; the next one carries on", ended.seconds)
    if ended.problem is not None:
        return BagOutcome("failed", ended.problem, ended.seconds)
    return BagOutcome("built" if has_made else "hit", seconds=ended.seconds)


def _of_recording(bag: BagPlan, ran: BagOutcome | None, *, is_whole: bool) -> BagOutcome:
    """Return the outcome of a recording: of one without a run by its state; one with a run may have changed since."""
    if ran is not None and ran.result not in {"built", "hit"}:
        return ran
    if ran is not None and bag.assets["bag"].state != "fresh":
        reason = "it changed after it had been read; the next build carries on"
        return BagOutcome("stopped", reason, ran.seconds)
    if bag.skipped is not None:
        return BagOutcome("skipped", bag.skipped, ran.seconds if ran else 0.0)
    if ran is not None:
        return ran
    if bag.failed is not None:
        hint = " (failed before; --retry-failed tries again)" if bag.can_be_retried else ""
        return BagOutcome("failed", bag.failed + hint)
    if bag.settled or not is_whole:
        return BagOutcome("fresh")
    waiting = next(one.reason for one in bag.assets.values() if not one.is_settled)
    return BagOutcome("stopped", f"{waiting}; the next build carries on")


# --- datasets ----------------------------------------------------------------------------


def _of_datasets(ended: EndedRun | None) -> tuple[str, str]:
    """Return what became of the datasets, and the problem; one run makes all of them."""
    if ended is None:
        return "fresh", ""
    if ended.stopped:
        return "stopped", ""
    return ("updated", "") if ended.problem is None else ("failed", ended.problem)


def _is_waiting(now: PendingWork) -> bool:
    """Tell whether results are yet to come, so that nobody knows whether a dataset that is not behind is up to date."""
    return any(one.state == "unknown" for one in now.dataset_states.values())


def _each_dataset(recipe: Recipe, now: PendingWork, outcome: str) -> dict[str, JsonMapping]:
    """See `BuildReport.datasets`. If the run of all failed, some may be up to date."""
    left = {*now.asked.datasets}
    if outcome == "failed" or (outcome == "stopped" and not _is_waiting(now)):
        left &= {asset for asset, one in now.states.items() if one.state in TO_MAKE}

    def state(asset: str) -> str:
        return outcome if asset in left else "fresh" if asset in now.asked.datasets else "not selected"

    folders = dataset_folders(recipe)
    return {asset: {"path": str(folder), "state": state(asset)} for asset, folder in folders.items()}


def _shares(locked: Mapping[str, JsonMapping]) -> dict[str, JsonObject]:
    """Return the share of each split, and whether it is far from what the recipe asks for."""
    shares = [SplitShare.from_json(name, value) for name, value in locked.items()]
    return {share.name: {**share.as_json(), "is_far": share.is_far} for share in shares}
