"""The result of readers of label files: one label per box, with its line."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path

import numpy as np

from bagassets.base.errors import DecodeError
from bagassets.decode.model import BoxReading
from bagassets.geometry.portable import sin_cos
from bagassets.geometry.se3 import SE3, quaternion_multiply

_GREATEST = 10**300


class UnreadableLabelsError(DecodeError):
    """A label file does not parse; `line` counts from 1, and is 0 if it is not known."""

    def __init__(self, line: int, reason: str) -> None:
        self.line = line
        super().__init__(reason)


@dataclass(frozen=True, slots=True)
class LabelFile:
    """A file with labels.

    Attributes:
        name: its name within its source, independent of the recording's path and name.
        path: its path.
        digest: digest of its content.
    """

    name: str
    path: Path
    digest: str


@dataclass(frozen=True, slots=True)
class Label:
    """One entry of a label file.

    Attributes:
        line: its line in the file, counted from 1; for Parquet the row.
        box: the box, with stamp 0 if its time is that of a frame; None if there is none.
        frame_number: number of the labelled frame, if the entry has it.
        problem: why the entry is not a usable box. With neither box nor problem it is deliberately no box.
    """

    line: int
    box: BoxReading | None = None
    frame_number: int | None = None
    problem: str | None = None


def box_label(
    line: int,
    center: Sequence[float],
    rotation: Sequence[float],
    size_m: tuple[float, float, float],
    *,
    track_id: str,
    category: str,
    frame_id: str = "",
    stamp_ns: int = 0,
    frame_number: int | None = None,
    attributes: tuple[str, ...] = (),
    score: float = 1.0,
) -> Label:
    """Return the label of a box; one without a valid pose has a `problem` and is not an error.

    Args:
        line: its line in the file.
        center: x, y, z in metres.
        rotation: quaternion w, x, y, z, within 10 % of unit length.
        size_m: width, length, height.
        track_id: see `BoxReading`.
        category: see `BoxReading`.
        frame_id: see `BoxReading`; empty if the file names none.
        stamp_ns: see `BoxReading`.
        frame_number: see `Label`.
        attributes: see `BoxReading`.
        score: see `BoxReading`.
    """
    try:
        "".join((track_id, category, frame_id, *attributes)).encode()
    except UnicodeEncodeError:  # JSON can contain lone surrogates
        return Label(line, problem="a text in it has broken characters")
    if not all(isfinite(value) for value in (*center, *rotation)):
        return Label(line, problem="its position or rotation is not finite")
    if abs(sum(value * value for value in rotation) - 1.0) > 0.2:
        return Label(line, problem="its rotation is no unit quaternion")
    frame_SE3_box = SE3.create(tuple(rotation), tuple(center))
    box = BoxReading(stamp_ns, frame_id, frame_SE3_box, size_m, track_id, category, attributes, score)
    return Label(line, box, frame_number)


def axis_rotation(axis: int, angle_rad: float) -> tuple[float, float, float, float]:
    """Return the quaternion of a rotation about an axis (0 for x, 1 for y, 2 for z); NaN if the angle is not finite."""
    if not isfinite(angle_rad):
        return (nan, nan, nan, nan)
    sine, cosine = sin_cos(np.array([angle_rad / 2]))
    rotation = [float(cosine[0]), 0.0, 0.0, 0.0]
    rotation[axis + 1] = float(sine[0])
    return (rotation[0], rotation[1], rotation[2], rotation[3])


def compose(*rotations: Sequence[float]) -> tuple[float, float, float, float]:
    """Return the product of quaternions: the last rotation is applied first."""
    product = np.array([1.0, 0.0, 0.0, 0.0])
    for rotation in rotations:
        product = quaternion_multiply(product, np.array(rotation))
    w, x, y, z = (float(value) for value in product)
    return (w, x, y, z)


def as_text(data: bytes) -> str:
    """Return a text file's content.

    Raises:
        UnreadableLabelsError: it is not UTF-8.
    """
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        raise UnreadableLabelsError(data[: err.start].count(b"\n") + 1, "is not UTF-8 text") from None


def is_number(value: object) -> bool:
    """Return whether a JSON value is a number that a float can hold."""
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) < _GREATEST
    return isinstance(value, float)
