"""The dataset: which recordings enter it now, and putting it together."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bagassets.engine.plan import Plan, Recorded
from bagassets.recipe.model import Recipe
from bagassets.steps.nuscenes_dataset import VERSION, BagPart, DatasetSummary, assemble
from bagassets.store.canonical import digest_json
from bagassets.store.store import Store

__all__ = ["DatasetInputs", "build_dataset", "dataset_code_version", "select_inputs"]


@dataclass(frozen=True)
class DatasetInputs:
    """What a dataset is made from.

    Attributes:
        parts: recordings that enter, sorted by key.
        skipped: recordings that take no part -> why.
        failed: recordings that could not be made -> why.
    """

    parts: tuple[BagPart, ...]
    skipped: Mapping[str, str]
    failed: Mapping[str, str]

    @property
    def digest(self) -> str:
        """Digest of everything that shapes the dataset except the recipe."""
        return digest_json(
            {
                "parts": [[part.key, part.content, part.tables] for part in self.parts],
                "skipped": dict(self.skipped),
                "failed": dict(self.failed),
            }
        )

    def as_json(self) -> dict[str, Any]:
        """Return counts for people."""
        return {"recordings": len(self.parts), "skipped": len(self.skipped), "failed": len(self.failed)}


def select_inputs(
    plan: Plan, recorded: Mapping[str, Mapping[str, Recorded]], live: frozenset[str]
) -> DatasetInputs:
    """Return what the dataset is made from now: current tables of live recordings that take part.

    A recording whose newest content failed is left out rather than put in with old content.
    """
    tables, bags = recorded.get("nuscenes_tables", {}), recorded.get("bag", {})
    parts, skipped, failed = [], dict(plan.excluded), {}
    for key, bag in sorted(plan.bags.items()):
        if bag.skipped is not None:
            skipped[key] = bag.skipped
        elif bag.failed is not None:
            failed[key] = bag.failed
        elif key in live and key in tables and key in bags:
            parts.append(BagPart(key, bags[key].data_version, tables[key].data_version))
    return DatasetInputs(tuple(parts), skipped, failed)


def build_dataset(recipe: Recipe, store: Store, inputs: DatasetInputs) -> DatasetSummary:
    """Bring the dataset on disk up to date with `inputs`."""
    settings = recipe.nuscenes
    return assemble(
        inputs.parts,
        settings,
        store,
        settings.output,
        splits=recipe.splits,
        skipped=inputs.skipped,
        failed=inputs.failed,
    )


def dataset_code_version(recipe: Recipe) -> str:
    """Return `<version>-<digest of the recipe fields>` of the dataset."""
    fields = [
        recipe.nuscenes.model_dump(mode="json", exclude={"output"}),
        recipe.splits.model_dump(mode="json"),
    ]
    return f"{VERSION}-{digest_json(fields)[:12]}"
