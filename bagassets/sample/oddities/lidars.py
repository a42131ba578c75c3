"""Oddities of lidars: how their drivers tell the times of points, and what they send where nothing was hit."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bagassets.decode.fields import stamp_and_frame
from bagassets.decode.pointcloud2 import point_fields
from bagassets.recordings.model import Message
from bagassets.sample.messages import Messages
from bagassets.sample.oddities.stream import Oddity, edited, on_clock
from bagassets.sample.schedule import Event
from bagassets.sample.truth import Truth

__all__ = ["ODDITIES", "UNTIMED"]

Columns = dict[str, NDArray[Any]]
# (columns of a cloud, its header stamp, its number) -> the columns to record.
Change = Callable[[Columns, int, int], Columns]

UNTIMED = slice(50, 90)
"""Points whose times are spoilt, where some are."""
_UPTIME_NS = 3_298_372_665_000


def _clouds(change: Change) -> Oddity:
    def edit(messages: Messages, cloud: Message, number: int) -> Message:
        header_ns, frame = stamp_and_frame(cloud.header)
        columns = {name: values[0].copy() for name, values in point_fields(cloud).items()}
        changed = change(columns, header_ns, number)
        points = np.zeros(len(changed["x"]), [(name, values.dtype) for name, values in changed.items()])
        for name, values in changed.items():
            points[name] = values
        return messages.cloud(header_ns, frame, points)

    return lambda events, _truth: edited(events, {"/lidar_top/points"}, edit)


def _dated(columns: Columns, header_ns: int, _number: int) -> Columns:
    dates_s = (header_ns + columns.pop("t").astype(np.int64)) / 1e9
    return columns | {"timestamp": dates_s}


def _with_zeros(columns: Columns, header_ns: int, number: int) -> Columns:
    dated = _dated(columns, header_ns, number)
    dated["timestamp"][UNTIMED] = 0.0
    return dated


def _with_garbage(columns: Columns, _header_ns: int, number: int) -> Columns:
    if number in {0, 3, 4, 5}:
        columns["t"][UNTIMED] = 1_100_000_000 if number else 3_604_361_924
    return columns


def _uptime(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
    def tell(columns: Columns, header_ns: int, _number: int) -> Columns:
        since_start_ns = header_ns - truth.start_ns + columns["t"].astype(np.int64)
        return columns | {"t": (_UPTIME_NS + since_start_ns).astype(np.float64)}

    return _clouds(tell)(events, truth)


def _simulated(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
    """All clocks start at 0, that of the recorder, too, and points tell seconds of it."""
    return _clouds(_dated)(on_clock(events, lambda at_ns: at_ns - truth.start_ns), truth)


ODDITIES: dict[str, Oddity] = {
    "dates-with-zeros": _clouds(_with_zeros),
    "garbage-times": _clouds(_with_garbage),
    "uptime": _uptime,
    "simulated-clock": _simulated,
    "zero-points": _clouds(
        lambda columns, *_: {name: np.insert(one, slice(0, None, 3), 0) for name, one in columns.items()}
    ),
    "unit-intensity": _clouds(
        lambda columns, *_: columns | {"intensity": columns["intensity"] / np.float32(256)}
    ),
}
