"""The interactive map of all recordings, made with folium; without network it is a plain grid.

The page loads Leaflet and map tiles from the network. Without tiles, a grid of tile borders stays
visible below the ways; without Leaflet, an SVG that is part of the page takes the map's place.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass

from bagassets.escaping import html
from bagassets.json_types import JsonObject
from bagassets.report.grid_map import NamedRoute, grid_map
from bagassets.report.map_shell import FALLBACK_MARK, WAYS_MARK
from bagassets.report.style import MAP_CSS

__all__ = ["MapRoute", "trajectory_map_page"]

# All ways together have about this many points, and none has more than its share allows.
MOST_POINTS = 60_000
LEAST_WAY_POINTS = 20
_DIGITS = 6  # of degrees: a decimetre

_FALLBACK = """
<style>{css}#nomap{{display:none;font:15px system-ui,sans-serif;padding:1rem}}</style>
<div id="nomap"><p>Without network: the same ways on a plain grid.</p>{svg}</div>
<script>window.addEventListener("load", function () {{
  if (typeof L !== "undefined") return;
  document.querySelectorAll(".folium-map, .elsewhere").forEach(function (map) {{ map.style.display = "none"; }});
  document.getElementById("nomap").style.display = "block";
}});</script>
<noscript><style>#nomap{{display:block}}.folium-map{{display:none}}</style></noscript>
"""


@dataclass(frozen=True)
class MapRoute:
    """One recording on the map.

    Attributes:
        key: partition key.
        split: where it belongs; ways of a split are a layer that can be switched off.
        colour: of the split.
        note: shown under the pointer, beside the key.
        points: latitude and longitude.
        local: x and y in metres, drawn on the plain grid if there are no points.
    """

    key: str
    split: str
    colour: str
    note: str
    points: Sequence[tuple[float, float]]
    local: Sequence[tuple[float, float]] = ()


def trajectory_map_page(ways: Sequence[MapRoute], shell: str) -> str:
    """Return the page; the same bytes for the same ways.

    Args:
        ways: the recordings.
        shell: from `map_shell`.
    """
    on_earth = [way for way in ways if way.points]
    if not on_earth:
        return _grid_page(ways)
    most = max(MOST_POINTS // len(on_earth), LEAST_WAY_POINTS)
    splits = [
        {
            "name": name,
            "colour": next(way.colour for way in on_earth if way.split == name),
            "ways": [_json(way, most) for way in on_earth if way.split == name],
        }
        for name in sorted({way.split for way in on_earth})
    ]
    # In a script element its end tag and the begin of a comment mean something.
    data = json.dumps(splits, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")
    return shell.replace(FALLBACK_MARK, _fallback(ways), 1).replace(WAYS_MARK, data, 1)


def _json(way: MapRoute, most: int) -> JsonObject:
    points = [[round(lat, _DIGITS), round(lon, _DIGITS)] for lat, lon in _thinned(way.points, most)]
    return {"key": way.key, "note": way.note, "points": points}


def _thinned(points: Sequence[tuple[float, float]], most: int) -> list[tuple[float, float]]:
    step = 1 + (len(points) - 1) // most
    thin = list(points[::step])
    return thin if thin[-1] == points[-1] else [*thin, points[-1]]


def _grids(ways: Sequence[MapRoute]) -> str:
    on_earth: list[NamedRoute] = [(way.key, way.colour, way.points) for way in ways]
    elsewhere: list[NamedRoute] = [(way.key, way.colour, way.local) for way in ways if not way.points]
    local = grid_map(elsewhere, on_earth=False)
    heading = "<p>Recordings without position on Earth, each in its own metres:</p>"
    return grid_map(on_earth, on_earth=True) + (heading + local if local else "")


def _elsewhere(ways: Sequence[MapRoute]) -> str:
    """Return a box in the corner of the map with those that are nowhere on it."""
    lost: list[NamedRoute] = [(way.key, way.colour, way.local) for way in ways if not way.points]
    if not lost:
        return ""
    style = "position:fixed;left:130px;bottom:12px;z-index:1000;background:#fff;padding:.3rem .7rem;font:14px sans-serif"
    summary = f"<summary>{len(lost)} without position on Earth</summary>"
    names = ", ".join(html(key) for key, _, _ in lost)
    box = f"{summary}{grid_map(lost, on_earth=False, width=400)}<p>{names}</p>"
    return f'<details class="elsewhere" style="{style}">{box}</details>'


def _fallback(ways: Sequence[MapRoute]) -> str:
    return _FALLBACK.format(css=MAP_CSS, svg=_grids(ways)) + _elsewhere(ways)


def _grid_page(ways: Sequence[MapRoute]) -> str:
    """Return the page for recordings none of which is anywhere on Earth."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>Map of recordings</title>'
        f"<style>{MAP_CSS}body{{font:15px system-ui,sans-serif;margin:1rem}}</style></head><body>"
        f"{_grids(ways) or '<p>No recording has a way to draw.</p>'}</body></html>\n"
    )
