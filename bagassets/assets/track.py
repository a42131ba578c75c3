"""The asset `track`: where on Earth a recording was driven, about once a second.

It is made along with other assets and never shown by itself: maps, reports and the selection of datasets by place
need it. File: `track.json` with `source` (`ego_poses`, a NavSatFix topic, or null), `points` (stamp_ns, latitude,
longitude) and `local` (stamp_ns, x, y in the global frame of the ego poses, metres).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bagassets.assets.asset import Asset, StoredFacts, StoredInputs, Summary, Use
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.pose_outliers import trusted_fixes
from bagassets.base.errors import DecodeError
from bagassets.decode.loading import own_decoder
from bagassets.decode.registry import own_types
from bagassets.geometry.wgs84 import LocalFrame
from bagassets.recipe.model import Recipe, Rig
from bagassets.recipe.model_base import Clock
from bagassets.recordings.recording import Recording
from bagassets.store.artifact import ArtifactWriter

FILE = "track.json"
PERIOD_NS = 1_000_000_000


@dataclass(frozen=True)
class TrackParams:
    """Parameters of `track`: which time of a message counts."""

    clock: Clock

    @classmethod
    def of(cls, recipe: Recipe, rig: Rig) -> "TrackParams":
        """Return the parameters of a rig."""
        return cls(recipe.clock_of(rig))


@dataclass(frozen=True)
class TrackUse:
    """Everything besides messages and poses that shapes a track.

    Attributes:
        topics: the NavSatFix topic that is read, if one is.
        clock: which time of a message counts.
    """

    topics: tuple[str, ...]
    clock: Clock


def use(params: TrackParams, facts: StoredFacts) -> dict[str, Use[TrackUse]]:
    """Return what a track depends on: the NavSatFix topic with the most messages, and the poses.

    If the origin of the poses on Earth is known, no topic is read; else one that the inventory has packed.
    """
    poses = facts.artifact(EGO_POSES.name)
    origin = poses.read_json("ego_poses.json")["origin"]
    is_on_earth = origin is not None and origin.get("kind") == "wgs84"
    fixes = () if is_on_earth else facts.inventory.of_type(*own_types("fix"))
    usable = [topic for topic in fixes if topic.count and topic.problem is None and topic.packed]
    best = sorted(usable, key=lambda topic: (-topic.count, topic.name))[:1]
    topics = tuple(topic.name for topic in best)
    return {"": Use(TrackUse(topics, params.clock), topics, {EGO_POSES.name: poses.digest})}


def make(use: Use[TrackUse], inputs: StoredInputs, out: ArtifactWriter) -> Summary:
    """Write the track; return the summary."""
    trajectory = inputs.trajectory
    origin = inputs.artifact(EGO_POSES.name).read_json("ego_poses.json")["origin"]
    chosen = _thinned(trajectory.stamps_ns.tolist())
    positions_m, stamps_ns = trajectory.positions_m[chosen], trajectory.stamps_ns[chosen]
    source, points = None, []
    if origin is not None and origin.get("kind") == "wgs84":
        source = EGO_POSES.name
        lat, lon, _ = LocalFrame(origin["lat"], origin["lon"], origin["alt"]).to_geodetic(positions_m)
        points = [
            [int(stamp), round(float(a), 7), round(float(b), 7)]
            for stamp, a, b in zip(stamps_ns, lat, lon, strict=True)
        ]
    elif use.topics:
        with inputs.messages(use.topics) as recording:
            points = _fixes(recording, use.topics, use.params.clock)
        source = use.topics[0] if points else None
    local = [
        [int(stamp), round(float(x), 3), round(float(y), 3)]
        for stamp, (x, y, _) in zip(stamps_ns, positions_m, strict=True)
    ]
    out.write_json(FILE, {"source": source, "points": points, "local": local}, indent=None)
    return {"source": source, "points": len(points)}


def _fixes(recording: Recording, topics: Sequence[str], clock: Clock) -> list[list[float]]:
    """Return valid fixes, at most one a second; strays, and messages that cannot be decoded, are ignored."""
    points: list[list[float]] = []
    next_ns = 0
    for message in recording.messages(topics):
        if message.log_time_ns < next_ns:
            continue
        try:
            fix = own_decoder("fix", message.msgtype)(recording.decode(message))
        except DecodeError:
            continue
        stamp_ns = fix.stamp_ns if clock == "header" and fix.stamp_ns else message.log_time_ns
        points.append([stamp_ns, round(fix.lat_deg, 7), round(fix.lon_deg, 7)])
        next_ns = message.log_time_ns + PERIOD_NS
    if not points:
        return []
    stamps_ns, lat_deg, lon_deg = (np.array(column) for column in zip(*points, strict=True))
    trusted = trusted_fixes(stamps_ns, lat_deg, lon_deg, np.full(len(points), np.nan))
    return [point for point, kept in zip(points, trusted, strict=True) if kept]


def _thinned(stamps_ns: Sequence[int]) -> list[int]:
    """Return indices of stamps at least a second apart, and the last one."""
    chosen: list[int] = []
    for index, stamp_ns in enumerate(stamps_ns):
        if not chosen or stamp_ns - stamps_ns[chosen[-1]] >= PERIOD_NS:
            chosen.append(index)
    if chosen and chosen[-1] != len(stamps_ns) - 1:
        chosen.append(len(stamps_ns) - 1)
    return chosen


TRACK = Asset(
    name="track",
    version=2,
    title="Where on Earth a recording was driven, about once a second.",
    kinds=frozenset({"json"}),
    reads=(INVENTORY, EGO_POSES),
    params=TrackParams.of,
    use=use,
    make=make,
)
