"""The step `track`: where on Earth a recording was driven, about once a second.

It belongs to no asset: maps, reports and the selection of datasets by place ask for it. File: `track.json`
with `source` (`ego_poses`, a NavSatFix topic, or null), `points` (stamp_ns, latitude, longitude) and `local`
(stamp_ns, x, y in the global frame of the ego poses, metres).
"""

from collections.abc import Mapping, Sequence
from typing import Any

from bagassets.bags.inventory import Inventory
from bagassets.bags.model import Recording
from bagassets.decode.navsat import decode_navsat
from bagassets.errors import DecodeError
from bagassets.geometry.trajectory import Trajectory
from bagassets.geometry.wgs84 import LocalFrame
from bagassets.recipe.model_base import Clock
from bagassets.steps.channel import Request
from bagassets.store.action import Step
from bagassets.store.artifact import Artifact, ArtifactWriter

__all__ = ["STEP", "TRACK", "make", "request"]

STEP = Step("track", 1)

TRACK = "track.json"
PERIOD_NS = 1_000_000_000
NAVSAT = "sensor_msgs/msg/NavSatFix"


def request(inventory: Inventory, ego_poses: Artifact, clock: Clock) -> Request:
    """Return what the step reads of this recording: the NavSatFix topic with the most messages, and the poses."""
    origin = ego_poses.read_json("ego_poses.json")["origin"]
    on_earth = origin is not None and origin.get("kind") == "wgs84"
    fixes = (
        []
        if on_earth
        else [t for t in inventory.of_type(NAVSAT) if t.count and t.problem is None and t.packed]
    )
    best = sorted(fixes, key=lambda topic: (-topic.count, topic.name))[:1]
    topics = tuple(topic.name for topic in best)
    return Request({"topics": list(topics), "clock": clock}, topics, {"ego_poses": ego_poses.digest})


def make(
    params: Mapping[str, Any],
    recording: Recording,
    out: ArtifactWriter,
    *,
    trajectory: Trajectory,
    ego_poses: Artifact,
) -> dict[str, Any]:
    """Write the track; return the summary.

    Args:
        params: as made by `request`.
        recording: the declared topic, if there is one.
        out: the artifact.
        trajectory: `global_SE3_ego`, the content of `ego_poses`.
        ego_poses: the artifact of poses, for the origin of the global frame.
    """
    origin = ego_poses.read_json("ego_poses.json")["origin"]
    chosen = [] if trajectory.fixed else _thinned(trajectory.stamps_ns.tolist())
    positions_m = trajectory.positions_m[chosen] if chosen else trajectory.positions_m[:1]
    stamps_ns = trajectory.stamps_ns[chosen] if chosen else trajectory.stamps_ns[:1]
    source, points = None, []
    if origin is not None and origin.get("kind") == "wgs84":
        source = "ego_poses"
        lat, lon, _ = LocalFrame(origin["lat"], origin["lon"], origin["alt"]).to_geodetic(positions_m)
        points = [
            [int(stamp), round(float(a), 7), round(float(b), 7)]
            for stamp, a, b in zip(stamps_ns, lat, lon, strict=True)
        ]
    elif params["topics"]:
        points = _fixes(recording, params["topics"], params["clock"])
        source = params["topics"][0] if points else None
    local = [
        [int(stamp), round(float(x), 3), round(float(y), 3)]
        for stamp, (x, y, _) in zip(stamps_ns, positions_m, strict=True)
    ]
    out.write_json(TRACK, {"source": source, "points": points, "local": local}, indent=None)
    return {"source": source, "points": len(points)}


def _fixes(recording: Recording, topics: Sequence[str], clock: Clock) -> list[list[Any]]:
    """Return valid fixes, at most one a second; what cannot be decoded says nothing about the place."""
    points: list[list[Any]] = []
    next_ns = 0
    for message in recording.messages(topics):
        if message.log_time_ns < next_ns:
            continue
        try:
            fix = decode_navsat(recording.decode(message))
        except DecodeError:
            continue
        stamp_ns = fix.stamp_ns if clock == "header" and fix.stamp_ns else message.log_time_ns
        points.append([stamp_ns, round(fix.lat_deg, 7), round(fix.lon_deg, 7)])
        next_ns = message.log_time_ns + PERIOD_NS
    return points


def _thinned(stamps_ns: Sequence[int]) -> list[int]:
    """Return indices of stamps at least a second apart, and the last one."""
    chosen: list[int] = []
    for index, stamp_ns in enumerate(stamps_ns):
        if not chosen or stamp_ns - stamps_ns[chosen[-1]] >= PERIOD_NS:
            chosen.append(index)
    if chosen and chosen[-1] != len(stamps_ns) - 1:
        chosen.append(len(stamps_ns) - 1)
    return chosen
