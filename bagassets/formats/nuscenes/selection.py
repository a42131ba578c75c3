"""Named datasets: which scenes each takes."""

from collections import Counter
from collections.abc import Sequence
from functools import partial

from bagassets.assets.ego_poses import load_trajectory
from bagassets.build.plan import Plan
from bagassets.build.run_action import run_action
from bagassets.build.track import track_of
from bagassets.errors import StoreError
from bagassets.formats.format import Part, Selection
from bagassets.formats.nuscenes import scene_steps
from bagassets.formats.nuscenes.scene_conditions import require_own_scenes, unmet_condition
from bagassets.json_types import JsonObject
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_datasets import NamedDataset
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store

__all__ = ["select"]


def select(
    recipe: Recipe, store: Store, plan: Plan, parts: Sequence[Part], wanted: NamedDataset
) -> Selection:
    """Select the recordings and scenes of a named dataset.

    Args:
        recipe: the recipe.
        store: has the artifacts; missing facts and subsets of scenes are added to it.
        plan: states of all recordings.
        parts: the recordings of the whole dataset.
        wanted: the dataset.

    Raises:
        RecipeError: it names scenes that are no more.
    """
    chosen = []
    left_out: Counter[str] = Counter()
    skipped = {}
    for part in parts:
        tables = store.artifact(part.artifact)
        facts = _scene_facts(recipe, store, plan, part, tables)
        former = plan.ties.former.get(part.key, ())
        require_own_scenes(wanted, part.key, facts["scenes"], former)
        unmet = [unmet_condition(wanted, facts["rig"], part.key, scene, former) for scene in facts["scenes"]]
        kept = [scene for scene, why in zip(facts["scenes"], unmet, strict=True) if why is None]
        left_out.update(why for why in unmet if why is not None)
        if not kept:
            reasons = Counter(why for why in unmet if why is not None)
            skipped[part.key] = "no scene belongs to it: " + (
                "; ".join(f"{count} {why}" for why, count in sorted(reasons.items())) or "it has none"
            )
        elif len(kept) == len(facts["scenes"]):
            chosen.append(part)
        else:
            tokens = [scene["token"] for scene in kept]
            make = partial(scene_steps.make_subset, tables, kept)
            outcome = run_action(store, scene_steps.subset_action(tables, tokens), make)
            chosen.append(Part(part.key, part.content, outcome.artifact.digest))
    return Selection(chosen, skipped, dict(sorted(left_out.items())))


def _scene_facts(recipe: Recipe, store: Store, plan: Plan, part: Part, tables: Artifact) -> JsonObject:
    """Return the facts about the scenes of one recording, from the store if they are there."""
    bag = plan.bags[part.key]
    inventory, poses = bag.current_artifact(store, "inventory"), bag.current_artifact(store, "ego_poses")
    if inventory is None or poses is None:
        raise StoreError(
            f"{part.key}: the inventory or ego_poses, by which named datasets select scenes, are not in the store; "
            "run `bagassets build`."
        )
    track = track_of(store, inventory, poses, recipe.clock_of(recipe.rig_named(bag.rig)))
    make = partial(scene_steps.make_facts, tables, load_trajectory(poses), track.points)
    outcome = run_action(store, scene_steps.facts_action(tables, poses, track.digest), make)
    facts: JsonObject = outcome.artifact.read_json(scene_steps.SCENES)
    return facts
