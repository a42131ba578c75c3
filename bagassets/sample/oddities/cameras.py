"""Oddities of cameras."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from bagassets.recordings.model import Message
from bagassets.sample.messages import Messages
from bagassets.sample.oddities.stream import Oddity, with_fields
from bagassets.sample.render import CameraView
from bagassets.sample.rig import Camera
from bagassets.sample.schedule import CAMERA_LATENCY_NS, Event, camera_image, event
from bagassets.sample.truth import Truth

__all__ = ["ODDITIES", "rectified"]


def rectified(camera: Camera) -> Camera:
    """Return what a camera is after its driver has rectified its images: without distortion, a little wider."""
    lens = camera.model
    return replace(
        camera, model=lens.undistorted((0.9 * lens.fx, 0.9 * lens.fy, lens.cx - 3.0, lens.cy + 2.0))
    )


def _projection_only(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
    """Rectified images, and the CameraInfo of such: K, D and R are zero, only P is filled in."""
    cameras = {camera.name: rectified(camera) for camera in truth.cameras.values()}
    views = {name: CameraView(truth.world, camera) for name, camera in cameras.items()}
    for one in events:
        name, _, topic = one.topic[1:].partition("/")
        stamp_ns = one.log_time_ns - CAMERA_LATENCY_NS
        if name not in cameras:
            yield one
        elif topic == "camera_info":
            yield event(one.log_time_ns, one.topic, one.msgtype, partial(_only_p, stamp_ns, cameras[name]))
        else:
            image = views[name].image(truth.seconds(stamp_ns))
            yield event(one.log_time_ns, *camera_image(cameras[name], stamp_ns, image))


def _only_p(stamp_ns: int, camera: Camera, messages: Messages) -> Message:
    k, d, r = "KDR" if messages.ros1 else "kdr"
    info = messages.camera_info(stamp_ns, camera)
    return with_fields(info, distortion_model="", **{k: np.zeros(9), d: np.zeros(0), r: np.zeros(9)})


ODDITIES: dict[str, Oddity] = {"projection-only": _projection_only}
