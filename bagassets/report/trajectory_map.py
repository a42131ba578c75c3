"""The interactive map of all recordings, made with folium; without network it is a plain grid.

The page loads Leaflet and map tiles from the network. Without tiles, a grid of tile borders stays
visible below the ways; without Leaflet, an SVG that is part of the page takes the map's place.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from bagassets.report.grid_map import NamedWay, grid_map
from bagassets.report.style import MAP_CSS

__all__ = ["MapWay", "trajectory_map_page"]

# Each way is drawn with at most this many points, and all of them together heat the map with this many.
WAY_POINTS = 400
HEAT_POINTS = 20_000
_LEAFLET = ("leaflet", "leaflet_css")

# A layer below the tiles that needs no network: the border of every tile, as wide as its name says.
_GRID = """
{% macro script(this, kwargs) %}
    var {{ this.get_name() }} = L.gridLayer({attribution: "plain grid"});
    {{ this.get_name() }}.createTile = function (coords) {
        var tile = document.createElement("div");
        tile.style.outline = "1px solid #d5d8d0";
        return tile;
    };
    {{ this.get_name() }}.addTo({{ this._parent.get_name() }});
{% endmacro %}
"""

_FALLBACK = """
<style>{css}#nomap{{display:none;font:15px system-ui,sans-serif;padding:1rem}}</style>
<div id="nomap"><p>Without network: the same ways on a plain grid.</p>{svg}</div>
<script>window.addEventListener("load", function () {{
  if (typeof L !== "undefined") return;
  document.querySelectorAll(".folium-map").forEach(function (map) {{ map.style.display = "none"; }});
  document.getElementById("nomap").style.display = "block";
}});</script>
<noscript><style>#nomap{{display:block}}.folium-map{{display:none}}</style></noscript>
"""


@dataclass(frozen=True)
class MapWay:
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


def trajectory_map_page(ways: Sequence[MapWay]) -> str:
    """Return the page; the same bytes for the same ways."""
    on_earth = [way for way in ways if way.points]
    if not on_earth:
        return _grid_page(ways)
    import folium  # noqa: PLC0415  (half a second, paid only when a map is drawn)
    from branca.element import Element, MacroElement  # noqa: PLC0415  (comes with folium)
    from folium.plugins import HeatMap  # noqa: PLC0415
    from jinja2 import Template  # noqa: PLC0415  (comes with folium)

    lats = [lat for way in on_earth for lat, _ in way.points]
    lons = [lon for way in on_earth for _, lon in way.points]
    page = folium.Map(tiles=None, control_scale=True, location=(sum(lats) / len(lats), sum(lons) / len(lons)))
    # Leaflet is all that is needed; every further script is one more that may not load.
    page.default_js = [entry for entry in page.default_js if entry[0] in _LEAFLET]
    page.default_css = [entry for entry in page.default_css if entry[0] in _LEAFLET]
    grid = MacroElement()
    grid._template = Template(_GRID)  # noqa: SLF001  (how folium's elements are extended)
    page.add_child(grid)
    folium.TileLayer("OpenStreetMap", name="OpenStreetMap").add_to(page)
    for split in sorted({way.split for way in on_earth}):
        layer = folium.FeatureGroup(name=escape(split))
        for way in (way for way in on_earth if way.split == split):
            tooltip = f"<b>{escape(way.key)}</b><br>{escape(way.note)}"
            points = _thinned(way.points, WAY_POINTS)
            folium.PolyLine(points, color=way.colour, weight=4, tooltip=tooltip).add_to(layer)
            folium.CircleMarker(points[0], radius=4, color=way.colour, fill=True, tooltip=tooltip).add_to(
                layer
            )
        layer.add_to(page)
    page.fit_bounds([[min(lats), min(lons)], [max(lats), max(lons)]], max_zoom=17)
    every = [point for way in on_earth for point in way.points]
    heat = [list(point) for point in _thinned(every, HEAT_POINTS)]
    HeatMap(heat, name="heat", show=False, radius=12, blur=16).add_to(page)
    folium.LayerControl(collapsed=False).add_to(page)
    figure = page.get_root()
    figure.html.add_child(Element(_fallback(ways)))
    for number, element in enumerate(_elements(figure)):
        element._id = f"{number:032x}"  # noqa: SLF001  (random otherwise, and the page must not be)
    return str(figure.render())


def _elements(element: Any) -> Iterator[Any]:
    yield element
    for child in element._children.values():  # noqa: SLF001  (folium has no other way to walk a page)
        yield from _elements(child)
    for name in ("header", "html", "script"):
        part = getattr(element, name, None)
        if part is not None and hasattr(part, "_children"):
            yield from _elements(part)


def _thinned(points: Sequence[tuple[float, float]], most: int) -> list[tuple[float, float]]:
    step = 1 + (len(points) - 1) // most
    thin = list(points[::step])
    return thin if thin[-1] == points[-1] else [*thin, points[-1]]


def _grids(ways: Sequence[MapWay]) -> str:
    on_earth: list[NamedWay] = [(way.key, way.colour, way.points) for way in ways]
    elsewhere: list[NamedWay] = [(way.key, way.colour, way.local) for way in ways if not way.points]
    local = grid_map(elsewhere, on_earth=False)
    heading = "<p>Recordings without position on Earth, each in its own metres:</p>"
    return grid_map(on_earth, on_earth=True) + (heading + local if local else "")


def _elsewhere(ways: Sequence[MapWay]) -> str:
    """Return a box in the corner of the map with those that are nowhere on it."""
    lost: list[NamedWay] = [(way.key, way.colour, way.local) for way in ways if not way.points]
    if not lost:
        return ""
    style = "position:fixed;left:12px;bottom:28px;z-index:1000;background:#fff;padding:.4rem .7rem;max-width:420px"
    summary = f"<summary>{len(lost)} without position on Earth</summary>"
    names = ", ".join(escape(key) for key, _, _ in lost)
    box = f"{summary}{grid_map(lost, on_earth=False, width=400)}<p>{names}</p>"
    return f'<details style="{style}">{box}</details>'


def _fallback(ways: Sequence[MapWay]) -> str:
    # Braces of what is filled in mean nothing to format; those of Jinja must not appear.
    return (_FALLBACK.format(css=MAP_CSS, svg=_grids(ways)) + _elsewhere(ways)).replace("{{", "{ {")


def _grid_page(ways: Sequence[MapWay]) -> str:
    """Return the page for recordings none of which is anywhere on Earth."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>Map of recordings</title>'
        f"<style>{MAP_CSS}body{{font:15px system-ui,sans-serif;margin:1rem}}</style></head><body>"
        f"{_grids(ways) or '<p>No recording has a way to draw.</p>'}</body></html>\n"
    )
