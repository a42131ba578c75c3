"""The page of the interactive map without routes, made with folium once per version of folium.

Importing folium takes longer than adding the routes of a dataset, so the page is kept in the store, and an update of the map
only inserts data.
"""

from collections.abc import Iterator
from typing import Any

WAYS_MARK, FALLBACK_MARK = "@@WAYS@@", "@@FALLBACK@@"
# Only Leaflet is needed; every other script is one more that may fail to load.
_NEEDED = ("leaflet", "leaflet_css")

# A layer below the tiles that needs no network: the outlines of tiles.
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

# Routes become layers, one per split; their names and notes are set as text, never as HTML.
_WAYS = """
{% macro script(this, kwargs) %}
    (function () {
        var map = {{ this._parent.get_name() }};
        var data = JSON.parse(document.getElementById("ways").textContent);
        var overlays = {}, every = [], lines = {};
        var named = data.reduce(function (sum, split) { return sum + split.ways.length; }, 0) <= 30;
        function tooltip(way) {
            var box = document.createElement("div"), name = document.createElement("b");
            name.textContent = way.key;
            box.append(name, document.createElement("br"), way.note);
            return box;
        }
        data.forEach(function (split) {
            var layer = L.featureGroup(), name = document.createElement("span");
            split.ways.forEach(function (way) {
                var style = {color: split.colour, weight: 4, radius: 4, fill: true};
                var line = lines[way.key] = L.polyline(way.points, {color: split.colour, weight: 4});
                line.bindTooltip(tooltip(way), {sticky: true}).addTo(layer);
                L.circleMarker(way.points[0], style).bindTooltip(tooltip(way), {permanent: named}).addTo(layer);
                every.push.apply(every, way.points);
            });
            name.textContent = "\u25a0 " + split.name;
            name.style.color = split.colour;
            overlays[name.outerHTML] = layer.addTo(map);
        });
        map.fitBounds(L.latLngBounds(every), {maxZoom: 17});
        if (L.heatLayer) { overlays.heat = L.heatLayer(every, {radius: 12, blur: 16}); }
        L.control.layers({}, overlays, {collapsed: false}).addTo(map);
        document.querySelectorAll("#beside [data-way]").forEach(function (name) {
            var line = lines[name.dataset.way];
            name.onmouseenter = function () { line.setStyle({weight: 10}).bringToFront(); };
            name.onmouseleave = function () { line.setStyle({weight: 4}); };
        });
    })();
{% endmacro %}
"""


def map_shell() -> str:
    """Return the page, with `WAYS_MARK` in place of its data and `FALLBACK_MARK` in place of the map's substitute."""
    import folium
    from branca.element import Element, MacroElement
    from folium.plugins import HeatMap
    from jinja2 import Template

    page = folium.Map(tiles=None, control_scale=True, location=(0.0, 0.0), zoom_start=2)
    page.default_js = [
        *(entry for entry in page.default_js if entry[0] in _NEEDED),
        *((f"heat_{number}", link) for number, (_, link) in enumerate(HeatMap.default_js)),
    ]
    page.default_css = [entry for entry in page.default_css if entry[0] in _NEEDED]
    for text in (_GRID, _WAYS):
        element = MacroElement()
        element._template = Template(text)  # noqa: SLF001  (how folium's elements are extended)
        page.add_child(element)
        if text is _GRID:
            folium.TileLayer("OpenStreetMap").add_to(page)
    figure = page.get_root()
    data = f'<script type="application/json" id="ways">{WAYS_MARK}</script>{FALLBACK_MARK}'
    figure.html.add_child(Element(data))
    for number, element in enumerate(_elements(figure)):
        element._id = f"{number:032x}"  # noqa: SLF001  (it would be random, and the page must be reproducible)
    return str(figure.render())


def _elements(element: Any) -> Iterator[Any]:
    yield element
    for child in element._children.values():  # noqa: SLF001  (folium has no other way to walk a page)
        yield from _elements(child)
    for name in ("header", "html", "script"):
        part = getattr(element, name, None)
        if part is not None and hasattr(part, "_children"):
            yield from _elements(part)
