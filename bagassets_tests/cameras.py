"""Cameras that tests make up, for the asset `frames`."""

from bagassets.assets.image_output import CameraSettings, CameraUse

IMAGE = "sensor_msgs/msg/Image"


def camera_use(msgtype=IMAGE, *, camera=None, video=None, period_ns=None, **asked):
    """Return what shapes the images of a camera that is undistorted only if a test asks for it."""
    defaults = {
        "topic": "/cam", "clock": "header", "output": "jpeg", "undistort": False, "target": None, "to_8bit": None,
        "lost_messages": 0.0,
    }  # fmt: skip
    fields = defaults | asked
    if fields["output"] != "png":
        fields = {"quality": 90} | fields
    settings = CameraSettings(**fields)
    return CameraUse(
        channel="CAM", settings=settings, msgtype=msgtype, camera=camera, video=video, period_ns=period_ns
    )
