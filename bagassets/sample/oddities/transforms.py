"""Oddities of static transforms."""

from bagassets.geometry.se3 import SE3
from bagassets.recordings.model import Message
from bagassets.sample.messages import Messages
from bagassets.sample.oddities.stream import Oddity, edited, with_fields
from bagassets.sample.rig import EGO_SE3_LIDAR

__all__ = ["ODDITIES"]


def _with_edge(parent: str, child: str, parent_SE3_child: SE3) -> Oddity:
    """Return the oddity that a static transform is sent besides all others, at the same time."""

    def edit(messages: Messages, message: Message, _number: int) -> Message:
        (edge,) = messages.transforms(0, parent, [(child, parent_SE3_child)]).transforms
        edge.header.stamp = message.transforms[0].header.stamp
        return with_fields(message, transforms=[*message.transforms, edge])

    return lambda events, _truth: edited(events, ["/tf_static"], edit)


ODDITIES: dict[str, Oddity] = {
    "static-again": _with_edge("base_link", "lidar_top", SE3((1.0, 0.0, 0.0, 0.0), (0.9 + 3e-8, 0.0, 1.85))),
    "static-disputed": _with_edge("base_link", "lidar_top", SE3((1.0, 0.0, 0.0, 0.0), (0.9, 0.0, 1.95))),
    "static-loop": _with_edge("lidar_top", "base_link", EGO_SE3_LIDAR),
}
