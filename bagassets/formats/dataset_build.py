"""The datasets of a recipe: what enters them now, and putting them together."""

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from bagassets.assets import trajectory_map
from bagassets.build.plan import BagPlan, Plan
from bagassets.errors import BagAssetsError, DatasetError
from bagassets.formats.assembly import DatasetSummary, assemble
from bagassets.formats.catalogue import MAIN, formats
from bagassets.formats.dataset_lock import DatasetLock, read_lock
from bagassets.formats.format import FACTS, AnyFormat, Part, Selection
from bagassets.freshness.published import Publication
from bagassets.json_types import JsonObject
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_base import DatasetSettings
from bagassets.recipe.model_datasets import NamedDataset
from bagassets.recipe.model_splits import Splits
from bagassets.splits import deal
from bagassets.store.canonical import digest_file, digest_json
from bagassets.store.lease import in_use
from bagassets.store.store import Store
from bagassets.trace import span

__all__ = [
    "Dataset",
    "DatasetInputs",
    "build_dataset",
    "dataset_code_versions",
    "dataset_folders",
    "datasets_of",
    "deal_contents",
    "is_on_disk",
    "main_lock",
    "select_inputs",
    "split_on_disk",
    "without_scenes",
]


@dataclass(frozen=True)
class Dataset:
    """A dataset that a recipe asks for.

    Attributes:
        asset: its name in Dagster.
        kind: its format.
        settings: the section of the recipe.
        selection: of a named dataset, what it takes of the whole one.
    """

    asset: str
    kind: AnyFormat
    settings: DatasetSettings
    selection: NamedDataset | None = None

    @property
    def description(self) -> str:
        """What it is, for the web UI."""
        if self.selection is None:
            return self.kind.description
        return f"The scenes that the recipe selects for dataset {self.selection.name}: links and tables, nothing decoded again."

    def code_version(self, splits: Splits) -> str:
        """Return `<version>-<digest of the recipe fields>`."""
        fields: list[object] = [
            self.settings.model_dump(mode="json", exclude={"output"}),
            splits.model_dump(mode="json"),
        ]
        if self.kind.distribution:
            fields.append(self.kind.distribution)
        return f"{self.kind.version}-{digest_json(fields)[:12]}"


def datasets_of(recipe: Recipe) -> dict[str, Dataset]:
    """Return asset -> dataset, of those of each format and then the named ones; in order."""
    found = {}
    for kind in formats():
        if kind.name in recipe.dataset_settings:
            found[kind.asset] = Dataset(kind.asset, kind, recipe.dataset_settings[kind.name])
    for named in recipe.datasets:
        update = {"output": named.output, "version": named.version or recipe.nuscenes.version}
        found[named.asset] = Dataset(named.asset, MAIN, recipe.nuscenes.model_copy(update=update), named)
    return found


@dataclass(frozen=True)
class DatasetInputs:
    """What the datasets are made from.

    Attributes:
        parts: format -> recordings that enter, sorted by key.
        skipped: recordings that take no part -> why.
        failed: format -> recordings that could not be made -> why.
    """

    parts: Mapping[str, tuple[Part, ...]]
    skipped: Mapping[str, str] = field(default_factory=dict)
    failed: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @property
    def digest(self) -> str:
        """Digest of everything that shapes the datasets except the recipe."""
        value: JsonObject = {"parts": [], "skipped": dict(self.skipped), "failed": {}}
        for name in self.parts.keys() | self.failed.keys():
            rows = [[part.key, part.content, part.artifact] for part in self.parts.get(name, ())]
            failed = dict(self.failed.get(name, {}))
            if name == MAIN.name:
                value |= {"parts": rows, "failed": failed}
            elif rows or failed:
                value |= {name: rows, f"{name}_failed": failed}
        return digest_json(value)

    def dealt(self, splits: Splits, store: Store) -> dict[str, str]:
        """Return recording -> its split, the same for all datasets."""
        contents = {part.key: part.content for parts in self.parts.values() for part in parts}
        made = {name: {part.key: part.artifact for part in parts} for name, parts in self.parts.items()}
        return deal_contents(contents, splits, without_scenes(store, made))

    def as_json(self) -> JsonObject:
        """Return counts for people."""
        parts, failed = self.parts.get(MAIN.name, ()), self.failed.get(MAIN.name, {})
        return {"recordings": len(parts), "skipped": len(self.skipped), "failed": len(failed)}


def without_scenes(store: Store, made: Mapping[str, Mapping[str, str]]) -> frozenset[str]:
    """Return the recordings that give a dataset nothing, too short ones say.

    Args:
        store: the artifact store.
        made: format -> recording -> its part.
    """
    found = set()
    for kind in formats():
        if kind.fills_split is None:
            continue
        for key, digest in made.get(kind.name, {}).items():
            with suppress(BagAssetsError):
                if not kind.fills_split(store.artifact(digest).read_json(FACTS)):
                    found.add(key)
    return frozenset(found)


def deal_contents(
    contents: Mapping[str, str], splits: Splits, sceneless: AbstractSet[str] = frozenset()
) -> dict[str, str]:
    """Return recording -> its split; a copy counts once and goes where its original goes.

    Recordings without scenes fill no split of a dataset of scenes, so they are dealt after the others.

    Args:
        contents: recording -> digest of its content.
        splits: the recipe's `splits`.
        sceneless: recordings that give no scene.
    """
    first: dict[str, str] = {}
    for key, content in sorted(contents.items()):
        first.setdefault(content, key)
    with_scenes = deal((key for key in first.values() if key not in sceneless), splits)
    pinned = splits.model_copy(update={"pinned": {**splits.pinned, **with_scenes}})
    dealt = deal(first.values(), pinned)
    return {key: dealt[first[content]] for key, content in contents.items()}


def main_lock(recipe: Recipe) -> DatasetLock | None:
    """Return the lock of the dataset that every recipe has; None if there is none yet.

    Raises:
        DatasetError: it cannot be read.
    """
    return read_lock(recipe.nuscenes.output / MAIN.folder(recipe.nuscenes))


def split_on_disk(recipe: Recipe) -> Mapping[str, str]:
    """Return recording -> its split in the dataset as it is; nothing if there is none that can be read."""
    try:
        lock = main_lock(recipe)
    except DatasetError:
        return {}
    return {} if lock is None else lock.splits


def select_inputs(plan: Plan, live: frozenset[str]) -> DatasetInputs:
    """Return what the datasets are made from now: current parts of live recordings that take part.

    A recording whose newest content failed is left out rather than put in with old content.
    """
    parts: dict[str, list[Part]] = {kind.name: [] for kind in formats()}
    failed: dict[str, dict[str, str]] = {kind.name: {} for kind in formats()}
    skipped = dict(plan.excluded)
    for key, bag in sorted(plan.bags.items()):
        if bag.skipped is not None:
            skipped[key] = bag.skipped
            continue
        for kind in formats():
            if kind.part not in bag.assets:
                continue
            reason = _failure(bag, kind.part)
            if reason is not None:
                failed[kind.name][key] = reason
            elif key in live and kind.part in bag.recorded and "bag" in bag.recorded:
                parts[kind.name].append(Part(key, bag.recorded["bag"], bag.recorded[kind.part]))
    return DatasetInputs({name: tuple(each) for name, each in parts.items()}, skipped, failed)


def _failure(bag: BagPlan, part: str) -> str | None:
    """Return why the part of a recording, or something that it is made from, failed; None if nothing did."""
    state = bag.assets[part]
    if state.state == "failed":
        return state.reason
    return (bag.unusable or bag.failed) if state.state == "unknown" else None


def build_dataset(
    dataset: Dataset, recipe: Recipe, store: Store, plan: Plan, inputs: DatasetInputs
) -> DatasetSummary:
    """Bring a dataset on disk up to date, mend what is not as it was published, and record it.

    Args:
        dataset: one of `datasets_of` the recipe.
        recipe: the recipe.
        store: where the artifacts are.
        plan: states of all recordings.
        inputs: what enters the datasets.

    Raises:
        DatasetError: its folder holds something else, or files cannot be written.
    """
    kind, publication, output = (
        dataset.kind,
        Publication(recipe.state, dataset.asset),
        dataset.settings.output,
    )
    with span(dataset.asset), in_use(store.root):
        chosen = Selection(inputs.parts.get(kind.name, ()))
        if dataset.selection is not None and kind.select is not None:
            chosen = kind.select(recipe, store, plan, chosen.parts, dataset.selection)
        suspects = publication.changed_files(output)
        made = assemble(
            kind,
            chosen.parts,
            dataset.settings,
            store,
            output,
            splits=recipe.splits,
            dealt=inputs.dealt(recipe.splits, store),
            skipped={**inputs.skipped, **chosen.skipped},
            failed=inputs.failed.get(kind.name, {}),
            suspects=suspects,
        )
        publication.write(output, made.published, made.links, suspects)
    return (
        made
        if dataset.selection is None
        else replace(made, facts={**made.facts, "scenes_left_out": chosen.left_out})
    )


def dataset_code_versions(recipe: Recipe) -> dict[str, str]:
    """Return dataset asset -> its code version, for all that the recipe asks for; in order."""
    datasets = datasets_of(recipe)
    versions = {
        asset: dataset.code_version(recipe.splits)
        for asset, dataset in datasets.items()
        if dataset.selection is None
    }
    if recipe.preview.enabled and recipe.preview.trajectory_map:
        fields = [recipe.splits.model_dump(mode="json")]
        versions["trajectory_map"] = f"{trajectory_map.STEP.version}-{digest_json(fields)[:12]}"
    for asset, dataset in datasets.items():
        if dataset.selection is not None:
            chosen = dataset.selection.model_dump(mode="json", exclude={"output"})
            digest = digest_json([versions[dataset.kind.asset], chosen])
            versions[asset] = f"{dataset.kind.version}-{digest[:12]}"
    return versions


def dataset_folders(recipe: Recipe) -> dict[str, Path]:
    """Return dataset asset -> the folder that it is written to, for all that the recipe asks for."""
    return {asset: dataset.settings.output for asset, dataset in datasets_of(recipe).items()}


def is_on_disk(recipe: Recipe, asset: str) -> bool:
    """Tell whether a dataset that was made once is on disk as it was published."""
    root = recipe.state if asset == "trajectory_map" else dataset_folders(recipe)[asset]
    return Publication(recipe.state, asset).is_as_published(root, lambda path: digest_file(Path(path)))
