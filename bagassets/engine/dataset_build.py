"""The datasets: which recordings enter them now, and putting them together."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from bagassets.engine.plan_model import Plan
from bagassets.engine.publication import Publication
from bagassets.errors import DatasetError, StoreError
from bagassets.recipe.model import NuScenes, Recipe
from bagassets.recipe.model_splits import Splits
from bagassets.splits import deal
from bagassets.steps import trajectory_map, vision_dataset
from bagassets.steps.nuscenes_dataset import VERSION, BagPart, DatasetSummary, assemble, read_lock
from bagassets.steps.vision_dataset import VisionPart, VisionSummary, assemble_vision
from bagassets.store.canonical import digest_json
from bagassets.store.lease import in_use
from bagassets.store.store import Store
from bagassets.trace import span

__all__ = [
    "DatasetInputs",
    "assemble_published",
    "build_dataset",
    "build_vision_dataset",
    "dataset_code_version",
    "dataset_code_versions",
    "dataset_folders",
    "deal_contents",
    "is_on_disk",
    "select_inputs",
    "split_on_disk",
]


@dataclass(frozen=True)
class DatasetInputs:
    """What a dataset is made from.

    Attributes:
        parts: recordings that enter, sorted by key.
        skipped: recordings that take no part -> why.
        failed: recordings that could not be made -> why.
        vision: recordings that enter the vision dataset, sorted by key.
        vision_failed: recordings whose sequences could not be made -> why.
    """

    parts: tuple[BagPart, ...]
    skipped: Mapping[str, str]
    failed: Mapping[str, str]
    vision: tuple[VisionPart, ...] = ()
    vision_failed: Mapping[str, str] = field(default_factory=dict)

    @property
    def digest(self) -> str:
        """Digest of everything that shapes the dataset except the recipe."""
        value: dict[str, Any] = {
            "parts": [[part.key, part.content, part.tables] for part in self.parts],
            "skipped": dict(self.skipped),
            "failed": dict(self.failed),
        }
        if self.vision or self.vision_failed:
            value["vision"] = [[part.key, part.content, part.sequences] for part in self.vision]
            value["vision_failed"] = dict(self.vision_failed)
        return digest_json(value)

    def dealt(self, splits: Splits, store: Store) -> dict[str, str]:
        """Return recording -> its split, the same for all datasets."""
        contents = {part.key: part.content for part in self.vision}
        contents |= {part.key: part.content for part in self.parts}
        return deal_contents(contents, splits, without_scenes(store, {p.key: p.tables for p in self.parts}))

    def as_json(self) -> dict[str, Any]:
        """Return counts for people."""
        return {"recordings": len(self.parts), "skipped": len(self.skipped), "failed": len(self.failed)}


def without_scenes(store: Store, tables: Mapping[str, str]) -> frozenset[str]:
    """Return the recordings that give no scene, too short ones say.

    Args:
        store: the artifact store.
        tables: recording -> artifact of its `nuscenes_tables`.
    """
    found = set()
    for key, digest in tables.items():
        with suppress(StoreError):
            if not store.artifact(digest).read_json("facts.json")["counts"]["scenes"]:
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


def split_on_disk(recipe: Recipe) -> dict[str, str]:
    """Return recording -> its split in the nuScenes dataset as it is; nothing if there is none that can be read."""
    try:
        lock = read_lock(recipe.nuscenes.output, recipe.nuscenes.version)
    except DatasetError:
        return {}
    return {} if lock is None else {bag["key"]: bag["split"] for bag in lock["bags"]}


def select_inputs(plan: Plan, live: frozenset[str]) -> DatasetInputs:
    """Return what the dataset is made from now: current tables of live recordings that take part.

    A recording whose newest content failed is left out rather than put in with old content.
    """
    parts, vision, skipped, failed, vision_failed = [], [], dict(plan.excluded), {}, {}
    for key, bag in sorted(plan.bags.items()):
        if bag.skipped is not None:
            skipped[key] = bag.skipped
            continue
        if bag.unusable is not None:
            failed[key] = bag.unusable
        elif key in live and "nuscenes_tables" in bag.recorded and "bag" in bag.recorded:
            parts.append(BagPart(key, bag.recorded["bag"], bag.recorded["nuscenes_tables"]))
        state = bag.assets.get("vision_sequences")
        if state is None:
            continue
        reason = (
            bag.unusable if state.state == "unknown" else state.reason if state.state == "failed" else None
        )
        if reason is not None:
            vision_failed[key] = reason
        elif key in live and "vision_sequences" in bag.recorded and "bag" in bag.recorded:
            vision.append(VisionPart(key, bag.recorded["bag"], bag.recorded["vision_sequences"]))
    return DatasetInputs(tuple(parts), skipped, failed, tuple(vision), vision_failed)


def build_dataset(recipe: Recipe, store: Store, inputs: DatasetInputs) -> DatasetSummary:
    """Bring the dataset on disk up to date with `inputs`."""
    with span("nuscenes_dataset"), in_use(store.root):
        return assemble_published(
            Publication(recipe.state, "nuscenes_dataset"),
            inputs.parts,
            recipe.nuscenes,
            recipe.splits,
            store,
            dealt=inputs.dealt(recipe.splits, store),
            skipped=inputs.skipped,
            failed=inputs.failed,
        )


def assemble_published(
    publication: Publication,
    parts: Sequence[BagPart],
    settings: NuScenes,
    splits: Splits,
    store: Store,
    *,
    dealt: Mapping[str, str],
    skipped: Mapping[str, str],
    failed: Mapping[str, str],
) -> DatasetSummary:
    """Bring a nuScenes dataset on disk up to date, mend what is not as it was published, and record it."""
    output = settings.output
    suspects = publication.differing(output)
    made = assemble(
        parts,
        settings,
        store,
        output,
        splits=splits,
        dealt=dealt,
        skipped=skipped,
        failed=failed,
        suspects=suspects,
    )
    links = {entry.part.tables: partial(_filenames, entry.files) for entry in made.entries}
    publication.write(output, made.published, links, suspects)
    return made


def _filenames(files: Callable[[], list[dict[str, str]]]) -> Iterator[str]:
    return (file["filename"] for file in files())


def dataset_code_version(recipe: Recipe) -> str:
    """Return `<version>-<digest of the recipe fields>` of the dataset."""
    fields = [
        recipe.nuscenes.model_dump(mode="json", exclude={"output"}),
        recipe.splits.model_dump(mode="json"),
    ]
    return f"{VERSION}-{digest_json(fields)[:12]}"


def build_vision_dataset(recipe: Recipe, store: Store, inputs: DatasetInputs) -> VisionSummary:
    """Bring the vision dataset on disk up to date with `inputs`.

    Raises:
        DatasetError: the recipe asks for none.
    """
    if recipe.vision is None:
        raise DatasetError("the recipe has no `vision` section, so there is no vision dataset; add one.")
    publication, output = Publication(recipe.state, "vision_dataset"), recipe.vision.output
    suspects = publication.differing(output)
    with in_use(store.root):
        made = assemble_vision(
            inputs.vision,
            recipe.vision,
            recipe.splits,
            store,
            dealt=inputs.dealt(recipe.splits, store),
            skipped=inputs.skipped,
            failed=inputs.vision_failed,
            suspects=suspects,
        )
    links = {entry.part.sequences: entry.names for entry in made.entries}
    publication.write(output, made.published, links, suspects)
    return made


def dataset_code_versions(recipe: Recipe) -> dict[str, str]:
    """Return dataset asset -> its code version, for all that the recipe asks for; in order."""
    versions = {"nuscenes_dataset": dataset_code_version(recipe)}
    if recipe.vision is not None:
        fields = [
            recipe.vision.model_dump(mode="json", exclude={"output"}),
            recipe.splits.model_dump(mode="json"),
        ]
        versions["vision_dataset"] = f"{vision_dataset.VERSION}-{digest_json(fields)[:12]}"
    if recipe.preview.enabled and recipe.preview.trajectory_map:
        fields = [recipe.splits.model_dump(mode="json")]
        versions["trajectory_map"] = f"{trajectory_map.STEP.version}-{digest_json(fields)[:12]}"
    for dataset in recipe.datasets:
        named = [versions["nuscenes_dataset"], dataset.model_dump(mode="json", exclude={"output"})]
        versions[dataset.asset] = f"{VERSION}-{digest_json(named)[:12]}"
    return versions


def dataset_folders(recipe: Recipe) -> dict[str, Path]:
    """Return dataset asset -> the folder that it is written to, for all that the recipe asks for."""
    folders = {"nuscenes_dataset": recipe.nuscenes.output}
    if recipe.vision is not None:
        folders["vision_dataset"] = recipe.vision.output
    folders |= {dataset.asset: dataset.output for dataset in recipe.datasets if dataset.output is not None}
    return folders


def is_on_disk(recipe: Recipe, asset: str) -> bool:
    """Tell whether a dataset that was made once is on disk as it was published."""
    root = recipe.state if asset == "trajectory_map" else dataset_folders(recipe)[asset]
    return Publication(recipe.state, asset).is_as_published(root)
