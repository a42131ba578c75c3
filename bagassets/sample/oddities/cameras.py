"""Oddities of cameras."""

from collections.abc import Iterator

import numpy as np

from bagassets.recordings.model import Message
from bagassets.sample.messages import Messages
from bagassets.sample.oddities.stream import Oddity, edited, with_fields
from bagassets.sample.schedule import Event
from bagassets.sample.truth import Truth

__all__ = ["ODDITIES"]


def _projection_only(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
    """The CameraInfo of rectified images: K, D and R are zero, only P is filled in."""
    topics = {f"/{camera.name}/camera_info" for camera in truth.cameras.values()}
    return edited(events, topics, _without_k)


def _without_k(messages: Messages, info: Message, _number: int) -> Message:
    k, d, r = "KDR" if messages.ros1 else "kdr"
    return with_fields(info, distortion_model="", **{k: np.zeros(9), d: np.zeros(0), r: np.zeros(9)})


ODDITIES: dict[str, Oddity] = {"projection-only": _projection_only}
