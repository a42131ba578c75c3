"""Oddities of radars: what their velocities are, of a radar that looks half to the left from the left corner."""

from collections.abc import Callable, Iterator
from functools import partial
from math import atan2, cos, hypot, sin, sqrt

import numpy as np

from bagassets.geometry.se3 import SE3
from bagassets.recordings.model import Message
from bagassets.sample.messages import Messages
from bagassets.sample.oddities.stream import Oddity, edited, with_fields
from bagassets.sample.render import radar_targets
from bagassets.sample.schedule import LATENCY_NS, Event, event
from bagassets.sample.truth import Truth

__all__ = ["EGO_SE3_TURNED_RADAR", "ODDITIES"]

EGO_SE3_TURNED_RADAR = SE3((cos(0.4), 0.0, 0.0, sin(0.4)), (3.4, 0.7, 0.5))

Targets = list[dict[str, float]]
_TOPIC, _FRAME = "/radar_front/points", "radar_front"
_PLACE = ("x", "y", "z", "rcs")


def _turned(msgtype: str, make: Callable[[int, Targets, Messages], Message]) -> Oddity:
    """Return the oddity of a turned radar that sees buildings, too, and sends these messages."""

    def oddity(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
        for one in edited(events, {"/tf_static"}, _turn):
            if one.topic == _TOPIC:
                stamp_ns = one.log_time_ns - LATENCY_NS
                targets = radar_targets(
                    truth.world, truth.seconds(stamp_ns), EGO_SE3_TURNED_RADAR, buildings=True
                )
                yield event(one.log_time_ns, _TOPIC, msgtype, partial(make, stamp_ns, targets))
            else:
                yield one

    return oddity


def _turn(messages: Messages, message: Message, _number: int) -> Message:
    (turned,) = messages.transforms(0, "base_link", [(_FRAME, EGO_SE3_TURNED_RADAR)]).transforms
    for edge in message.transforms:
        if edge.child_frame_id == _FRAME:
            with_fields(edge, transform=turned.transform)
    return message


def _cloud(suffix: str, stamp_ns: int, targets: Targets, messages: Messages) -> Message:
    """Return a cloud with one kind of velocities, under the names that say nothing about it."""
    kind = [(name, "<f4") for name in (*_PLACE, "vx", "vy")]
    names = (*_PLACE, f"vx{suffix}", f"vy{suffix}")
    return messages.cloud(stamp_ns, _FRAME, np.array([tuple(map(one.get, names)) for one in targets], kind))


def _scan(stamp_ns: int, targets: Targets, messages: Messages) -> Message:
    returns = []
    for one in targets:
        x, y, z = (one[axis] for axis in "xyz")
        distance, ground = sqrt(x * x + y * y + z * z), hypot(x, y)
        doppler = (x * one["vx"] + y * one["vy"] + z * one["vz"]) / distance
        angles = atan2(y, x), atan2(z, ground)
        returns.append(messages.make("radar_msgs/RadarReturn", distance, *angles, doppler, one["rcs"]))
    return messages.make("radar_msgs/RadarScan", messages.header(stamp_ns, _FRAME), returns)


_CLOUD = "sensor_msgs/msg/PointCloud2"
ODDITIES: dict[str, Oddity] = {
    "radar-relative": _turned(_CLOUD, partial(_cloud, "")),
    "radar-over-ground": _turned(_CLOUD, partial(_cloud, "_comp")),
    "radar-scan": _turned("radar_msgs/msg/RadarScan", _scan),
}
