"""The step `trajectory_map`: the interactive map of all recordings, one HTML file.

The step `map_shell` makes the page without the ways, which is the same for all datasets.
"""

from collections.abc import Sequence

from bagassets.json_types import JsonObject
from bagassets.report.map_shell import map_shell
from bagassets.report.trajectory_map import MapRoute, trajectory_map_page
from bagassets.store.action import Action, Step
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_json

__all__ = ["MAP", "SHELL_STEP", "STEP", "action", "make", "make_shell"]

STEP = Step("trajectory_map", 3)
SHELL_STEP = Step("map_shell", 1, ("folium", "branca"))
MAP, SHELL = "trajectory_map.html", "shell.html"


def make_shell(out: ArtifactWriter) -> JsonObject:
    """Write the page without the ways; return the summary."""
    out.write(SHELL, map_shell().encode())
    return {}


def action(ways: Sequence[MapRoute], shell: Artifact) -> Action:
    """Return the action that makes the map of these recordings."""
    ways_digest = digest_json(
        [[way.key, way.split, way.colour, way.note, list(way.points), list(way.local)] for way in ways]
    )
    return STEP.action({}, {"ways": ways_digest, "shell": shell.digest})


def make(ways: Sequence[MapRoute], shell: Artifact, out: ArtifactWriter) -> JsonObject:
    """Write the map; return the summary."""
    page = trajectory_map_page(ways, shell.path(SHELL).read_text(encoding="utf-8"))
    out.write(MAP, page.encode())
    return {
        "recordings": len(ways),
        "on_earth": sum(bool(way.points) for way in ways),
        "points": sum(len(way.points) for way in ways),
    }
