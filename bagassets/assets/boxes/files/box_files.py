"""Our own format of box files, JSON or Parquet, described in `docs/annotations.md`."""

import io
from collections.abc import Iterator

from bagassets.assets.boxes.files.json_text import entries, parse
from bagassets.assets.boxes.files.label import (
    Label,
    UnreadableLabelsError,
    as_text,
    axis_rotation,
    box_label,
    is_number,
)
from bagassets.base.json_types import Json, JsonMapping

FORMAT = "bagassets-boxes"
VERSION = 1

_REQUIRED = ("stamp_ns", "category", "center", "size")
_OPTIONAL = ("frame", "track_id", "rotation", "yaw", "attributes", "score")
_HEADER = ("format", "version", "frame", "boxes", "comment")
_NUMBERS = ("x", "y", "z", "qw", "qx", "qy", "qz", "width", "length", "height")


def read_json_boxes(data: bytes) -> Iterator[Label]:
    """Yield the boxes of a JSON file.

    Raises:
        UnreadableLabelsError: it is not JSON, or not in this format.
    """
    text = as_text(data)
    content = parse(text)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise UnreadableLabelsError(1, f'is no box file: it begins with {{"format": "{FORMAT}", ...')
    if content.get("version") != VERSION:
        raise UnreadableLabelsError(1, f"has version {content.get('version')!r}, {VERSION} is known here")
    unknown = [name for name in content if name not in _HEADER]
    if unknown:
        raise UnreadableLabelsError(1, f"has the unknown field {unknown[0]}; known are {', '.join(_HEADER)}")
    if not isinstance(content.get("boxes"), list):
        raise UnreadableLabelsError(1, "has no list `boxes`")
    frame = content.get("frame", "")
    if not isinstance(frame, str):
        raise UnreadableLabelsError(1, "`frame` is no text")
    for line, entry in entries(text, "boxes"):
        yield _label(line, entry, frame)


def _label(line: int, entry: Json, frame: str) -> Label:
    problem = _problem(entry)
    if problem is not None:
        return Label(line, problem=problem)
    width, length, height = (float(value) for value in entry["size"])
    rotation = entry.get("rotation") or axis_rotation(2, float(entry.get("yaw", 0.0)))
    return box_label(
        line,
        [float(value) for value in entry["center"]],
        [float(value) for value in rotation],
        (width, length, height),
        track_id=str(entry.get("track_id", "")),
        category=entry["category"],
        frame_id=entry.get("frame", frame).lstrip("/"),
        stamp_ns=entry["stamp_ns"],
        attributes=tuple(entry.get("attributes", ())),
        score=float(entry.get("score", 1.0)),
    )


def _problem(entry: Json) -> str | None:
    """Return what is wrong with the fields of one entry, or None."""
    if not isinstance(entry, dict):
        return "it is no object"
    for name in _REQUIRED:
        if name not in entry:
            return f"it has no {name}"
    for name in entry:
        if name not in _REQUIRED and name not in _OPTIONAL:
            return f"it has the unknown field {name}"
    if type(entry["stamp_ns"]) is not int or not 0 <= entry["stamp_ns"] < 1 << 63:
        return "its stamp_ns is no whole number"
    for name in ("category", "frame"):
        if not isinstance(entry.get(name, ""), str):
            return f"its {name} is no text"
    if not isinstance(entry.get("track_id", ""), str | int) or isinstance(entry.get("track_id"), bool):
        return "its track_id is neither text nor a whole number"
    for name, number in (("center", 3), ("size", 3), ("rotation", 4)):
        values = entry.get(name, [0] * number)
        if not isinstance(values, list) or len(values) != number or not all(map(is_number, values)):
            return f"its {name} is no list of {number} numbers"
    if "rotation" in entry and "yaw" in entry:
        return "it has both rotation and yaw"
    for name in ("yaw", "score"):
        if not is_number(entry.get(name, 0)):
            return f"its {name} is no number"
    attributes = entry.get("attributes", [])
    if not isinstance(attributes, list) or not all(isinstance(name, str) for name in attributes):
        return "its attributes are no list of texts"
    return None


def read_parquet_boxes(data: bytes) -> Iterator[Label]:
    """Yield the boxes of a Parquet file with the columns of `annotations.parquet`; lines are rows.

    Raises:
        UnreadableLabelsError: it is not Parquet, or lacks a column.
    """
    import pyarrow as pa  # noqa: PLC0415  (0.2 s, paid by those who have such files)
    import pyarrow.parquet as pq  # noqa: PLC0415

    try:
        table = pq.read_table(io.BytesIO(data))
        names = table.column_names
    except (pa.ArrowException, OSError, UnicodeDecodeError):
        raise UnreadableLabelsError(0, "is no Parquet file") from None
    required = ("stamp_ns", "category", *_NUMBERS)
    missing = [name for name in required if name not in names]
    if missing:
        raise UnreadableLabelsError(0, f"lacks the column {missing[0]}; required are {', '.join(required)}")
    if not pa.types.is_integer(table.schema.field("stamp_ns").type):
        raise UnreadableLabelsError(0, "has a column stamp_ns that is not of whole numbers")
    rows = (entry for batch in table.to_batches(max_chunksize=1 << 16) for entry in batch.to_pylist())
    try:
        for row, entry in enumerate(rows, start=1):
            yield _row_label(row, entry)
    except UnicodeDecodeError:
        raise UnreadableLabelsError(0, "has a text that is not UTF-8") from None


def _row_label(row: int, entry: JsonMapping) -> Label:
    empty = [name for name in ("stamp_ns", "category", *_NUMBERS) if entry[name] is None]
    if empty:
        return Label(row, problem=f"its {empty[0]} is empty")
    if not all(is_number(entry[name]) for name in _NUMBERS):
        return Label(row, problem="a coordinate is no number")
    track, score, attributes = (entry.get(name) for name in ("track_id", "score", "attributes"))
    if score is not None and not is_number(score):
        return Label(row, problem="its score is no number")
    if not isinstance(attributes or [], list) or not all(isinstance(name, str) for name in attributes or []):
        return Label(row, problem="its attributes are no list of texts")
    return box_label(
        row,
        [float(entry[name]) for name in ("x", "y", "z")],
        [float(entry[name]) for name in ("qw", "qx", "qy", "qz")],
        (float(entry["width"]), float(entry["length"]), float(entry["height"])),
        track_id="" if track is None else str(track),
        category=str(entry["category"]),
        frame_id=str(entry.get("frame") or "").lstrip("/"),
        stamp_ns=entry["stamp_ns"],
        attributes=tuple(attributes or ()),
        score=1.0 if score is None else float(score),
    )
