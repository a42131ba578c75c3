"""Fixed joints of a URDF robot description, as edges of a tree of frames.

Only joints are read: http://wiki.ros.org/urdf/XML/joint; from version 1.1 on, urdfdom 6 takes `quat_xyzw` for `rpy`. The XML parser is used directly because only
it reports the line of each element.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from xml.parsers import expat

import numpy as np

from bagassets.base.errors import CalibrationError
from bagassets.geometry.euler import quaternions_from_rpy
from bagassets.geometry.se3 import SE3
from bagassets.geometry.tf_tree import Edge, normalise_frame


@dataclass
class _Joint:
    """A `<joint>` being read: attributes of its elements, and their lines."""

    name: str
    kind: str
    line: int
    elements: dict[str, tuple[int, Mapping[str, str]]] = field(default_factory=dict)


def urdf_edges(data: bytes, name: str = "URDF") -> list[Edge]:
    """Return the fixed joints as `parent_SE3_child`.

    Args:
        data: content of the file, XML in any encoding.
        name: name of the file in errors.

    Raises:
        CalibrationError: it is not a URDF, has a document type or entities, or a fixed joint lacks a
            frame or a number; the message names the line.
    """
    joints: list[_Joint] = []
    robot: dict[str, str] = {}
    path: list[str] = []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        line = parser.CurrentLineNumber
        if not path and tag != "robot":
            raise CalibrationError(
                f"{name}, line {line}: a URDF starts with <robot>, this file with <{tag}>."
            )
        path.append(tag)
        if path == ["robot"]:
            robot.update(attributes)
        elif path == ["robot", "joint"]:
            joints.append(_Joint(attributes.get("name", "?"), attributes.get("type", ""), line))
        elif path[:2] == ["robot", "joint"] and len(path) == 3:
            joints[-1].elements[tag] = (line, attributes)

    def end(_tag: str) -> None:
        path.pop()

    def document_type(*_: object) -> None:
        raise CalibrationError(
            f"{name}, line {parser.CurrentLineNumber}: a URDF with a document type (<!DOCTYPE>) is refused, since "
            "entities can blow up a file; remove it."
        )

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = document_type
    try:
        parser.Parse(data, True)
    except expat.ExpatError as err:
        raise CalibrationError(
            f"{name}, line {err.lineno}: not XML ({expat.ErrorString(err.code)}); give an expanded URDF."
        ) from err
    is_old = robot.get("version", "1.0") == "1.0"
    return [_edge(joint, name, is_old) for joint in joints if joint.kind == "fixed"]


def _edge(joint: _Joint, name: str, is_old: bool) -> Edge:
    place = f"{name}, line {joint.line}: joint {joint.name}"
    frames = {
        tag: normalise_frame(joint.elements.get(tag, (0, {}))[1].get("link", ""))
        for tag in ("parent", "child")
    }
    for tag, frame in frames.items():
        if not frame:
            raise CalibrationError(f'{place} has no <{tag} link="…"/>; correct the URDF.')
    line, origin = joint.elements.get("origin", (joint.line, {}))
    place = f"{name}, line {line}: joint {joint.name}"
    xyz = _numbers(origin.get("xyz", "0 0 0"), 3, "xyz", place)
    rotation = quaternions_from_rpy(np.array(_numbers(origin.get("rpy", "0 0 0"), 3, "rpy", place)))
    if "quat_xyzw" in origin:
        if is_old or "rpy" in origin:
            raise CalibrationError(
                f'{place}: quat_xyzw needs <robot version="1.1"> or newer, and no rpy beside it; correct the URDF.'
            )
        rotation = np.roll(_numbers(origin["quat_xyzw"], 4, "quat_xyzw", place), 1)
        if not 0.9 < float((rotation * rotation).sum()) < 1.1:
            raise CalibrationError(f"{place}: quat_xyzw must be of unit length; correct the URDF.")
    return Edge.fixed(frames["parent"], frames["child"], "urdf", SE3.create(rotation, xyz))


def _numbers(text: str, count: int, attribute: str, place: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(isfinite, numbers)):
        words = {3: "three", 4: "four"}
        raise CalibrationError(
            f"{place}: {attribute} must be {words[count]} numbers, it is '{text}'; correct the URDF, or expand it with xacro."
        )
    return numbers
