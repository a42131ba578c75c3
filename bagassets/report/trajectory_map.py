"""The interactive map of all recordings, made with folium; without network it is a plain grid.

The page loads Leaflet and map tiles from the network. Without tiles, their outlines stay visible below the routes; without
Leaflet, an SVG in the page replaces the map. Both have the names of recordings, and a legend that lists them by split.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass

from bagassets.base.json_types import JsonObject
from bagassets.report.grid_map import NamedRoute, grid_map, legend, thinned
from bagassets.report.map_shell import FALLBACK_MARK, WAYS_MARK
from bagassets.report.style import LEGEND_SCRIPT, MAP_CSS

# All routes together have about this many points, and each has at most its share of them.
MOST_POINTS = 60_000
LEAST_ROUTE_POINTS = 20
_DIGITS = 6  # of degrees: a decimetre

_FALLBACK = """
<style>{css}#nomap{{display:none;font:15px system-ui,sans-serif;padding:1rem}}
#beside{{position:fixed;left:10px;bottom:46px;z-index:1000;background:#fff;padding:.1rem .7rem;max-width:22rem;max-height:45vh;
overflow:auto;font:14px system-ui,sans-serif;border-radius:4px}}#beside .legend{{display:block}}</style>
<div id="beside">{legend}{elsewhere}</div>
<div id="nomap"><p>The map could not be loaded; these are the same routes on a plain grid.</p>{svg}</div>
<script>{script}
window.addEventListener("load", function () {{
  if (typeof L !== "undefined") return;
  document.querySelectorAll(".folium-map, #beside").forEach(function (map) {{ map.style.display = "none"; }});
  document.getElementById("nomap").style.display = "block";
}});</script>
<noscript><style>#nomap{{display:block}}.folium-map,#beside{{display:none}}</style></noscript>
"""


@dataclass(frozen=True)
class MapRoute:
    """One recording on the map.

    Attributes:
        key: partition key.
        split: its split; routes of a split are one layer of the map.
        colour: colour of the split.
        note: shown in the tooltip below the key.
        points: latitude and longitude.
        local: x and y in metres, drawn on the plain grid if there are no points.
    """

    key: str
    split: str
    colour: str
    note: str
    points: Sequence[tuple[float, float]]
    local: Sequence[tuple[float, float]] = ()


def trajectory_map_page(routes: Sequence[MapRoute], shell: str) -> str:
    """Return the page; the same bytes for the same routes.

    Args:
        routes: the recordings.
        shell: from `map_shell`.
    """
    on_earth = [route for route in routes if route.points]
    if not on_earth:
        return _grid_page(routes)
    most = max(MOST_POINTS // len(on_earth), LEAST_ROUTE_POINTS)
    splits = [
        {
            "name": name,
            "colour": next(route.colour for route in on_earth if route.split == name),
            "ways": [_json(route, most) for route in on_earth if route.split == name],
        }
        for name in sorted({route.split for route in on_earth})
    ]
    # In a script element, its end tag and the start of a comment have a meaning.
    data = json.dumps(splits, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")
    fallback = _FALLBACK.format(
        css=MAP_CSS,
        svg=_grids(routes),
        legend=_legend(routes),
        elsewhere=_elsewhere(routes),
        script=LEGEND_SCRIPT,
    )
    return shell.replace(FALLBACK_MARK, fallback, 1).replace(WAYS_MARK, data, 1)


def _json(route: MapRoute, most: int) -> JsonObject:
    thin = thinned(route.points, 1 + (len(route.points) - 1) // most)
    points = [[round(lat, _DIGITS), round(lon, _DIGITS)] for lat, lon in thin]
    return {"key": route.key, "note": route.note, "points": points}


def _grids(routes: Sequence[MapRoute]) -> str:
    on_earth: list[NamedRoute] = [(route.key, route.colour, route.points) for route in routes]
    local = grid_map(_lost(routes), on_earth=False)
    heading = "<p>Recordings without a position on Earth, each in its own local frame:</p>"
    return grid_map(on_earth, on_earth=True) + (heading + local if local else "") + _legend(routes)


def _legend(routes: Sequence[MapRoute]) -> str:
    return legend((route.split, route.colour, route.key) for route in routes)


def _lost(routes: Sequence[MapRoute]) -> list[NamedRoute]:
    """Return the recordings whose place on Earth is unknown, with their local routes."""
    return [(route.key, route.colour, route.local) for route in routes if not route.points]


def _elsewhere(routes: Sequence[MapRoute]) -> str:
    """Return what stands below the legend about recordings that are not on the map."""
    lost = _lost(routes)
    if not lost:
        return ""
    summary = f"<summary>{len(lost)} without a position on Earth</summary>"
    return f"<details>{summary}{grid_map(lost, on_earth=False, width=400)}</details>"


def _grid_page(routes: Sequence[MapRoute]) -> str:
    """Return the page for recordings without any position on Earth."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>Map of recordings</title>'
        f"<style>{MAP_CSS}body{{font:15px system-ui,sans-serif;margin:1rem}}</style></head><body>"
        f"{_grids(routes) if routes else '<p>No recording has a route.</p>'}<script>{LEGEND_SCRIPT}</script></body></html>\n"
    )
