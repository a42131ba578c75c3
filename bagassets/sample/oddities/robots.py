"""Oddities of namespaces: which robot a topic belongs to."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import tee

from bagassets.recordings.model import Message
from bagassets.sample.messages import Messages
from bagassets.sample.oddities.stream import Oddity, edited
from bagassets.sample.schedule import Event, merged
from bagassets.sample.truth import Truth

__all__ = ["APART_M", "ODDITIES"]

APART_M = 50.0


def _two_robots(events: Iterator[Event], _truth: Truth) -> Iterator[Event]:
    """Two cars with frames of equal names: `/robot1`, and `/robot2` 50 m further along x of `odom`."""
    one, other = tee(events)
    moved = {f"/robot2/{name}" for name in ("odom", "tf", "annotations")}
    return merged(_below("/robot1", one), edited(_below("/robot2", other), moved, _moved))


def _one_robot(events: Iterator[Event], _truth: Truth) -> Iterator[Event]:
    """One car below `/robot1`, whose wheels and cameras both give its odometry."""
    for one in _below("/robot1", events):
        estimators = ("wheels/odom", "cameras/odom") if one.topic == "/robot1/odom" else ()
        yield from [replace(one, topic=f"/robot1/{name}") for name in estimators] or [one]


def _below(namespace: str, events: Iterator[Event]) -> Iterator[Event]:
    return (replace(one, topic=f"{namespace}{one.topic}") for one in events)


def _moved(_messages: Messages, message: Message, _number: int) -> Message:
    """Move a car and its boxes; transforms to frames of the map and of the car stay."""
    edges = [one for one in getattr(message, "transforms", ()) if one.child_frame_id == "base_link"]
    positions = [one.transform.translation for one in edges]
    positions += [one.bbox.center.position for one in getattr(message, "detections", ())]
    positions += [message.pose.pose.position] if hasattr(message, "pose") else []
    for position in positions:
        position.x += APART_M
    return message


ODDITIES: dict[str, Oddity] = {"two-robots": _two_robots, "one-robot": _one_robot}
