"""Several robots in one recording: namespaces that each have a source of poses of their own.

Frames of robots mostly have equal names, so what belongs to which robot only the topics tell.
"""

import os.path
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from itertools import combinations

from bagassets.decode.registry import bulk_types, families_of

_TF = "tf"
_MOST_SOURCES = 200  # each is compared with each


def robots_of(topics: Mapping[str, tuple[str, Collection[str]]]) -> dict[str, bool]:
    """Return namespace of a robot -> whether it has sensors, those with sensors first; empty without two robots.

    Two namespaces are robots if each has a dynamic TF topic (`/robot1/tf`), or odometry or poses of one type under one name
    (`/robot1/odom`), and sensors whose frames have equal names but for a prefix (`robot1/lidar`). So two odometries of a
    robot are none, nor are two cameras on it that track themselves. The robot beside `/robot2` that has `/tf` and sensors is "".

    Args:
        topics: name -> type, and the frames of its headers, of topics that have messages.
    """
    sensors = {
        name: {frame.rpartition("/")[2] for frame in frames if frame}
        for name, (msgtype, frames) in topics.items()
        if msgtype in bulk_types("yes") or not {"image", "cloud", "radar"}.isdisjoint(families_of(msgtype))
    }
    kinds = {name: _pose_kind(name, msgtype) for name, (msgtype, _) in topics.items()}
    sources = [(name.split("/"), kind) for name, kind in sorted(kinds.items()) if kind][:_MOST_SOURCES]

    @cache
    def frames_below(namespace: str) -> frozenset[str]:
        within = (own for name, own in sensors.items() if name.startswith(f"{namespace}/"))
        return frozenset().union(*within)

    found: set[str] = set()
    for (one, kind), (other, other_kind) in combinations(sources, 2):
        shared = len(os.path.commonprefix([one[::-1], other[::-1]]))  # noqa: RUF071  parts are meant
        if shared and kind == other_kind:
            pair = ["/".join(parts[:-shared]) for parts in (one, other)]
            if kind == _TF or (all(pair) and frozenset.intersection(*map(frames_below, pair))):
                found.update(pair)
    outer = [one for one in found if not any(other and one.startswith(f"{other}/") for other in found)]
    whose = {robot_of(name, outer) for name in sensors}
    if not whose.issuperset(outer):  # what has no namespace may as well belong to the one that has sensors
        outer = [one for one in outer if one]
    robots = sorted(outer, key=lambda one: (one not in whose, one))
    return {one: one in whose for one in robots} if len(robots) > 1 else {}


def robot_of(topic: str, robots: Iterable[str]) -> str | None:
    """Return the robot in whose namespace a topic is; None if it is in that of none."""
    return next((one for one in sorted(robots, reverse=True) if topic.startswith(f"{one}/")), None)


def _pose_kind(name: str, msgtype: str) -> str:
    """Return what makes a topic a source of poses like another one; "" if it is none."""
    families = families_of(msgtype)
    if "transforms" in families:
        return "" if "static" in name.rpartition("/")[2] else _TF
    return msgtype if "pose" in families else ""
