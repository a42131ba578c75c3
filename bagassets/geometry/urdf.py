"""Fixed joints of a URDF robot description, as edges of a tree of frames.

Only joints are read: http://wiki.ros.org/urdf/XML/joint. The XML parser is used directly because only
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
    path: list[str] = []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        line = parser.CurrentLineNumber
        if not path and tag != "robot":
            raise CalibrationError(
                f"{name}, line {line}: a URDF starts with <robot>, this file with <{tag}>."
            )
        path.append(tag)
        if path == ["robot", "joint"]:
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
    return [_edge(joint, name) for joint in joints if joint.kind == "fixed"]


def _edge(joint: _Joint, name: str) -> Edge:
    place = f"{name}, line {joint.line}: joint {joint.name}"
    frames = {
        tag: normalise_frame(joint.elements.get(tag, (0, {}))[1].get("link", ""))
        for tag in ("parent", "child")
    }
    for tag, frame in frames.items():
        if not frame:
            raise CalibrationError(f'{place} has no <{tag} link="…"/>; correct the URDF.')
    line, origin = joint.elements.get("origin", (joint.line, {}))
    xyz, rpy = (
        _triple(origin.get(key, "0 0 0"), key, f"{name}, line {line}: joint {joint.name}")
        for key in ("xyz", "rpy")
    )
    parent_SE3_child = SE3.create(quaternions_from_rpy(np.array(rpy)), xyz)
    return Edge.fixed(frames["parent"], frames["child"], "urdf", parent_SE3_child)


def _triple(text: str, attribute: str, place: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split())
    except ValueError:
        x = y = z = float("nan")
    if not (isfinite(x) and isfinite(y) and isfinite(z)):
        raise CalibrationError(
            f"{place}: {attribute} must be three numbers, it is '{text}'; correct the URDF, or expand it with xacro."
        )
    return x, y, z
