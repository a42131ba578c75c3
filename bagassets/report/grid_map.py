"""A map without any network: routes on a plain grid, as SVG, with their names, and a legend of it."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import count, takewhile
from math import cos, floor, log10, radians

from bagassets.base.escaping import html

METRES_PER_DEGREE = 111_320.0  # of latitude, and of longitude at the equator; good enough for a picture
COLOURS = ("#2f7ed8", "#d9822b", "#2ca05a", "#b04ac0", "#c0392b", "#16868e")
_MARGIN_PX = 34
_LINES = 8
_MOST_NAMES = 60  # on a map; more are a blur, and the legend has them all
_MOST_LISTED = 8  # in a legend without a click
_LETTER_PX, _LINE_PX = 6.6, 14.0  # of text of 11 px, on the safe side

Points = Sequence[tuple[float, float]]
NamedRoute = tuple[str, str, Points]
"""Key of a recording, its colour, and its route: (latitude, longitude), or (x, y) in metres."""


def colour_of_split(split: str, splits: Sequence[str]) -> str:
    """Return the colour of a split on maps; `splits` lists all splits in order."""
    return COLOURS[splits.index(split) % len(COLOURS)] if split in splits else "#7f7f7f"


def grid_map(
    routes: Sequence[NamedRoute], *, on_earth: bool, width: int = 900, most_points: int = 20_000
) -> str:
    """Return an SVG of routes on a metric grid; each route has its key as a tooltip, and beside it where there is room.

    Args:
        routes: the routes; those without points are left out.
        on_earth: points are latitude and longitude; else metres.
        width: in pixels; the height follows from the routes.
        most_points: routes are thinned to about this many points in total.
    """
    shown = [(key, colour, points) for key, colour, points in routes if points]
    if not shown:
        return ""
    total = sum(len(points) for _, _, points in shown)
    step = 1 + total // most_points
    firsts = [points[0] for _, _, points in shown]
    middle = sum(a for a, _ in firsts) / len(firsts), sum(b for _, b in firsts) / len(firsts)
    lines = [
        (key, colour, [_metres(point, middle, on_earth=on_earth) for point in thinned(points, step)])
        for key, colour, points in shown
    ]
    frame = _Frame([point for _, _, points in lines for point in points], width)
    parts = [
        f'<svg class="gridmap" viewBox="0 0 {width} {frame.height}" role="img" aria-label="Map of recordings">',
        f'<rect width="{width}" height="{frame.height}" fill="#f4f5f2"/>',
        *frame.grid(),
    ]
    drawn = [(key, colour, [frame.pixel(point) for point in points]) for key, colour, points in lines]
    for key, colour, pixels in drawn:
        title = f'data-way="{html(key)}"><title>{html(key)}</title>'
        x, y = pixels[0]
        if len(set(pixels)) == 1:
            parts.append(f'<circle cx="{x}" cy="{y}" r="5" fill="{colour}" {title}</circle>')
            continue
        path = " ".join(f"{x},{y}" for x, y in pixels)
        parts.append(f'<polyline points="{path}" stroke="{colour}" {title}</polyline>')
        parts.append(f'<circle cx="{x}" cy="{y}" r="3" fill="{colour}"/>')
    return "\n".join([*parts, *_names(drawn, width, frame.height), "</svg>"])


def legend(routes: Iterable[tuple[str, str, str]]) -> str:
    """Return a list of splits with their colours and recordings, many of which take a click.

    Args:
        routes: split, its colour, and key of each recording.
    """
    keys: dict[tuple[str, str], list[str]] = {}
    for split, colour, key in routes:
        keys.setdefault((split, colour), []).append(f'<span data-way="{html(key)}">{html(key)}</span>')
    items = "".join(
        f'<details{" open" if len(names) <= _MOST_LISTED else ""}><summary><span style="color:{colour}">&#9632;</span> '
        f"{html(split)} ({len(names):,})</summary>{'<br>'.join(names)}</details>"
        for (split, colour), names in sorted(keys.items())
    )
    return f'<div class="legend">{items}</div>'


def _names(drawn: Sequence[tuple[str, str, Points]], width: float, height: float) -> Iterator[str]:
    """Yield the names of routes, each at one of its ends or in its middle, where no other name is."""
    taken: list[tuple[float, float, float]] = []
    for key, colour, pixels in drawn if len(drawn) <= _MOST_NAMES else ():
        wide = len(key) * _LETTER_PX
        places = (
            (left, below, left + wide)
            for x, y in (pixels[0], pixels[-1], pixels[len(pixels) // 2])
            for left in (x + 6, x - 6 - wide)
            for below in (y - 6, y + 16)
            if left >= 0 and left + wide <= width and _LINE_PX <= below <= height - 20
        )
        free = next((place for place in places if not any(_overlap(place, other) for other in taken)), None)
        if free is not None:
            taken.append(free)
            yield f'<text class="name" x="{free[0]:.1f}" y="{free[1]:.1f}" style="fill:{colour}">{html(key)}</text>'


def _overlap(a: tuple[float, float, float], b: tuple[float, float, float]) -> bool:
    """Tell whether two lines of text (left, bottom, right) overlap."""
    return a[0] < b[2] and b[0] < a[2] and abs(a[1] - b[1]) < _LINE_PX


def thinned(points: Points, step: int) -> Points:
    """Return every n-th point, and the last one in any case."""
    thin = list(points[::step])
    return thin if thin[-1] == points[-1] else [*thin, points[-1]]


def _metres(
    point: tuple[float, float], middle: tuple[float, float], *, on_earth: bool
) -> tuple[float, float]:
    """Return x to the right (east) and y up (north) in metres."""
    if not on_earth:
        return point
    lat, lon = point
    east = (lon - middle[1]) * METRES_PER_DEGREE * cos(radians(middle[0]))
    return east, (lat - middle[0]) * METRES_PER_DEGREE


class _Frame:
    """Maps metres to pixels, with the routes in the middle."""

    def __init__(self, points: Points, width: int) -> None:
        xs, ys = [x for x, _ in points], [y for _, y in points]
        self.left, self.bottom = min(xs), min(ys)
        self.wide_m, self.high_m = max(max(xs) - self.left, 1.0), max(max(ys) - self.bottom, 1.0)
        inner = width - 2 * _MARGIN_PX
        # No taller than three fifths of its width, to be seen at once; no flatter than a third.
        self.scale = min(inner / self.wide_m, 0.6 * inner / self.high_m)
        self.width = width
        self.height = round(max(self.high_m * self.scale, inner / 3)) + 2 * _MARGIN_PX

    def pixel(self, point: tuple[float, float]) -> tuple[float, float]:
        x = (self.width - self.wide_m * self.scale) / 2 + (point[0] - self.left) * self.scale
        y = self.height - (self.height - self.high_m * self.scale) / 2 - (point[1] - self.bottom) * self.scale
        return round(x, 1), round(y, 1)

    def grid(self) -> list[str]:
        """Return lines every 1, 2 or 5 times a power of ten metres."""
        step = _round_up(max(self.width, self.height) / self.scale / _LINES)
        x0, y0 = self.pixel((self.left, self.bottom))
        spacing = step * self.scale
        across = takewhile(lambda x: x < self.width, count(x0 % spacing, spacing))
        down = takewhile(lambda y: y < self.height, count(y0 % spacing, spacing))
        label = f"{step / 1000:g} km" if step >= 1000 else f"{step:g} m"
        return [
            *(f'<path d="M{x:.1f} 0V{self.height}" class="g"/>' for x in across),
            *(f'<path d="M0 {y:.1f}H{self.width}" class="g"/>' for y in down),
            f'<text x="8" y="{self.height - 8}">grid: {label}</text>',
        ]


def _round_up(value: float) -> float:
    power: float = 10.0 ** floor(log10(value))
    return next(digit * power for digit in (1.0, 2.0, 5.0, 10.0) if digit * power >= value * (1 - 1e-9))
