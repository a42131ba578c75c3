"""Fixed joints of a URDF robot description as edges of a TF tree."""

from math import cos, sin
from xml.etree import ElementTree as ET

import numpy as np

from bagassets.errors import CalibrationError
from bagassets.geometry.se3 import SE3, quaternion_from_rotation
from bagassets.geometry.tf_tree import Edge, normalise_frame

__all__ = ["urdf_edges"]


def urdf_edges(text: bytes, name: str) -> list[Edge]:
    """Return the fixed joints of the URDF in `text`, which was read from the file `name`.

    Raises:
        CalibrationError: it is not XML, declares entities, or a joint is malformed.
    """
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise CalibrationError(f"{name}: a URDF with DOCTYPE or entities is refused; expand it first.")
    try:
        robot = ET.fromstring(text)  # noqa: S314  (entities were refused above)
    except ET.ParseError as err:
        raise CalibrationError(f"{name}: not a URDF ({err}); xacro files must be expanded first.") from err
    edges = []
    for joint in robot.iter("joint"):
        if joint.get("type") != "fixed":
            continue
        label = f"{name}: joint {joint.get('name', '?')}"
        parent, child, origin = joint.find("parent"), joint.find("child"), joint.find("origin")
        if parent is None or child is None:
            raise CalibrationError(f"{label} lacks parent or child; correct the URDF.")
        xyz = _triple(origin, "xyz", label)
        rpy = _triple(origin, "rpy", label)
        edges.append(
            Edge.fixed(
                normalise_frame(parent.get("link", "")),
                normalise_frame(child.get("link", "")),
                "urdf",
                SE3.create(_quaternion(*rpy), xyz),
            )
        )
    return edges


def _triple(origin: "ET.Element | None", attribute: str, label: str) -> tuple[float, float, float]:
    text = "0 0 0" if origin is None else origin.get(attribute, "0 0 0")
    try:
        x, y, z = (float(part) for part in text.split())
    except ValueError:
        raise CalibrationError(f"{label}: {attribute} must be three numbers, it is '{text}'.") from None
    return x, y, z


def _quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Quaternion of fixed-axis roll, pitch, yaw (http://wiki.ros.org/urdf/XML/joint)."""
    cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    rotation = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    return quaternion_from_rotation(rotation)
