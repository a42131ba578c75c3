"""Facts as Markdown tables, which the web UI shows inside a materialization's metadata."""

from collections.abc import Mapping, Sequence

from bagassets.escaping import markdown
from bagassets.geometry.calibration import Calibration
from bagassets.json_types import JsonMapping
from bagassets.store.artifact import Artifact

__all__ = ["calibration_table", "counts_table", "record_table", "table", "topics_table"]

MOST_ROWS = 60


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a Markdown table; columns of numbers are aligned to the right."""
    numeric = [
        bool(rows) and all(isinstance(row[column], int | float) for row in rows)
        for column in range(len(header))
    ]
    lines = [_line(header), _line(["--:" if is_number else "---" for is_number in numeric])]
    lines += [_line([_cell(value) for value in row]) for row in rows[:MOST_ROWS]]
    if len(rows) > MOST_ROWS:
        lines.append(_line([f"… and {len(rows) - MOST_ROWS} more", *[""] * (len(header) - 1)]))
    return "\n".join(lines)


def record_table(record: JsonMapping, header: tuple[str, str]) -> str:
    """Return a table of two columns."""
    return table(header, list(record.items()))


def counts_table(counts: Mapping[str, JsonMapping], name: str = "channel") -> str:
    """Return a table of the messages of each channel or topic: read, written, merged, and lost with the reason."""
    rows = []
    for key, entry in sorted(counts.items()):
        lost = ", ".join(f"{number} {reason}" for reason, number in sorted(entry.get("lost", {}).items()))
        rows.append((key, entry["read"], entry["written"], entry.get("merged", 0), lost or "none"))
    return table((name, "read", "written", "merged", "lost"), rows)


def topics_table(inventory: Artifact) -> str:
    """Return a table of the topics in an inventory."""
    topics = inventory.read_json("inventory.json")["topics"]
    rows = []
    for topic in topics:
        rate = "" if topic["rate_hz"] is None else f"{topic['rate_hz']:.4g} Hz"
        rows.append((topic["name"], topic["type"], topic["count"], rate, topic["problem"] or ""))
    return table(("topic", "type", "messages", "rate", "problem"), rows)


def calibration_table(calibration: Artifact) -> str:
    """Return a table of the sensors in a calibration: place on the vehicle, and lens."""
    rows = []
    channels = Calibration.from_json(calibration.read_json("calibration.json")).channels
    for name, sensor in sorted(channels.items()):
        x_m, y_m, z_m = (f"{value:.3f}" for value in sensor.ego_SE3_sensor.translation)
        camera = sensor.camera
        lens = "" if camera is None else f"{camera.width} x {camera.height}, {camera.model}"
        rows.append((name, sensor.frame, f"{x_m}, {y_m}, {z_m}", sensor.source, lens))
    return table(("channel", "frame", "x, y, z in the ego frame (m)", "from", "camera"), rows)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _cell(value: object) -> str:
    return markdown(str(value))
