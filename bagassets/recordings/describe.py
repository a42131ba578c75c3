"""The text that `bagassets inspect` prints about a recording."""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

from bagassets.base.escaping import visible
from bagassets.base.json_types import JsonMapping
from bagassets.base.quantities import count_text, readable_bytes

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_FORMATS = {"ros1": "ROS 1 bag", "ros2": "ROS 2 bag", "mcap": "MCAP"}
_COLUMNS = ("topic", "type", "count", "Hz", "max gap", "clock offset", "frames", "problem")
_WIDEST, _LONGEST_NOTE = 300, 3000
_NUMBERS = frozenset({"count", "Hz", "max gap", "clock offset"})


def describe_inventory(inventory: JsonMapping) -> str:
    """Return the content of `inventory.json` as aligned plain text, ending in a newline.

    The clock offset is the median of log time minus header stamp.
    """
    about = _about(inventory)
    width = max(map(len, about))
    lines = [f"{name:<{width}}  {value}" for name, value in about.items()]
    if inventory["topics"]:
        lines += ["", *_table([_row(topic) for topic in inventory["topics"]])]
    if inventory["notes"]:
        lines += ["", *(f"note: {_clipped(note, _LONGEST_NOTE)}" for note in inventory["notes"])]
    return "\n".join(lines) + "\n"


def _about(inventory: JsonMapping) -> dict[str, str]:
    """Return what holds for the whole recording, by name."""
    topics, gnss, start_ns = inventory["topics"], inventory["gnss"], inventory["start_ns"]
    file_format: str = inventory["format"]
    about = {
        "format": _FORMATS.get(file_format, file_format),
        "size": readable_bytes(inventory["size"]),
        "span": "no messages" if start_ns is None else f"{_utc(start_ns)} to {_utc(inventory['end_ns'])}",
    }
    if start_ns is not None:
        about["duration"] = f"{inventory['duration_s']:.3f} s"
    messages = sum(topic["count"] for topic in topics)
    unknown = "no GNSS" if gnss is None else "the time of the first fix is not set"
    return about | {
        "messages": f"{messages} on {count_text(len(topics), 'topic')}",
        "GNSS": "none" if gnss is None else f"first {_fix(gnss['first'])}; last {_fix(gnss['last'])}",
        "daylight": inventory["daylight"] or f"unknown ({unknown})",
    }


def _row(topic: JsonMapping) -> list[str]:
    offset, frames = topic["header_offset_s"], topic["frame_ids"]
    if topic["problem"] and not all(map(str.isprintable, frames)):  # taken from bytes that are no header
        offset, frames = None, ()
    return [
        _clipped(topic["name"]),
        _clipped(topic["type"]),
        str(topic["count"]),
        "-" if topic["rate_hz"] is None else f"{topic['rate_hz']:.2f}",
        "-" if topic["max_gap_s"] is None else f"{topic['max_gap_s']:.3f} s",
        "-" if offset is None else f"{offset['median']:+.3f} s",
        _clipped(", ".join(frames)) or "-",
        _clipped(topic["problem"] or ""),
    ]


def _clipped(text: str, most: int = _WIDEST) -> str:
    return visible(text if len(text) <= most else f"{text[:most]}…")


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows below their headings; numbers flush right, no blanks at the end of a line."""
    shown = [i for i, name in enumerate(_COLUMNS) if name != "problem" or any(row[i] for row in rows)]
    table = [_COLUMNS, *rows]
    widths = {i: max(len(row[i]) for row in table) for i in shown}
    return [
        "  ".join(
            row[i].rjust(widths[i]) if _COLUMNS[i] in _NUMBERS else row[i].ljust(widths[i]) for i in shown
        ).rstrip()
        for row in table
    ]


def _utc(stamp_ns: int) -> str:
    """Return a time in UTC to the millisecond; log times beyond year 9999 stay numbers."""
    try:
        when = _EPOCH + timedelta(microseconds=stamp_ns // 1000)
    except OverflowError:
        return f"{stamp_ns} ns"
    return f"{when:%Y-%m-%d %H:%M:%S}.{when.microsecond // 1000:03d}Z"


def _fix(fix: JsonMapping) -> str:
    height = "" if fix["alt"] is None else f", {fix['alt']:.1f} m"
    return f"{fix['lat']:.6f}, {fix['lon']:.6f}{height}"
