"""Data of reports and maps, gathered from the plan and its artifacts."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

from bagassets.assets.annotations import ANNOTATIONS, TABLE
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.assets.inventory import INVENTORY
from bagassets.base.cache import Kept
from bagassets.base.errors import StoreError
from bagassets.base.json_types import JsonObject
from bagassets.base.quantities import count_text
from bagassets.engine.freshness.published import Publication
from bagassets.engine.plan import BagPlan, KeptPlan, Plan
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.engine.splits import shares_of
from bagassets.engine.track import track_on_record
from bagassets.formats import trajectory_map
from bagassets.formats.assembly import copies_of
from bagassets.formats.catalogue import formats
from bagassets.formats.checking import Verdict, check_bags, check_datasets, could_run
from bagassets.formats.dataset_build import DatasetInputs, dataset_contents, datasets_of, select_inputs
from bagassets.formats.format import FACTS as PART_FACTS
from bagassets.formats.format import AnyFormat
from bagassets.recipe.model import Recipe
from bagassets.report.grid_map import colour_of_split
from bagassets.report.model import Gaps, Problem, RecordingFacts, ReportData
from bagassets.report.trajectory_map import MapRoute
from bagassets.report.write import write_page
from bagassets.store.artifact import Artifact
from bagassets.store.canonical import digest_bytes
from bagassets.store.store import Outcome

_NO_SPLIT = "not in the dataset"
_PATHS = ("thumbnail", "full_pictures")


def report_data(
    assets: RecordingAssets,
    plan: Plan,
    checked: Literal["nothing", "recordings", "all"] = "nothing",
    on_recording: Callable[[int], None] = lambda _number: None,
) -> ReportData:
    """Return the report's data about all recordings.

    Args:
        assets: the assets of recordings under the recipe.
        plan: states of all recordings.
        checked: of what it has findings: `all` is recordings, and datasets as they are on disk. Recordings that have not
            changed since are not checked again.
        on_recording: called with 1 for each recording that is done.

    Raises:
        DatasetError: a file of a dataset cannot be read.
    """
    recipe = assets.recipe
    contents = _contents(plan)
    dealt, copies = select_inputs(plan).dealt(recipe, contents), copies_of(contents)
    recordings = []
    bags = dict(sorted(plan.bags.items()))
    kept = _KeptFacts(assets, plan.project)
    known = kept.known(bags.values(), dealt)
    to_check = [bag for key, bag in bags.items() if key not in known and checked != "nothing"]
    verdicts = check_bags(assets, plan, to_check)
    for key, bag in bags.items():
        facts = known.get(key) or _facts(assets, bag, dealt.get(key, ""))
        if checked == "nothing":
            facts = replace(facts, problems=(), checks_passed=0)
        elif key not in known:
            found = next(verdicts)[1]
            problems, passed = _outcome(found)
            facts = replace(facts, problems=problems, checks_passed=passed)
            if could_run(found):
                kept.add(bag, dealt, facts)
        if key in copies:
            facts = replace(facts, state="copy", reason=f"the same content as {copies[key]}")
        recordings.append(facts)
        on_recording(1)
    next(verdicts, None)  # there are no more, and it writes what is to be kept
    kept.write()
    problems, passed = _outcome(check_datasets(recipe)) if checked == "all" else ((), 0)
    scenes_s = [(r.key, r.scenes_s) for r in recordings if r.state in {"ready", "stale"}]
    shares = shares_of(scenes_s, recipe.splits, dealt)
    dataset = next((one.folder for one in datasets_of(recipe).values()), recipe.output)
    former = {key for keys in plan.ties.former.values() for key in keys}
    idle_pins = sorted(recipe.splits.pinned.keys() - plan.bags.keys() - former)
    return ReportData(
        recipe.name,
        dataset,
        recordings,
        plan.excluded,
        shares,
        idle_pins,
        problems,
        checks_passed=passed,
        counted=assets.counted,
    )


def map_path(recipe: Recipe) -> Path:
    """Return the path of the map of a recipe's recordings."""
    return recipe.state / trajectory_map.MAP


def report_path(recipe: Recipe) -> Path:
    """Return the path of the report that is written with the dataset."""
    return recipe.state / "report.html"


def build_map(assets: RecordingAssets, plan: Plan, inputs: DatasetInputs) -> Outcome:
    """Make the map of all recordings, write it to `map_path`, and note what it was made from.

    Raises:
        DatasetError: it cannot be written.
    """
    recipe = assets.recipe
    outcome = trajectory_map.map_of(assets.store, _map_routes(assets, plan))
    page = outcome.artifact.path(trajectory_map.MAP).read_text(encoding="utf-8")
    write_page(map_path(recipe), page)
    trajectory_map.note_recordings(
        recipe.state, dataset_contents(recipe, inputs, trajectory_map.STEP.name).now
    )
    digests = {map_path(recipe).name: digest_bytes(page.encode())}
    Publication(recipe.state, trajectory_map.STEP.name).write(recipe.state, digests, {}, None)
    return outcome


def _contents(plan: Plan) -> dict[str, str]:
    """Return recording -> digest of its content, else its key, for all that take part."""
    return {
        key: (bag.version("bag") if isinstance(bag, KeptPlan) else bag.assets["bag"].data_version) or key
        for key, bag in sorted(plan.bags.items())
        if bag.skipped is None and bag.unusable is None
    }


def _map_routes(assets: RecordingAssets, plan: Plan) -> list[MapRoute]:
    """Return the recordings with poses in the order of their keys, without copies, coloured by split."""
    recipe, contents = assets.recipe, _contents(plan)
    dealt, copies = select_inputs(plan).dealt(recipe, contents), copies_of(contents)
    splits = sorted(recipe.splits.shares)
    routes = []
    for key, bag in sorted(plan.bags.items()):
        is_in = bag.skipped is None and key not in copies
        track = track_on_record(recipe, assets.store, bag) if is_in else None
        stamps_ns = [] if track is None else [point[0] for point in track.local or track.points]
        if track is None or not stamps_ns:  # a rig without poses, and without fixes
            continue
        split = dealt.get(key, _NO_SPLIT)
        seconds = (stamps_ns[-1] - stamps_ns[0]) / 1e9
        note = f"{split}, {seconds:.0f} s"
        routes.append(
            MapRoute(key, split, colour_of_split(split, splits), note, track.on_earth, track.on_plane)
        )
    return routes


class _KeptFacts(Kept):
    """The facts of recordings, and what checks found in them, in the project's cache.

    They hold while code, recipe, plan and artifacts stay as they were.

    Args:
        assets: the assets of recordings under the recipe.
        project: see `Plan`.
    """

    def __init__(self, assets: RecordingAssets, project: str | None) -> None:
        super().__init__(assets.recipe.state, "report")
        self._project = f"{project}\0{assets.store.root}" if project else None

    def known(self, bags: Iterable[BagPlan], dealt: Mapping[str, str]) -> dict[str, RecordingFacts]:
        """Return the recordings, with the splits that they are dealt to, whose facts are kept -> facts."""
        found = {}
        with self.cache.kept_open():
            for bag in bags:
                mark = self._mark(bag, dealt)
                values = mark and self.find(bag.key, mark)
                if not values:
                    continue
                values |= {
                    "gaps": [Gaps(**one) for one in values["gaps"]],
                    "pictures": {name: Path(path) for name, path in values["pictures"].items()},
                    "problems": tuple(Problem(**one) for one in values["problems"]),
                    **{name: values[name] and Path(values[name]) for name in _PATHS},
                }
                found[bag.key] = RecordingFacts(**values)
        return found

    def add(self, bag: BagPlan, dealt: Mapping[str, str], facts: RecordingFacts) -> None:
        """Keep the facts of a recording that is dealt to a split; of one that is not as planned, nobody looked at the artifacts."""
        if mark := self._mark(bag, dealt):
            gaps, problems = ([vars(one) for one in of] for of in (facts.gaps, facts.problems))
            pictures = {name: str(path) for name, path in facts.pictures.items()}
            paths = {name: str(path) for name in _PATHS if (path := getattr(facts, name)) is not None}
            values = {"gaps": gaps, "problems": problems, "pictures": pictures, **paths}
            self.keep(bag.key, mark, {**vars(facts), **values})

    def _mark(self, bag: BagPlan, dealt: Mapping[str, str]) -> bytes:
        """Return what changes with the facts; empty if that is not known."""
        if self._project is None or not isinstance(bag, KeptPlan):
            return b""
        lines = f"{self._project}\0{dealt.get(bag.key, '')}\0".encode()
        return digest_bytes(lines + bag.row + bag.made).encode()


def _facts(assets: RecordingAssets, bag: BagPlan, split: str) -> RecordingFacts:
    store, (state, reason) = assets.store, _state(bag)
    inventory, poses = (bag.current_artifact(store, one.name) for one in (INVENTORY, EGO_POSES))
    kind = _first_format(bag)
    part = None if kind is None else bag.current_artifact(store, kind.part)
    if inventory is None:
        return RecordingFacts(bag.key, state, reason, bag.format)
    seen: JsonObject = inventory.read_json("inventory.json")
    is_in = state in {"ready", "stale"}
    track = track_on_record(assets.recipe, store, bag) if is_in else None
    return RecordingFacts(
        key=bag.key,
        state=state,
        reason=reason,
        format=seen["format"],
        size=seen["size"],
        start_ns=seen["start_ns"],
        duration_s=seen["duration_s"],
        scenes_s=0.0 if kind is None or part is None else kind.duration_s(part.read_json(PART_FACTS)),
        rig=bag.rig,
        split=split if is_in else "",
        daylight=seen["daylight"],
        length_m=None if poses is None else _summary(poses).get("length_m"),
        boxes=_boxes(bag.current_artifact(store, ANNOTATIONS.name)),
        gaps=_gaps(seen["topics"]),
        points=() if track is None else track.on_earth,
        local=() if track is None else track.on_plane,
        notes=seen["notes"],
        **_shown(assets, bag),
    )


def _shown(assets: RecordingAssets, bag: BagPlan) -> JsonObject:
    """Return what the faces of a recording's assets show, as fields of `RecordingFacts`."""
    counts: dict[str, int] = {}
    lost: list[str] = []
    pictures: dict[str, Path] = {}
    found: JsonObject = {"counts": counts, "lost": lost, "pictures": pictures}
    for asset in assets.by_channels:
        face, artifact = asset.face, bag.current_artifact(assets.store, asset.name)
        if artifact is None:
            continue
        summary = _summary(artifact)
        numbers = {name: count(summary) for name, count in face.counts.items()}
        counts |= {name: number for name, number in numbers.items() if number is not None}
        lost += [
            f"{one.source}: {count_text(one.number, one.unit)} lost, {one.reason}"
            for one in sorted(face.losses(summary))
        ]
        pictures |= {one.title: artifact.path(one.small) for one in face.pictures(artifact)}
        if face.thumbnail is not None:
            found |= {"thumbnail": artifact.path(face.thumbnail), "full_pictures": artifact.files}
    return found


def _outcome(verdicts: Iterable[Verdict]) -> tuple[tuple[Problem, ...], int]:
    """Return what checks found, and how many found nothing; one whose asset is not made counts as neither."""
    problems, passed = [], 0
    for verdict in verdicts:
        if verdict.finding is None:
            continue
        if verdict.finding.passed:
            passed += 1
            continue
        first, *more = verdict.finding.sentences
        problems.append(Problem(verdict.check, verdict.weight, first, len(more)))
    return tuple(problems), passed


def _boxes(annotations: Artifact | None) -> dict[str, int]:
    """Return category -> number of boxes."""
    if annotations is None or not _summary(annotations).get("boxes"):
        return {}
    column = annotations.read_table(TABLE, ["category"]).column("category")
    counts = {str(one["values"]): int(one["counts"]) for one in column.value_counts().to_pylist()}
    return dict(sorted(counts.items()))


def _state(bag: BagPlan) -> tuple[str, str]:
    if bag.skipped is not None:
        return "skipped", bag.skipped
    if bag.unusable is not None:
        return "failed", bag.unusable
    kind = _first_format(bag)
    if kind is None or bag.assets[kind.part].state in {"fresh", "record-only"}:
        return "ready", ""
    return "stale", f"{kind.part}: {bag.assets[kind.part].reason}"


def _first_format(bag: BagPlan) -> AnyFormat | None:
    """Return the first format that the recipe asks for: its datasets are what a report is about."""
    return next((kind for kind in formats() if kind.part in bag.assets), None)


def _gaps(topics: list[JsonObject]) -> list[Gaps]:
    with_gaps = [
        Gaps(topic["name"], topic["gap_count"], max(gap["duration_s"] for gap in topic["gaps"]))
        for topic in topics
        if topic["gaps"]
    ]
    return sorted(with_gaps, key=lambda gap: (-gap.longest_s, gap.topic))


def _summary(artifact: Artifact) -> JsonObject:
    try:
        return artifact.summary()
    except StoreError:
        return {}
