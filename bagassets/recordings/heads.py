"""Stamp and frame at the head of a decoded message: a `std_msgs/Header`, or `timestamp` and `frame_id` as Foxglove's have them."""

from typing import Any

from bagassets.recordings.model import Message

# Seconds and nanoseconds, as ROS, protobuf and the JSON schemas of Foxglove name them.
_PARTS = (("sec", "nanosec"), ("seconds", "nanos"), ("sec", "nsec"))


def time_ns(time: Any) -> int | None:
    """Return a time, whatever its parts are called, in nanoseconds since the epoch, as integers alone give it; None for anything else."""
    for seconds, nanoseconds in _PARTS:
        parts = getattr(time, seconds, None), getattr(time, nanoseconds, None)
        if parts[0] is not None and parts[1] is not None:
            return int(parts[0]) * 1_000_000_000 + int(parts[1])
    return None


def head_of(message: Message) -> tuple[int, str] | None:
    """Return stamp in nanoseconds and frame id (no leading slash) of a message; None if it has neither header nor timestamp.

    A stamp that was not set is 0, as in ROS.
    """
    header = getattr(message, "header", None)
    if header is not None:
        stamp_ns, frame = time_ns(getattr(header, "stamp", None)), getattr(header, "frame_id", "")
    else:
        stamp_ns = time_ns(getattr(message, "timestamp", None))
        frame = getattr(message, "frame_id", "") or getattr(message, "parent_frame_id", "")
    return None if stamp_ns is None else (stamp_ns, str(frame).lstrip("/"))


def first_head_of(message: Message) -> tuple[int, str] | None:
    """Return the head of a message or, of one that is a list of others (FrameTransforms, SceneUpdate), of the first of them."""
    for items in (getattr(message, name, None) for name in ("transforms", "entities")):
        if items is not None and len(items):
            return head_of(items[0])
    return head_of(message)
