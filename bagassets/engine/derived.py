"""Assets that are made from the artifacts of others: what each is handed, and what runs if it is not known."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from bagassets.bags.inventory import Inventory
from bagassets.bags.model import Found
from bagassets.engine.source import MessageSource
from bagassets.engine.track import track_of
from bagassets.errors import BagAssetsError
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import Recipe, Rig
from bagassets.steps import nuscenes_tables, preview, vision_sequences
from bagassets.steps.channel import Request
from bagassets.store.action import Step
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.store import Store

__all__ = ["DERIVED", "Job", "Made"]

# Loading poses and opening the pack costs milliseconds, times recordings: only what runs does so.
Job = tuple[Step, Request, Callable[[ArtifactWriter], dict[str, Any]]]


class Made(Protocol):
    """What is there of a recording when its derived assets are made."""

    recipe: Recipe
    store: Store
    found: Found
    source: MessageSource

    @property
    def rig(self) -> Rig:
        """The rig that made the recording."""
        ...

    @property
    def inventory(self) -> Inventory:
        """What is in the recording."""
        ...

    @property
    def calibration(self) -> Mapping[str, Any]:
        """Content of `calibration.json`."""
        ...

    @property
    def trajectory(self) -> Trajectory:
        """`global_SE3_ego`."""
        ...

    def artifact(self, asset: str) -> Artifact:
        """Return the artifact of an asset."""
        ...

    def channels(self, asset: str) -> dict[str, Artifact]:
        """Return channel -> artifact of `frames` or `sweeps`."""
        ...


def _nuscenes_tables(made: Made) -> Job:
    poses, boxes = made.artifact("ego_poses"), made.artifact("annotations")
    channels = made.channels("frames") | made.channels("sweeps")
    request = nuscenes_tables.request(
        made.rig,
        made.recipe.scenes,
        made.found.key,
        attributes=made.recipe.nuscenes.attributes_by_motion,
        calibration=made.calibration,
        ego_poses=poses,
        annotations=boxes,
        channels=channels,
    )

    def make(out: ArtifactWriter) -> dict[str, Any]:
        return nuscenes_tables.make(
            request.params,
            out,
            trajectory=made.trajectory,
            ego_poses=poses,
            annotations=boxes,
            channels=channels,
        )

    return nuscenes_tables.STEP, request, make


def _vision_sequences(made: Made) -> Job:
    if made.recipe.vision is None:
        raise BagAssetsError(f"{made.found.key}: the recipe has no `vision` section; add one to make it.")
    poses, images = made.artifact("ego_poses"), made.channels("frames")
    request = vision_sequences.request(
        made.rig,
        made.recipe.vision,
        made.found.key,
        made.inventory,
        clock=made.recipe.clock,
        calibration=made.calibration,
        ego_poses=poses,
        frames=images,
    )

    def make(out: ArtifactWriter) -> dict[str, Any]:
        packed = made.artifact("inventory")
        with made.source.topics(request.topics, made.inventory, packed) as recording:
            return vision_sequences.make(
                request.params, recording, out, trajectory=made.trajectory, ego_poses=poses, frames=images
            )

    return vision_sequences.STEP, request, make


def _preview(made: Made) -> Job:
    images, clouds = made.channels("frames"), made.channels("sweeps")
    poses, boxes = made.artifact("ego_poses"), made.artifact("annotations")
    request = preview.request(
        made.rig,
        made.recipe.preview,
        made.inventory,
        calibration=made.calibration,
        ego_poses=poses,
        annotations=boxes,
        frames=images,
        sweeps=clouds,
    )

    def make(out: ArtifactWriter) -> dict[str, Any]:
        # Maps and reports will ask for the track; now is the time to make it, on all workers.
        track_of(made.store, made.artifact("inventory"), poses, made.recipe.clock)
        return preview.make(
            request.params,
            out,
            inventory=made.inventory,
            trajectory=made.trajectory,
            annotations=boxes,
            frames=images,
            sweeps=clouds,
        )

    return preview.STEP, request, make


DERIVED: Mapping[str, Callable[[Made], Job]] = {
    "nuscenes_tables": _nuscenes_tables,
    "vision_sequences": _vision_sequences,
    "preview": _preview,
}
"""Asset -> function that returns its step, its request, and what runs; it raises if the recipe cannot be met."""
