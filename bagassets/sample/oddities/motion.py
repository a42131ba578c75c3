"""Oddities of clocks, and of what says where the car and its sensors are."""

from collections.abc import Iterator
from functools import partial
from itertools import tee

from bagassets.decode.fields import stamp_ns
from bagassets.geometry.se3 import SE3
from bagassets.recordings.model import Message
from bagassets.sample.messages import Messages
from bagassets.sample.oddities.stream import Oddity, edited, on_clock, with_fields
from bagassets.sample.rig import EGO_SE3_LIDAR
from bagassets.sample.schedule import Event, merged
from bagassets.sample.truth import Truth

__all__ = ["BOOTED_NS", "ODDITIES", "SET_AFTER_NS", "SET_BACK_NS"]

SET_AFTER_NS = 2_000_000_000
BOOTED_NS = 200_000_000_000_000
SET_BACK_NS = 503_000_000
_STRAY_DEG, _APART_M, _LATER_NS = 4.6, 0.29, 7_000_000


def _clock_set_late(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
    """The clock of the recorder, and of all drivers, starts in 1970 and is set after 2 s."""
    set_ns = truth.start_ns + SET_AFTER_NS
    return on_clock(events, lambda at_ns: at_ns if at_ns >= set_ns else at_ns - truth.start_ns + BOOTED_NS)


def _clock_set_back(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
    """After 2 s, the clock is set back by half a second, so that this half second is recorded twice."""
    set_ns = truth.start_ns + SET_AFTER_NS
    return on_clock(events, lambda at_ns: at_ns if at_ns < set_ns else at_ns - SET_BACK_NS)


def _stray_fixes(events: Iterator[Event], _: Truth) -> Iterator[Event]:
    """The first two fixes are 512 km off."""
    return edited(
        events,
        ["/gnss/fix"],
        lambda _, fix, number: with_fields(fix, latitude=fix.latitude + _STRAY_DEG * (number < 2)),
    )


def _zero_quaternions(events: Iterator[Event], _: Truth) -> Iterator[Event]:
    """The quaternions of the first ten odometry messages are zero."""
    return edited(events, ["/odom"], _unset)


def _unset(_: Messages, odometry: Message, number: int) -> Message:
    if number < 10:
        with_fields(odometry.pose.pose.orientation, x=0.0, y=0.0, z=0.0, w=0.0)
    return odometry


def _two_publishers(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
    """Another node publishes on /odom, 0.29 m to the side."""
    first, second = tee(events)
    moved = edited((one for one in second if one.topic == "/odom"), ["/odom"], partial(_aside, truth))
    return merged(first, on_clock(moved, lambda at_ns: at_ns + _LATER_NS))


def _aside(truth: Truth, _: Messages, odometry: Message, _number: int) -> Message:
    # The pose of the other node is that of the car at its own, later stamp.
    ego = truth.odom_SE3_ego(stamp_ns(odometry.header.stamp) + _LATER_NS)
    x, y, z = (ego @ SE3(translation=(0.0, _APART_M, 0.0))).translation
    with_fields(odometry.pose.pose.position, x=x, y=y, z=z)
    return odometry


def _with_edge(parent: str, child: str, parent_SE3_child: SE3) -> Oddity:
    """Return the oddity that a static transform is sent besides all others, at the same time."""

    def edit(messages: Messages, message: Message, _number: int) -> Message:
        (edge,) = messages.transforms(0, parent, [(child, parent_SE3_child)]).transforms
        edge.header.stamp = message.transforms[0].header.stamp
        return with_fields(message, transforms=[*message.transforms, edge])

    return lambda events, _truth: edited(events, ["/tf_static"], edit)


ODDITIES: dict[str, Oddity] = {
    "clock-set-late": _clock_set_late,
    "clock-set-back": _clock_set_back,
    "stray-fixes": _stray_fixes,
    "zero-quaternions": _zero_quaternions,
    "two-publishers": _two_publishers,
    "static-again": _with_edge("base_link", "lidar_top", SE3(translation=(0.9 + 3e-8, 0.0, 1.85))),
    "static-disputed": _with_edge("base_link", "lidar_top", SE3(translation=(0.9, 0.0, 1.95))),
    "static-loop": _with_edge("lidar_top", "base_link", EGO_SE3_LIDAR),
}
