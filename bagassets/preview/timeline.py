"""The timeline: when and how often each topic has messages, and where it pauses."""

from collections.abc import Sequence

import cv2

from bagassets.json_types import JsonMapping, JsonObject
from bagassets.preview.canvas import ACCENT, DIM, FAINT, TEXT, WARNING, Image, blank, text, text_width
from bagassets.quantities import count_text
from bagassets.recordings.inventory import Inventory

__all__ = ["timeline", "timeline_facts"]

MOST_TOPICS = 48
ROW_PX = 18
TOP_PX = 30
_NAMES_SHARE = 0.36
_LEAST_GAP_PX = 2


def timeline_facts(inventory: Inventory) -> JsonObject:
    """Return exactly what the picture shows: the picture depends on the digest of this, not on the inventory."""
    return {
        "start_ns": inventory.start_ns,
        "end_ns": inventory.end_ns,
        "topics": [
            {
                "name": name,
                "count": topic.count,
                "rate_hz": topic.rate_hz,
                "first_ns": topic.first_ns,
                "last_ns": topic.last_ns,
                "gaps": [[gap.start_ns, gap.duration_s] for gap in topic.gaps],
                "gap_count": topic.gap_count,
                "problem": topic.problem is not None,
            }
            for name, topic in inventory.topics.items()
        ],
    }


def timeline(facts: JsonMapping, width: int) -> Image:
    """Return the picture.

    Of many topics those with the most messages are shown; a last line says how many are not.

    Args:
        facts: from `timeline_facts`.
        width: of the picture in pixels.
    """
    topics = _chosen(facts["topics"])
    hidden = len(facts["topics"]) - len(topics)
    picture = blank(width, TOP_PX + ROW_PX * (len(topics) + (hidden > 0)) + 8)
    axis = _Axis(facts, round(width * _NAMES_SHARE), width - 78)
    axis.draw(picture, TOP_PX + ROW_PX * len(topics))
    for row, topic in enumerate(topics):
        _row(picture, axis, topic, TOP_PX + ROW_PX * row)
    if hidden:
        label = f"and {count_text(hidden, 'more topic')} with fewer messages"
        text(picture, label, 10, TOP_PX + ROW_PX * len(topics) + 13, size_px=10, colour=DIM)
    return picture


def _chosen(topics: Sequence[JsonMapping]) -> list[JsonMapping]:
    most = sorted(topics, key=lambda topic: (-topic["count"], topic["name"]))[:MOST_TOPICS]
    return sorted(most, key=lambda topic: str(topic["name"]))


class _Axis:
    """The time axis, from the first to the last message of the recording."""

    def __init__(self, facts: JsonMapping, left: int, right: int) -> None:
        self.start_ns = facts["start_ns"] or 0
        self.duration_s = max(((facts["end_ns"] or 0) - self.start_ns) / 1e9, 1e-3)
        self.left, self.right = left, right

    def x(self, stamp_ns: float) -> int:
        share = (stamp_ns - self.start_ns) / 1e9 / self.duration_s
        return round(self.left + min(max(share, 0.0), 1.0) * (self.right - self.left))

    def draw(self, picture: Image, bottom: int) -> None:
        step_s = _step(self.duration_s / 6)
        for number in range(int(self.duration_s / step_s) + 1):
            second = number * step_s
            x = self.x(self.start_ns + second * 1e9)
            cv2.line(picture, (x, TOP_PX - 6), (x, bottom), FAINT, 1)
            text(picture, f"{second:g} s", x - 8, TOP_PX - 10, size_px=10, colour=DIM)


def _step(least: float) -> float:
    """Return 1, 2 or 5 times a power of ten, at least `least`."""
    for power in range(-4, 7):
        for digit in (1, 2, 5):
            step = float(f"{digit}e{power}")
            if step >= least:
                return step
    return least


def _row(picture: Image, axis: _Axis, topic: JsonMapping, top: int) -> None:
    name = topic["name"]
    while text_width(name, 10) > axis.left - 30 and len(name) > 4:
        name = name[:-1]
    text(picture, name if name == topic["name"] else f"{name}..", 10, top + 13, size_px=10)
    if topic["first_ns"] is None:
        text(picture, "no messages", axis.left + 4, top + 13, size_px=10, colour=WARNING)
        return
    first, last = axis.x(topic["first_ns"]), axis.x(topic["last_ns"])
    bar = DIM if topic["problem"] else ACCENT
    cv2.rectangle(picture, (first, top + 5), (max(last, first + 1), top + 13), bar, -1)
    for start_ns, duration_s in topic["gaps"]:
        begin, end = axis.x(start_ns), axis.x(start_ns + duration_s * 1e9)
        cv2.rectangle(picture, (begin, top + 4), (max(end, begin + _LEAST_GAP_PX), top + 14), WARNING, -1)
    rate = topic["rate_hz"]
    label = (
        f"{rate:.1f} Hz"
        if rate is not None and rate < 99.95
        else f"{rate:.0f} Hz"
        if rate is not None
        else f"{topic['count']} msg"
    )
    text(
        picture, label, axis.right + 10, top + 13, size_px=10, colour=WARNING if topic["gap_count"] else TEXT
    )
