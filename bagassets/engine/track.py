"""The track of a recording, from the store, or made now."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

from bagassets.assets import track
from bagassets.assets.contents import Contents
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.assets.inventory import INVENTORY
from bagassets.engine.plan import BagPlan
from bagassets.engine.run_action import run_action
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_base import Clock
from bagassets.recordings.pack import PackedRecording
from bagassets.recordings.recording import Recording
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store


@dataclass(frozen=True)
class Track:
    """Where a recording was driven, about once a second.

    Attributes:
        source: `ego_poses`, a NavSatFix topic, or None if the position on Earth is unknown.
        points: (stamp_ns, latitude, longitude), in order of time; empty without source.
        local: (stamp_ns, x, y) in the global frame of the ego poses, metres.
        digest: digest of its artifact.
    """

    source: str | None
    points: tuple[tuple[int, float, float], ...]
    local: tuple[tuple[int, float, float], ...]
    digest: str = ""

    @property
    def on_earth(self) -> list[tuple[float, float]]:
        """Latitude and longitude, without times."""
        return [(lat, lon) for _, lat, lon in self.points]

    @property
    def on_plane(self) -> list[tuple[float, float]]:
        """The local x and y, without times."""
        return [(x, y) for _, x, y in self.local]


@dataclass(frozen=True)
class _Stored(Contents):
    """The inputs of a track, all from the store: the recording itself need not exist any more."""

    artifacts: dict[str, Artifact]

    def artifact(self, asset: str) -> Artifact:
        return self.artifacts[asset]

    @contextmanager
    def messages(self, topics: tuple[str, ...]) -> Iterator[Recording]:
        yield PackedRecording(self.inventory, self.pack).restrict(topics)


def track_of(store: Store, inventory: Artifact, ego_poses: Artifact, clock: Clock) -> Track:
    """Return the track of the recording with these artifacts; it is made only once.

    Raises:
        StoreError: the store cannot be written.
    """
    stored = _Stored({INVENTORY.name: inventory, EGO_POSES.name: ego_poses})
    use = track.use(track.TrackParams(clock), stored)[""]
    action = track.TRACK.action(use, stored.inventory)
    # Most are made by now: no lock is needed to find them.
    outcome = store.use(action) or run_action(store, action, partial(track.make, use, stored))
    content = outcome.artifact.read_json(track.FILE)
    return Track(
        content["source"],
        tuple((int(t), float(lat), float(lon)) for t, lat, lon in content["points"]),
        tuple((int(t), float(x), float(y)) for t, x, y in content["local"]),
        outcome.artifact.digest,
    )


def track_on_record(recipe: Recipe, store: Store, bag: BagPlan) -> Track | None:
    """Return the track of a recording; None if its inventory or its poses are not in the store."""
    inventory, poses = (bag.current_artifact(store, one.name) for one in (INVENTORY, EGO_POSES))
    if inventory is None or poses is None:
        return None
    return track_of(store, inventory, poses, recipe.clock_of(recipe.rig_named(bag.rig)))
