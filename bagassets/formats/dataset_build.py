"""The datasets of a recipe: which recordings enter them, and building them."""

import json
from collections.abc import Callable, Iterable, Mapping
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from bagassets.assets.ego_poses import EGO_POSES
from bagassets.base.alike import told_once
from bagassets.base.errors import BagAssetsError, DatasetError
from bagassets.base.json_types import JsonObject
from bagassets.base.trace import span
from bagassets.engine.freshness.published import Publication
from bagassets.engine.plan import BagPlan, Plan
from bagassets.engine.planner import damage_of
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.engine.splits import Ties, deal
from bagassets.formats import trajectory_map
from bagassets.formats.assembly import DatasetSummary, assemble, copies_of, without_copies
from bagassets.formats.catalogue import formats, formats_of
from bagassets.formats.dataset_lock import DatasetLock, read_lock
from bagassets.formats.format import FACTS, AnyFormat, Part, Selection
from bagassets.formats.groups import FoundInGroups, GroupsRecord, cut
from bagassets.recipe.format_settings import DEFAULT_FORMAT
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_base import DatasetSettings
from bagassets.recipe.model_datasets import NamedDataset
from bagassets.recipe.model_splits import Splits
from bagassets.recordings.model import RecordingFiles
from bagassets.store.canonical import digest_file, digest_json
from bagassets.store.lease import in_use
from bagassets.store.store import Store


@dataclass(frozen=True)
class Dataset:
    """A dataset that a recipe defines.

    Attributes:
        asset: its name in Dagster.
        kind: its format.
        settings: its section of the recipe.
        selection: the conditions of a named dataset; None for the whole one.
        whole: the dataset that a named one has scenes of.
    """

    asset: str
    kind: AnyFormat
    settings: DatasetSettings
    selection: NamedDataset | None = None
    whole: "Dataset | None" = None

    @property
    def part(self) -> str:
        """The asset of recordings that it is made from."""
        return self.kind.part

    @property
    def published_in(self) -> Path:
        """The folder that has all its files."""
        return self.settings.output

    @property
    def description(self) -> str:
        """Description for the web UI."""
        if self.selection is None:
            return self.kind.description
        return f"The scenes that the recipe selects for dataset {self.selection.name}: links and tables only, nothing is decoded again."

    @property
    def folder(self) -> Path:
        """The folder that is swapped as a whole."""
        return self.settings.output / self.kind.folder(self.settings)

    @cached_property
    def lock(self) -> DatasetLock | None:
        """The lock of the dataset on disk, as it is when it is first asked for; None before the first build.

        Raises:
            DatasetError: it cannot be read.
        """
        return read_lock(self.folder)

    def code_version(self, splits: Splits) -> str:
        """Return `<version>-<digest of the recipe fields>`."""
        if self.selection is not None and self.whole is not None:
            chosen = self.selection.model_dump(mode="json", exclude={"output"})
            return f"{self.kind.version}-{digest_json([self.whole.code_version(splits), chosen])[:12]}"
        fields: list[object] = [
            self.settings.model_dump(mode="json", exclude={"output"}),
            splits.model_dump(mode="json"),
        ]
        if self.kind.distribution:
            fields.append(self.kind.distribution)
        return f"{self.kind.version}-{digest_json(fields)[:12]}"


@dataclass(frozen=True)
class RouteMap:
    """The map of all recordings, which is made once, as datasets are.

    Attributes:
        published_in: the folder that has its files.
        asset: its name in Dagster.
        part: the asset of recordings that it is made from.
        description: description for the web UI.
    """

    published_in: Path
    asset: str = trajectory_map.STEP.name
    part: str = EGO_POSES.name
    description: str = """Where all recordings were driven: an interactive map with a layer per split and a heat layer.

Without a network, it shows the same routes on a plain grid."""

    def code_version(self, splits: Splits) -> str:
        """Return `<version>-<digest of the recipe fields>`."""
        return f"{trajectory_map.STEP.version}-{digest_json([splits.model_dump(mode='json')])[:12]}"


def datasets_of(recipe: Recipe) -> dict[str, Dataset]:
    """Return asset -> dataset: first one per format, then the named ones."""
    return {asset: one for asset, one in made_once(recipe).items() if isinstance(one, Dataset)}


def made_once(recipe: Recipe) -> dict[str, Dataset | RouteMap]:
    """Return asset -> what is made once of all recordings: a dataset per format, the map, then the named datasets."""
    sections = recipe.dataset_settings
    wholes = {kind.name: Dataset(kind.asset, kind, sections[kind.name]) for kind in formats_of(recipe)}
    found: dict[str, Dataset | RouteMap] = {one.asset: one for one in wholes.values()}
    if recipe.preview.has_map:
        route_map = RouteMap(recipe.state)
        found[route_map.asset] = route_map
    for named in recipe.datasets:
        whole = wholes[DEFAULT_FORMAT]
        update = {"output": named.output} | ({"version": named.version} if named.version else {})
        settings = whole.settings.model_copy(update=update)
        found[named.asset] = Dataset(named.asset, whole.kind, settings, named, whole)
    return found


@dataclass(frozen=True)
class DatasetInputs:
    """The recordings that datasets are made from.

    Attributes:
        parts: format -> recordings in the dataset, sorted by key.
        skipped: recordings that take no part -> reason.
        failed: format -> recordings whose part could not be made -> reason.
        ties: see `Plan.ties`.
    """

    parts: Mapping[str, tuple[Part, ...]]
    skipped: Mapping[str, str] = field(default_factory=dict)
    failed: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    ties: Ties = field(default_factory=Ties)

    @cached_property
    def digest(self) -> str:
        """Digest of everything that shapes the datasets except the recipe."""
        value: JsonObject = {"parts": [], "skipped": dict(self.skipped), "failed": {}}
        for name in self.parts.keys() | self.failed.keys():
            rows = [[part.key, part.content, part.artifact] for part in self.parts.get(name, ())]
            failed = dict(self.failed.get(name, {}))
            if name == DEFAULT_FORMAT:  # as when it was the only one
                value |= {"parts": rows, "failed": failed}
            elif rows or failed:
                value |= {name: rows, f"{name}_failed": failed}
        keys = {part.key for parts in self.parts.values() for part in parts}
        return digest_json(value | self.ties.of(keys))

    def dealt(self, recipe: Recipe, entering: Mapping[str, str] | None = None) -> dict[str, str]:
        """Return recording -> split, the same for all datasets, as it is once these others (key -> content) have come."""
        contents = {part.key: part.content for parts in self.parts.values() for part in parts}
        contents |= entering or {}
        made = {name: {part.key: part.artifact for part in parts} for name, parts in self.parts.items()}
        return deal_contents(contents, recipe.splits, recordings_without_scenes(recipe, made), self.ties)

    def as_json(self) -> JsonObject:
        """Return counts for display."""
        return {
            "recordings": len(self.parts.get(self.first, ())),
            "skipped": len(self.skipped),
            "failed": len(self.failed.get(self.first, {})),
        }

    @property
    def first(self) -> str:
        """The first format, whose recordings are counted for people; "" if there is none."""
        return next(iter(self.parts), "")


def recordings_without_scenes(recipe: Recipe, parts: Mapping[str, Mapping[str, str]]) -> frozenset[str]:
    """Return the recordings that add no scene to a dataset, such as too short ones.

    Args:
        recipe: the recipe, whose store has the artifacts.
        parts: format -> recording -> part.
    """
    without: set[str] = set()
    for kind in formats():
        if kind.fills_split is not None and (of := parts.get(kind.name)):
            memory = FoundInGroups(recipe.state, f"{kind.name}-{kind.version}-without-scenes")
            before, found = memory.load(), {}
            some = [Part(key, "", digest) for key, digest in sorted(of.items())]
            for group in cut(some, dict.fromkeys(of, "")):
                if group.digest in before:
                    found[group.digest] = before[group.digest]
                    without.update(json.loads(before[group.digest]))
                    continue
                fills = _fills_split(kind, group.parts, Store(recipe.store_path))
                keys = [key for key, adds in fills.items() if not adds]
                without.update(keys)
                if len(fills) == len(group.parts):
                    found[group.digest] = json.dumps(keys).encode()
            memory.save(found)
    return frozenset(without)


def _fills_split(kind: AnyFormat, parts: Iterable[Part], store: Store) -> dict[str, bool]:
    """Return the recordings whose part is in the store -> whether they add anything to the dataset."""
    found = {}
    for part in parts:
        with suppress(BagAssetsError):
            facts = store.artifact(part.artifact).read_json(FACTS)
            found[part.key] = kind.fills_split is None or kind.fills_split(facts)
    return found


def deal_contents(
    contents: Mapping[str, str],
    splits: Splits,
    sceneless: AbstractSet[str] = frozenset(),
    ties: Ties | None = None,
) -> dict[str, str]:
    """Return recording -> split. Recordings with equal content count once and share a split.

    Recordings without scenes fill no split of a dataset, so they are dealt after the others.

    Args:
        contents: recording -> digest of its content.
        splits: the recipe's `splits`.
        sceneless: recordings without scenes.
        ties: see `deal`.
    """
    copies = copies_of(contents)
    firsts = sorted(contents.keys() - copies.keys())
    dealt = deal((key for key in firsts if key not in sceneless), splits, ties)
    if len(dealt) < len(firsts):
        pinned = splits.model_copy(update={"pinned": {**splits.pinned, **dealt}})
        dealt = deal(firsts, pinned, ties)
    return {key: dealt[copies.get(key, key)] for key in contents}


def first_lock(datasets: Mapping[str, Dataset]) -> DatasetLock | None:
    """Return the lock of the first dataset, which has the splits of all; None before the first build.

    Raises:
        DatasetError: it cannot be read.
    """
    return next((dataset.lock for dataset in datasets.values()), None)


def split_on_disk(recipe: Recipe) -> Mapping[str, str]:
    """Return recording -> split in the dataset on disk; empty without a readable lock."""
    try:
        lock = first_lock(datasets_of(recipe))
    except DatasetError:
        return {}
    return {} if lock is None else lock.splits


def select_inputs(plan: Plan) -> DatasetInputs:
    """Select the current parts of all live recordings that take part.

    A recording whose newest content failed is left out rather than included with old content. So is one of which newer
    content is on record than its part was made from: some assets were made alone, or a run was interrupted.
    """
    made = {name for bag in plan.bags.values() for name in bag.names}
    kinds = [kind for kind in formats() if kind.part in made]
    parts: dict[str, list[Part]] = {kind.name: [] for kind in kinds}
    failed: dict[str, dict[str, str]] = {kind.name: {} for kind in kinds}
    skipped = dict(plan.excluded)
    for key, bag in sorted(plan.bags.items()):
        if bag.skipped is not None:
            skipped[key] = bag.skipped
            continue
        names, content = bag.names, bag.version("bag")
        for kind in kinds:
            if kind.part not in names:
                continue
            reason = None if bag.settled else _failure(bag, kind.part)
            if reason is not None:
                failed[kind.name][key] = _without_root(reason, plan.discovery.recordings.get(key))
            elif key in plan.live and content is not None and (part := bag.version(kind.part)) is not None:
                parts[kind.name].append(Part(key, content, part))
    return DatasetInputs({name: tuple(each) for name, each in parts.items()}, skipped, failed, plan.ties)


def _damaged(plan: Plan, store: Store, parts: Iterable[Part]) -> dict[str, str]:
    """Return recording -> how much of it was read, of those that are damaged."""
    found = ((part.key, damage_of(plan.bags[part.key], store)) for part in parts)
    return {key: share for key, share in found if share}


def results_to_come(assets: RecordingAssets, plan: Plan, todo: Iterable[str], *, retry_failed: bool) -> str:
    """Return the results that datasets are made from and that are yet to come.

    All datasets rest on one digest, so the results for all formats count.

    Args:
        assets: the assets of recordings.
        plan: states of all recordings.
        todo: recordings that need a run.
        retry_failed: what failed before is made again.
    """
    parts = [kind.part for kind in formats() if kind.part in assets.names]
    read = assets.with_upstream(parts)
    found = []
    for key in todo:
        bag = plan.bags[key]
        to_come = [
            name
            for name in ("bag", *parts)
            if bag.assets[name].state != "skipped"
            and (bag.assets[name].data_version or "") != bag.recorded.get(name)
        ]
        if to_come and bag.to_run(retry_failed=retry_failed, select=read):
            found.append(((), key, ", ".join(to_come[-len(parts) :])))
    return "; ".join(f"{told.text} of {told.title}" for told in told_once(found, fewest=2))


@dataclass(frozen=True)
class DatasetContents:
    """The recordings of a dataset.

    Attributes:
        part: the asset of recordings that it is made from.
        last: recording -> digest of what the dataset on disk has of it: its part, or, in a dataset of selected scenes, its
            content. None if that is not on record.
        now: the same for the dataset as it would be made now; one of selected scenes has some of these.
        left_out: recording -> why it is not in the dataset.
        returned: recordings that the dataset on disk left out, and that are neither left out nor in it now: they are to be
            made, or are gone.
    """

    part: str
    last: Mapping[str, str] | None
    now: Mapping[str, str]
    left_out: Mapping[str, str]
    returned: tuple[str, ...] = ()


def dataset_contents(recipe: Recipe, inputs: DatasetInputs, asset: str) -> DatasetContents:
    """Return what a dataset, or the map, has of which recordings; nothing is made.

    Raises:
        DatasetError: its lock cannot be read.
    """
    made = made_once(recipe)[asset]
    name = made.kind.name if isinstance(made, Dataset) else inputs.first
    parts, copies = without_copies(inputs.parts.get(name, ()))
    left_out = {**inputs.skipped, **inputs.failed.get(name, {})}
    left_out |= {
        key: f"the same content as {first}, which is in it for both" for key, first in copies.items()
    }
    if isinstance(made, RouteMap):
        on_map = trajectory_map.recordings_on_map(made.published_in)
        return DatasetContents(made.part, on_map, {one.key: one.content for one in parts}, left_out)
    lock, is_whole = made.lock, made.selection is None
    now = {one.key: one.artifact if is_whole else one.content for one in parts}
    if lock is None:
        return DatasetContents(made.part, {}, now, left_out)
    # Which are selected, or fit, is known once they are made.
    if not is_whole or made.kind.misfits is not None:
        selected_out = {key: why for key, why in lock.value["skipped"].items() if key in now}
        left_out |= selected_out
        now = {key: digest for key, digest in now.items() if key not in selected_out}
    last = {key: bag.artifact if is_whole else bag.content for key, bag in lock.bags.items()}
    before = {key for why in ("skipped", "failed", "duplicates") for key in lock.value[why]}
    returned = tuple(sorted(before - left_out.keys() - now.keys()))
    return DatasetContents(made.part, last, now, left_out, returned)


def what_changed(recipe: Recipe, inputs: DatasetInputs, asset: str) -> str:
    """Return why a dataset is to be made again that was made from other inputs: these are the inputs of all datasets."""
    made = made_once(recipe)[asset]
    with suppress(DatasetError):  # its lock cannot be read
        if isinstance(made, Dataset) and made.selection is None:
            contents = dataset_contents(recipe, inputs, asset)
            if contents.last == contents.now and not contents.returned:
                return "only what is left out, or in other datasets, changed since it was made"
    return "its recordings changed since it was made"


def _failure(bag: BagPlan, part: str) -> str | None:
    """Return why the part of a recording cannot be taken: it failed, or anything upstream of it, or is of other content."""
    state = bag.assets[part]
    if state.state == "failed":
        return state.reason
    failed = (bag.unusable or bag.failed) if state.state == "unknown" else None
    if failed is None and part in bag.outdated:
        return f"its content has changed since its {part} was made; build it again."
    return failed


def _without_root(reason: str, files: RecordingFiles | None) -> str:
    """Return a reason with paths below the bag root, so that a lock is the same wherever the recordings lie."""
    if files is None:
        return reason
    root = str(files.path).removesuffix(files.relative)
    return reason.replace(root, "").removeprefix(f"{files.relative}: ")


def build_dataset(
    dataset: Dataset,
    recipe: Recipe,
    store: Store,
    plan: Plan,
    inputs: DatasetInputs,
    permit: Callable[[], None] = lambda: None,
) -> DatasetSummary:
    """Bring a dataset on disk up to date, repair files that changed since they were published, and record them.

    Args:
        dataset: one of `datasets_of` the recipe.
        recipe: the recipe.
        store: has the artifacts.
        plan: states of all recordings.
        inputs: the recordings in the datasets.
        permit: called before anything is published; nothing is if it raises.

    Raises:
        DatasetError: the folder holds something else, or files cannot be written.
    """
    kind, output = dataset.kind, dataset.settings.output
    publication = Publication(recipe.state, dataset.asset)
    with span(dataset.asset), in_use(store.root):
        chosen = Selection(inputs.parts.get(kind.name, ()))
        if dataset.selection is not None and kind.select is not None:
            chosen = kind.select(recipe, store, plan, chosen.parts, dataset.selection)
        suspects = publication.changed_files(output)
        summary = assemble(
            kind,
            chosen.parts,
            dataset.settings,
            store,
            output,
            splits=recipe.splits,
            dealt=inputs.dealt(recipe),
            skipped={**inputs.skipped, **chosen.skipped},
            failed=inputs.failed.get(kind.name, {}),
            damaged=_damaged(plan, store, chosen.parts),
            suspects=suspects,
            torn_since_s=publication.torn_since_s,
            record=GroupsRecord.from_json(publication.groups()),
            permit=permit,
        )
        groups = None if summary.record is None else summary.record.as_json()
        publication.write(output, summary.published, summary.links, suspects, summary.gone, groups)
    if dataset.selection is None:
        return summary
    return replace(summary, facts={**summary.facts, "scenes_left_out": chosen.left_out})


def dataset_code_versions(recipe: Recipe) -> dict[str, str]:
    """Return asset -> code version, for all datasets of a recipe and the map, in order."""
    return {asset: one.code_version(recipe.splits) for asset, one in made_once(recipe).items()}


def dataset_folders(recipe: Recipe) -> dict[str, Path]:
    """Return dataset asset -> output folder, for all datasets of a recipe."""
    return {asset: dataset.settings.output for asset, dataset in datasets_of(recipe).items()}


def is_on_disk(recipe: Recipe, asset: str) -> bool:
    """Tell whether a dataset on disk is as it was published."""
    root = made_once(recipe)[asset].published_in
    return Publication(recipe.state, asset).is_as_published(root, lambda path: digest_file(Path(path)))
