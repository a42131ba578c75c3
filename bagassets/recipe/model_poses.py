"""Recipe sections about the source of ego poses."""

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from bagassets.recipe.model_base import FrameName, Model, TopicName, Transform


def _sender(text: str) -> str:
    match = re.fullmatch(r"(\d{1,3})\.(\d{1,3})\.(\d{1,3})\.(\d{1,3})(?::(\d{1,5}))?", text)
    if match is None or any(int(n) > 255 for n in match.groups()[:4]) or int(match[5] or 0) > 65535:
        raise ValueError("must be an IPv4 address, with or without port, as in 10.1.1.20 or 10.1.1.20:3000")
    return text


Sender = Annotated[str, AfterValidator(_sender)]


class _MovingSource(Model):
    max_gap_s: float = Field(
        0.5,
        gt=0,
        description="Longest gap between poses to interpolate over; readings in longer gaps have no pose.",
    )
    extrapolate_s: float = Field(
        0.05,
        ge=0,
        description="Readings this much before the first or after the last pose get one extrapolated with constant velocity.",
    )


class OdometrySource(_MovingSource):
    """`nav_msgs/Odometry`: the pose of its child frame."""

    source: Literal["odometry"] = "odometry"
    topic: TopicName = Field(description="Odometry topic.")
    frame: FrameName | None = Field(
        None, description="Frame of the poses; default: the child frame in the messages."
    )


class PoseTopicSource(_MovingSource):
    """`PoseStamped`, `PoseWithCovarianceStamped` or, as of motion capture, `TransformStamped`: the pose of the ego frame."""

    source: Literal["pose"] = "pose"
    topic: TopicName = Field(description="Topic of stamped poses.")
    frame: FrameName | None = Field(
        None, description="Frame of the poses; default: the child frame of a transform, else the ego frame."
    )


class TfSource(_MovingSource):
    """A chain of transforms `global_frame -> … -> ego_frame`."""

    source: Literal["tf"] = "tf"
    global_frame: FrameName = Field("map", description="Fixed frame at the root of the chain.")


class NavSatSource(_MovingSource):
    """`NavSatFix` projected to local metres, with orientation from an Imu or from the course.

    If transforms from the ego frame to antenna and Imu are known, they are applied.
    """

    source: Literal["navsat"] = "navsat"
    topic: TopicName = Field(description="NavSatFix topic.")
    imu: TopicName | None = Field(
        None, description="Imu topic with orientation (ENU); default: course over ground."
    )


class NcomSource(_MovingSource):
    """OxTS NCOM packets of an inertial navigation system, projected to local metres."""

    source: Literal["ncom"] = "ncom"
    topic: TopicName = Field(
        description="Topic of ethernet_msgs/Packet, udp_msgs/UdpPacket or another message with one UDP payload."
    )
    sender: Sender | None = Field(
        None, description="Address, with or without port, of the sender; default: any sender."
    )
    stamp: Literal["message", "packet"] = Field(
        "message",
        description="Time of a pose: that of its message, by the recipe's clock as for all other readings, or the GPS time in the packet as UTC.",
    )
    leap_seconds: int = Field(18, description="GPS time minus UTC, for packets without it; 18 since 2017.")
    frame: FrameName | None = Field(None, description="Frame of the poses; default: the ego frame.")


class FixedPose(Model):
    """A sensor rig that does not move."""

    source: Literal["fixed"] = "fixed"
    pose: Transform = Field(Transform(), description="global <- ego.")


MovingPoseSource = OdometrySource | PoseTopicSource | TfSource | NavSatSource | NcomSource
PoseSource = Annotated[MovingPoseSource | FixedPose, Field(discriminator="source")]
