"""The timeline: when and how often each topic has messages, and where it pauses."""

import cv2

from bagassets.assets.pictures.canvas import ACCENT, DIM, FAINT, TEXT, WARNING, Image, blank, text, text_width
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.base.quantities import count_text
from bagassets.recordings.inventory import Inventory, TopicRecord

MOST_TOPICS = 48
ROW_PX = 18
TOP_PX = 30
_NAMES_SHARE = 0.36
_LEAST_GAP_PX = 2
_WHOLE_HZ = 99.95  # rates are whole numbers from here on


def timeline_facts(inventory: Inventory) -> JsonObject:
    """Return exactly what the picture shows: the picture depends on the digest of this, not on the inventory.

    Times are in ms from the first message of the recording, at `start_ns`, so one more message hardly ever changes the picture.
    Of many topics, those with the most messages are shown.
    """
    start_ns = inventory.start_ns or 0

    def ms(stamp_ns: float | None) -> int | None:
        return None if stamp_ns is None else round((stamp_ns - start_ns) / 1e6)

    most = sorted(inventory.topics.values(), key=lambda topic: (-topic.count, topic.name))[:MOST_TOPICS]
    return {
        "start_ns": inventory.start_ns,
        "duration_ms": ms(inventory.end_ns) or 0,
        "hidden": len(inventory.topics) - len(most),
        "topics": [
            {
                "name": topic.name,
                "label": _label(topic),
                "first_ms": ms(topic.first_ns),
                "last_ms": ms(topic.last_ns),
                "gaps": [[ms(gap.start_ns), ms(gap.start_ns + gap.duration_s * 1e9)] for gap in topic.gaps],
                "has_gaps": topic.gap_count > 0,
                "problem": topic.problem is not None,
            }
            for topic in sorted(most, key=lambda topic: topic.name)
        ],
    }


def _label(topic: TopicRecord) -> str:
    rate = topic.rate_hz
    if rate is None:
        return f"{topic.count} msg"
    return f"{rate:.1f} Hz" if rate < _WHOLE_HZ else f"{rate:.0f} Hz"


def timeline(facts: JsonMapping, width: int) -> Image:
    """Return the picture; a last line says how many topics it does not show.

    Args:
        facts: from `timeline_facts`.
        width: of the picture in pixels.
    """
    topics, hidden = facts["topics"], facts["hidden"]
    picture = blank(width, TOP_PX + ROW_PX * (len(topics) + (hidden > 0)) + 8)
    axis = _Axis(facts["duration_ms"], round(width * _NAMES_SHARE), width - 78)
    axis.draw(picture, TOP_PX + ROW_PX * len(topics))
    for row, topic in enumerate(topics):
        _row(picture, axis, topic, TOP_PX + ROW_PX * row)
    if hidden:
        label = f"and {count_text(hidden, 'more topic')} with fewer messages"
        text(picture, label, 10, TOP_PX + ROW_PX * len(topics) + 13, size_px=10, colour=DIM)
    return picture


class _Axis:
    """The time axis, from the first to the last message of the recording."""

    def __init__(self, duration_ms: int, left: int, right: int) -> None:
        self.duration_ms = max(duration_ms, 1)
        self.left, self.right = left, right

    def x(self, time_ms: float) -> int:
        share = time_ms / self.duration_ms
        return round(self.left + min(max(share, 0.0), 1.0) * (self.right - self.left))

    def draw(self, picture: Image, bottom: int) -> None:
        duration_s = self.duration_ms / 1e3
        step_s = step(duration_s / 6)
        for number in range(int(duration_s / step_s) + 1):
            second = number * step_s
            x = self.x(second * 1e3)
            cv2.line(picture, (x, TOP_PX - 6), (x, bottom), FAINT, 1)
            text(picture, f"{second:g} s", x - 8, TOP_PX - 10, size_px=10, colour=DIM)


def step(least: float) -> float:
    """Return 1, 2 or 5 times a power of ten, at least `least`."""
    steps = (float(f"{digit}e{power}") for power in range(-4, 7) for digit in (1, 2, 5))
    return next((step for step in steps if step >= least), least)


def _row(picture: Image, axis: _Axis, topic: JsonMapping, top: int) -> None:
    name = topic["name"]
    while text_width(name, 10) > axis.left - 30 and len(name) > 4:
        name = name[:-1]
    text(picture, name if name == topic["name"] else f"{name}..", 10, top + 13, size_px=10)
    if topic["first_ms"] is None:
        text(picture, "no messages", axis.left + 4, top + 13, size_px=10, colour=WARNING)
        return
    first, last = axis.x(topic["first_ms"]), axis.x(topic["last_ms"])
    bar = DIM if topic["problem"] else ACCENT
    cv2.rectangle(picture, (first, top + 5), (max(last, first + 1), top + 13), bar, -1)
    for begin_ms, end_ms in topic["gaps"]:
        begin, end = axis.x(begin_ms), axis.x(end_ms)
        cv2.rectangle(picture, (begin, top + 4), (max(end, begin + _LEAST_GAP_PX), top + 14), WARNING, -1)
    colour = WARNING if topic["has_gaps"] else TEXT
    text(picture, topic["label"], axis.right + 10, top + 13, size_px=10, colour=colour)
