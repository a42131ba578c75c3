"""The step `trajectory_map`: the interactive map of all recordings, one HTML file.

The step `map_shell` makes the page without routes, which is the same for all datasets.
"""

from collections.abc import Sequence

from bagassets.base.json_types import JsonObject
from bagassets.report.map_shell import map_shell
from bagassets.report.trajectory_map import MapRoute, trajectory_map_page
from bagassets.store.action import Action, Step
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_json

STEP = Step("trajectory_map", 5)
SHELL_STEP = Step("map_shell", 3, ("folium", "branca"))
MAP, SHELL = "trajectory_map.html", "shell.html"


def make_shell(out: ArtifactWriter) -> JsonObject:
    """Write the page without the routes; return the summary."""
    out.write(SHELL, map_shell().encode())
    return {}


def action(routes: Sequence[MapRoute], shell: Artifact) -> Action:
    """Return the action that makes the map of these recordings."""
    routes_digest = digest_json([[*vars(route).values()] for route in routes])
    return STEP.action({}, {"ways": routes_digest, "shell": shell.digest})


def make(routes: Sequence[MapRoute], shell: Artifact, out: ArtifactWriter) -> JsonObject:
    """Write the map; return the summary."""
    page = trajectory_map_page(routes, shell.path(SHELL).read_text(encoding="utf-8"))
    out.write(MAP, page.encode())
    return {
        "recordings": len(routes),
        "on_earth": sum(bool(route.points) for route in routes),
        "points": sum(len(route.points) for route in routes),
    }
