"""Named datasets: which scenes each takes, and putting it together from links and rows."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from bagassets.engine.current import current_artifact
from bagassets.engine.dataset_build import DatasetInputs, assemble_published
from bagassets.engine.plan_model import Plan
from bagassets.engine.publication import Publication
from bagassets.engine.track import track_of
from bagassets.errors import StoreError
from bagassets.nuscenes.choose_scenes import objection
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_datasets import NamedDataset
from bagassets.steps import scene_selection
from bagassets.steps.ego_poses import load_trajectory
from bagassets.steps.nuscenes_dataset import BagPart, DatasetSummary
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store

__all__ = ["Chosen", "build_named_dataset", "choose"]


@dataclass(frozen=True)
class Chosen:
    """The scenes of a named dataset.

    Attributes:
        parts: recordings with their tables, or those of some of their scenes.
        scenes: number of scenes that belong to it.
        left_out: why scenes do not belong to it -> their number.
        skipped: recordings of which no scene belongs to it -> why.
    """

    parts: tuple[BagPart, ...]
    scenes: int
    left_out: Mapping[str, int] = field(default_factory=dict)
    skipped: Mapping[str, str] = field(default_factory=dict)


def choose(recipe: Recipe, store: Store, plan: Plan, inputs: DatasetInputs, wanted: NamedDataset) -> Chosen:
    """Return what a named dataset is made from now.

    Args:
        recipe: the recipe.
        store: where the artifacts are; what is missing of facts and tables of scenes is made.
        plan: states of all recordings.
        inputs: the recordings of the whole dataset.
        wanted: the dataset.
    """
    parts, number = [], 0
    left_out: Counter[str] = Counter()
    skipped = dict(inputs.skipped)
    for part in inputs.parts:
        tables = store.artifact(part.tables)
        facts = _scene_facts(recipe, store, plan, part, tables)
        objections = [objection(wanted, facts["rig"], part.key, scene) for scene in facts["scenes"]]
        kept = [scene for scene, why in zip(facts["scenes"], objections, strict=True) if why is None]
        left_out.update(why for why in objections if why is not None)
        number += len(kept)
        if not kept:
            reasons = Counter(why for why in objections if why is not None)
            skipped[part.key] = "no scene belongs to it: " + (
                "; ".join(f"{count} {why}" for why, count in sorted(reasons.items())) or "it has none"
            )
        elif len(kept) == len(facts["scenes"]):
            parts.append(part)
        else:
            tokens = [scene["token"] for scene in kept]
            make = partial(scene_selection.make_subset, tables, kept)
            outcome = store.run(scene_selection.subset_action(tables, tokens), make)
            parts.append(BagPart(part.key, part.content, outcome.artifact.digest))
    return Chosen(tuple(parts), number, dict(sorted(left_out.items())), skipped)


def build_named_dataset(
    recipe: Recipe, store: Store, plan: Plan, inputs: DatasetInputs, wanted: NamedDataset
) -> tuple[DatasetSummary, Chosen]:
    """Bring a named dataset on disk up to date.

    Raises:
        DatasetError: its folder holds something else, or files cannot be written.
    """
    chosen = choose(recipe, store, plan, inputs, wanted)
    settings = recipe.nuscenes.model_copy(
        update={"output": wanted.output, "version": wanted.version or recipe.nuscenes.version}
    )
    summary = assemble_published(
        Publication(recipe.state, wanted.asset),
        chosen.parts,
        settings,
        recipe.splits,
        store,
        dealt=inputs.dealt(recipe.splits, store),
        skipped=chosen.skipped,
        failed=inputs.failed,
    )
    return summary, chosen


def _scene_facts(recipe: Recipe, store: Store, plan: Plan, part: BagPart, tables: Artifact) -> dict[str, Any]:
    """Return the facts about the scenes of one recording; they are made once."""
    bag = plan.bags[part.key]
    inventory, poses = current_artifact(store, bag, "inventory"), current_artifact(store, bag, "ego_poses")
    if inventory is None or poses is None:
        raise StoreError(
            f"{part.key}: inventory or ego_poses are not in the store, which the scenes of a named dataset are chosen "
            "by; run `bagassets build`."
        )
    track = track_of(store, inventory, poses, recipe.clock)
    make = partial(scene_selection.make_facts, tables, load_trajectory(poses), track.points)
    outcome = store.run(scene_selection.facts_action(tables, poses, track.digest), make)
    facts: dict[str, Any] = outcome.artifact.read_json(scene_selection.SCENES)
    return facts
