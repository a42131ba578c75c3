"""Validating the readings of plug-ins against `bagassets.decode.model`.

A wrong type or shape would otherwise show far from its cause, or in written files.
"""

import numpy as np

from bagassets.decode.image import ENCODINGS
from bagassets.decode.image_structure import JPEG, PNG
from bagassets.decode.model import BoxReading, CloudReading, ImageReading, PoseReading, RadarReading
from bagassets.geometry.se3 import SE3

_MAGIC = {"jpeg": JPEG, "png": PNG}


def problem_of(reading: object) -> str | None:
    """Return what is wrong with a reading, as the end of a sentence about it, or None."""
    if type(reading.frame_id if hasattr(reading, "frame_id") else "") is not str:
        return "frame_id is no text"
    if type(getattr(reading, "stamp_ns", None)) is not int:
        return "stamp_ns is no integer"
    match reading:
        case ImageReading():
            return _image_problem(reading)
        case CloudReading():
            if not _is_array(reading.points, np.float32, (None, 5)):
                return "points are not (N, 5) float32"
            times_ns = reading.times_ns
            if times_ns is not None and not _is_array(times_ns, np.int64, (len(reading.points),)):
                return "times_ns are not (N,) int64"
        case RadarReading():
            if not {"x", "y", "z"} <= reading.targets.keys():
                return "targets lack x, y or z"
            number = len(reading.targets["x"])
            if not all(_is_array(column, np.float64, (number,)) for column in reading.targets.values()):
                return "targets are not (N,) float64"
        case PoseReading():
            if not isinstance(reading.parent_SE3_child, SE3):
                return "parent_SE3_child is no SE3"
        case BoxReading():
            if not isinstance(reading.frame_SE3_box, SE3):
                return "frame_SE3_box is no SE3"
            if len(reading.size_m) != 3 or not all(isinstance(size, float) for size in reading.size_m):
                return "size_m is not three floats"
            texts = (reading.track_id, reading.category, *reading.attributes)
            if not all(type(text) is str for text in texts):
                return "track_id, category or attributes are no text"
    return None


def _image_problem(reading: ImageReading) -> str | None:
    if (reading.pixels is None) == (reading.encoded is None):
        return "pixels and encoded bytes are both given, or neither"
    if reading.encoded is not None:
        magic = _MAGIC.get(reading.encoding.partition(":")[0])
        known = magic is not None and bytes(reading.encoded[: len(magic)]) == magic
        return None if known else "encoded bytes are not what its encoding says, jpeg or png"
    layout = ENCODINGS.get(reading.encoding)
    if layout is None:
        return "encoding is none of sensor_msgs/Image in lower case"
    kinds: dict[int, type[np.generic]] = {1: np.uint8, 2: np.uint16, 4: np.float32}
    kind = kinds[layout.bytes_per_channel]
    shape = (None, None) if layout.channels == 1 else (None, None, layout.channels)
    return None if _is_array(reading.pixels, kind, shape) else "pixels do not fit its encoding"


def _is_array(value: object, kind: type[np.generic], shape: tuple[int | None, ...]) -> bool:
    """Tell whether a value is an array of a type and shape; None is any length."""
    if not isinstance(value, np.ndarray) or value.dtype != kind or value.ndim != len(shape):
        return False
    return all(want is None or want == have for want, have in zip(shape, value.shape, strict=True))
