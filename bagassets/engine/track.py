"""Asking for the track of a recording: from the store, or made now."""

from dataclasses import dataclass
from typing import Any

from bagassets.bags.inventory import Inventory
from bagassets.bags.pack import PACK_FILE, PackedRecording
from bagassets.recipe.model_base import Clock
from bagassets.steps import track
from bagassets.steps.ego_poses import load_trajectory
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.store import Store

__all__ = ["Track", "track_of"]


@dataclass(frozen=True)
class Track:
    """Where a recording was driven, about once a second.

    Attributes:
        source: `ego_poses`, a NavSatFix topic, or None if nothing says where on Earth.
        points: (stamp_ns, latitude, longitude), in order of time; empty without source.
        local: (stamp_ns, x, y) in the global frame of the ego poses, metres.
        digest: of its artifact.
    """

    source: str | None
    points: tuple[tuple[int, float, float], ...]
    local: tuple[tuple[int, float, float], ...]
    digest: str = ""


def track_of(store: Store, inventory: Artifact, ego_poses: Artifact, clock: Clock) -> Track:
    """Return the track of the recording with these artifacts; it is made once.

    Raises:
        StoreError: the store cannot be written.
    """
    facts = inventory.read_json("inventory.json")
    typed = Inventory.from_json(facts)
    request = track.request(typed, ego_poses, clock)
    digests = {f"topic:{name}": digest for name, digest in typed.digests(request.topics).items()}

    def make(out: ArtifactWriter) -> dict[str, Any]:
        with PackedRecording(facts, inventory.path(PACK_FILE)) as recording:
            return track.make(
                request.params,
                recording.restrict(request.topics),
                out,
                trajectory=load_trajectory(ego_poses),
                ego_poses=ego_poses,
            )

    outcome = store.run(track.STEP.action(request.params, {**digests, **request.inputs}), make)
    content = outcome.artifact.read_json(track.TRACK)
    return Track(
        content["source"],
        tuple((int(t), float(lat), float(lon)) for t, lat, lon in content["points"]),
        tuple((int(t), float(x), float(y)) for t, x, y in content["local"]),
        outcome.artifact.digest,
    )
