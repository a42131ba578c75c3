"""Label files of SUSTechPOINTS (https://github.com/naurril/SUSTechPOINTS): one JSON list per cloud.

Each entry has `obj_id`, `obj_type`, perhaps `obj_attr`, and `psr`: position, scale (x along the
object's front, y to its left, z up) and rotation. The rotation is of Euler angles in radians as the
editor's `psr_to_xyz` applies them: Rx · Ry · Rz.
"""

import re
from collections.abc import Iterator

from bagassets.assets.boxes.files.json_text import entries, parse
from bagassets.assets.boxes.files.label import (
    Label,
    UnreadableLabelsError,
    as_text,
    axis_rotation,
    box_label,
    compose,
    is_number,
)
from bagassets.base.json_types import Json


def read_sustechpoints(data: bytes) -> Iterator[Label]:
    """Yield the boxes of one cloud; their time is that of the file.

    Raises:
        UnreadableLabelsError: it is not a JSON list of objects.
    """
    text = as_text(data)
    content = parse(text)
    key = None if isinstance(content, list) else "objs"
    if key is not None and not (isinstance(content, dict) and isinstance(content.get(key), list)):
        raise UnreadableLabelsError(1, "is no list of objects as SUSTechPOINTS writes them")
    for line, entry in entries(text, key):
        yield _label(line, entry)


def _label(line: int, entry: Json) -> Label:
    if not isinstance(entry, dict) or not isinstance(entry.get("psr"), dict):
        return Label(line, problem="it has no psr")
    numbers: dict[str, list[float]] = {}
    for part in ("position", "rotation", "scale"):
        values = entry["psr"].get(part)
        if not isinstance(values, dict) or not all(is_number(values.get(axis)) for axis in "xyz"):
            return Label(line, problem=f"its {part} is no x, y, z")
        numbers[part] = [float(values[axis]) for axis in "xyz"]
    category = entry.get("obj_type")
    if not isinstance(category, str) or not category:
        return Label(line, problem="it has no obj_type")
    length, width, height = numbers["scale"]
    turns = [axis_rotation(axis, angle) for axis, angle in enumerate(numbers["rotation"])]
    attributes = str(entry.get("obj_attr") or "")
    return box_label(
        line,
        numbers["position"],
        compose(*turns),
        (width, length, height),
        track_id=str(entry.get("obj_id") or ""),
        category=category,
        attributes=tuple(name for name in re.split(r"[,;\s]+", attributes) if name),
    )
