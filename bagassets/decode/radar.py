"""Radar messages of any type: clouds, scans of returns, lists of tracks, single tracks.

Which kind a message is follows from its structure:

* a `PointCloud2`, or a message that holds one with points (`targets` of SICK's RadarScan);
* a message with a list of returns, tracks or objects (`radar_msgs/RadarScan`, `RadarTracks`, …);
* a message that is one track itself (`delphi_esr_msgs/EsrTrack`); the step collects those.

Azimuths are positive to the left (anticlockwise from above, REP 103) in clouds, in `radar_msgs`
("positive angles are anticlockwise … as per REP-0103", RadarReturn.msg of 0.1.0 and 0.2.1) and in
messages not named here. They are positive to the right in the Delphi drivers, which publish the
radar's own clockwise angles. Drivers are known to disagree with the definition they publish, so
the recipe can name the side.

Velocities are relative to the radar in messages of what it measured itself (Doppler, range rate). Tracks and clouds
may be either way: drivers differ, and Autoware's converter has a switch. There the recipe says it.
"""

from dataclasses import is_dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import head, members, pose_of
from bagassets.decode.model import RadarReading
from bagassets.decode.pointcloud2 import point_fields
from bagassets.decode.radar_fields import TRACK_NUMBERS, Side, radar_reading
from bagassets.geometry.se3 import SE3
from bagassets.recordings.model import Message

_PACKAGES_ANGLES_RIGHT = ("delphi_esr_msgs/", "delphi_srr_msgs/", "delphi_mrr_msgs/")
# Types whose velocities are range rates as measured.
_RELATIVE = (
    "continental_msgs/msg/ContinentalArs548Detection",
    "continental_msgs/msg/ContinentalSrr520Detection",
    "delphi_",
    "radar_msgs/msg/RadarScan",
)
# Where several lists are in a message, these are looked at first.
_LISTS = ("returns", "tracks", "detections", "targets", "objects", "clusters", "points")


def decode_radar(message: Message, msgtype: str, azimuth_positive: Side | None = None) -> RadarReading:
    """Return the targets of a radar message.

    Args:
        message: the decoded message.
        msgtype: its type, `pkg/msg/Type`.
        azimuth_positive: the side on which azimuths are positive; None as the type defines it.

    Raises:
        DecodeError: nothing in it is known to be a position.
    """
    stamp, frame_id = head(message)
    cloud = _cloud_of(message)
    if cloud is not None:
        if hasattr(cloud, "pose") and pose_of(cloud.pose) != SE3():
            raise DecodeError("its points have an origin of their own, which is not read for radars")
        values = {name: column.reshape(-1) for name, column in point_fields(cloud).items()}
        return radar_reading(stamp, frame_id, values, azimuth_positive or "left")
    side = azimuth_positive or ("right" if msgtype.startswith(_PACKAGES_ANGLES_RIGHT) else "left")
    elements = _elements_of(message)
    return radar_reading(stamp, frame_id, _columns([message] if elements is None else elements), side)


def measures_relative(msgtype: str) -> bool:
    """Tell whether a type is defined to have velocities relative to the radar."""
    return msgtype.startswith(_RELATIVE)


def is_single_track(message: Message) -> bool:
    """Tell whether a message is one track of a cycle, rather than all of them."""
    return _cloud_of(message) is None and _elements_of(message) is None


def track_number(message: Message) -> float | None:
    """Return the number of a single track, whether or not it has a target; None if it has no number."""
    numbers = _flat(message)
    return next((numbers[name] for name in TRACK_NUMBERS if name in numbers), None)


def _is_cloud(value: Message) -> bool:
    return hasattr(value, "fields") and (hasattr(value, "point_step") or hasattr(value, "point_stride"))


def _cloud_of(message: Message) -> Message | None:
    if _is_cloud(message):
        return message
    held = (getattr(message, name) for name in members(message))
    return next((one for one in held if _is_cloud(one) and one.width and one.height), None)


def _elements_of(message: Message) -> list[Message] | None:
    """Return the list of targets in a message, None if it has no list of messages."""
    names = members(message)
    lists = [name for name in (*_LISTS, *names) if name in names and _is_list(getattr(message, name))]
    if not lists:
        return None
    filled = next((name for name in lists if getattr(message, name)), lists[0])
    elements: list[Message] = getattr(message, filled)
    return elements


def _is_list(value: object) -> bool:
    return isinstance(value, list) and (not value or is_dataclass(value[0]))


def _columns(elements: list[Message]) -> dict[str, NDArray[np.float64]]:
    """Return dotted member name in lower case -> (N,) values, of all members that are numbers."""
    rows = [_flat(element) for element in elements]
    names = rows[0] if rows else ("x", "y")
    return {name: np.array([row[name] for row in rows], dtype=np.float64) for name in names}


def _flat(element: Message, prefix: str = "") -> dict[str, float]:
    numbers: dict[str, float] = {}
    for name in members(element):
        value = getattr(element, name)
        dotted = f"{prefix}{name.lower()}"
        if isinstance(value, bool | int | float | np.number | np.bool_):
            numbers[dotted] = float(value)
        elif name == "uuid":  # 15 bits of a `unique_identifier_msgs/UUID`, as many as the radar format keeps
            numbers["uuid"] = float((int(value.uuid[0]) << 8 | int(value.uuid[1])) & 0x7FFF)
        elif name == "track_shape":
            numbers.update(_centroid(value, f"{dotted}.centroid."))
        elif is_dataclass(value) and name not in ("header", "stamp"):
            numbers.update(_flat(cast("Message", value), f"{dotted}."))
    return numbers


def _centroid(polygon: Message, prefix: str) -> dict[str, float]:
    if not polygon.points:
        return {prefix + axis: float("nan") for axis in "xyz"}
    number = len(polygon.points)
    return {prefix + axis: sum(getattr(p, axis) for p in polygon.points) / number for axis in "xyz"}
