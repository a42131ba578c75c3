"""The plot of a signal: each of its elements as a line over time."""

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.assets.pictures.canvas import DIM, FAINT, Image, blank, colour_of, text, text_width
from bagassets.assets.pictures.timeline import step

_LEFT_PX, _RIGHT_PX, _TOP_PX, _BOTTOM_PX = 78, 16, 30, 26
_LEGEND_PX = 18
_SHARE = 0.3  # height of the plot, of its width
_GAP = 3  # times the usual step between two values


def signal_plot(
    title: str,
    stamps_ns: NDArray[np.int64],
    elements: Mapping[str, NDArray[np.float64]],
    span_ns: tuple[int, int],
    width: int,
) -> Image:
    """Return the picture, of which each pixel column shows the smallest and the largest value in it.

    Args:
        title: what is written above.
        stamps_ns: (N,) stamps, increasing.
        elements: name -> (N,) values, NaN where there is none; a line ends there, and at a gap in the stamps.
        span_ns: first and last stamp on the time axis.
        width: of the picture in pixels.
    """
    height = round(width * _SHARE)
    rows, places = _legend(elements, width)
    picture = blank(width, _TOP_PX + height + _BOTTOM_PX + rows * _LEGEND_PX)
    text(picture, title, 10, 18)
    low, high = _range(elements)
    bottom, columns = _TOP_PX + height, width - _LEFT_PX - _RIGHT_PX

    def y(values: NDArray[np.float64]) -> NDArray[np.int64]:
        return (bottom - np.round((values - low) / (high - low) * (height - 1))).astype(np.int64)

    _axes(picture, low, high, span_ns, bottom)
    for number, (name, values) in enumerate(elements.items()):
        colour = colour_of(number)
        known = np.isfinite(values)
        x = (stamps_ns[known] - span_ns[0]) * (columns - 1) // max(1, span_ns[1] - span_ns[0]) + _LEFT_PX
        _line(picture, x, y(values[known]), colour)
        left, row = places[name]
        base = bottom + _BOTTOM_PX + row * _LEGEND_PX
        cv2.rectangle(picture, (left, base - 1), (left + 12, base + 3), colour, -1)
        text(picture, name, left + 18, base + 6, size_px=11)
    return picture


def _range(elements: Mapping[str, NDArray[np.float64]]) -> tuple[float, float]:
    finite = [values[np.isfinite(values)] for values in elements.values()]
    lows, highs = [float(v.min()) for v in finite if len(v)], [float(v.max()) for v in finite if len(v)]
    low, high = min(lows, default=0.0), max(highs, default=0.0)
    margin = 0.05 * (high - low) if high > low else max(0.5, 0.05 * abs(high))
    return low - margin, high + margin


def _axes(picture: Image, low: float, high: float, span_ns: tuple[int, int], bottom: int) -> None:
    right = picture.shape[1] - _RIGHT_PX
    size = step((high - low) / 5)
    for number in range(int(np.ceil(low / size)), int(high / size) + 1):
        y = round(bottom - (number * size - low) / (high - low) * (bottom - _TOP_PX - 1))
        cv2.line(picture, (_LEFT_PX, y), (right, y), FAINT, 1)
        label = f"{number * size:.6g}"
        text(picture, label, _LEFT_PX - 8 - text_width(label, 10), y + 4, size_px=10, colour=DIM)
    duration_s = max(1, span_ns[1] - span_ns[0]) / 1e9
    size = step(duration_s / 8)
    for number in range(int(duration_s / size) + 1):
        x = round(_LEFT_PX + number * size / duration_s * (right - _LEFT_PX - 1))
        cv2.line(picture, (x, _TOP_PX), (x, bottom), FAINT, 1)
        text(picture, f"{number * size:g} s", x - 8, bottom + 14, size_px=10, colour=DIM)


def _line(picture: Image, x: NDArray[np.int64], y: NDArray[np.int64], colour: tuple[int, int, int]) -> None:
    if not len(x):
        return
    thickness = 1 + picture.shape[1] // 1000
    columns, starts = np.unique(x, return_index=True)
    ends = np.append(starts[1:], len(x)) - 1
    tops, bottoms = np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)
    farthest = max(2.0, _GAP * (float(np.median(np.diff(columns))) if len(columns) > 1 else 0.0))
    for index, column in enumerate(columns.tolist()):
        cv2.line(picture, (column, int(tops[index])), (column, int(bottoms[index])), colour, thickness)
        if index and column - columns[index - 1] <= farthest:
            before = int(columns[index - 1]), int(y[ends[index - 1]])
            cv2.line(picture, before, (column, int(y[starts[index]])), colour, thickness)


def _legend(elements: Mapping[str, object], width: int) -> tuple[int, dict[str, tuple[int, int]]]:
    """Return the number of rows of the legend, and element -> left edge and row."""
    places: dict[str, tuple[int, int]] = {}
    left, row = 10, 0
    for name in elements:
        needed = text_width(name, 11) + 34
        if left > 10 and left + needed > width:
            left, row = 10, row + 1
        places[name] = left, row
        left += needed
    return row + 1, places
