"""The step `trajectory_map`: the interactive map of all recordings, one HTML file."""

from collections.abc import Sequence
from typing import Any

from bagassets.report.trajectory_map import MapWay, trajectory_map_page
from bagassets.store.action import Action, Step
from bagassets.store.artifact import ArtifactWriter
from bagassets.store.canonical import digest_json

__all__ = ["MAP", "STEP", "action", "make"]

STEP = Step("trajectory_map", 1, ("folium",))
MAP = "trajectory_map.html"


def action(ways: Sequence[MapWay]) -> Action:
    """Return the action that makes the map of these recordings."""
    ways_digest = digest_json(
        [[way.key, way.split, way.colour, way.note, list(way.points), list(way.local)] for way in ways]
    )
    return STEP.action({}, {"ways": ways_digest})


def make(ways: Sequence[MapWay], out: ArtifactWriter) -> dict[str, Any]:
    """Write the map; return the summary."""
    out.write(MAP, trajectory_map_page(ways).encode())
    return {
        "recordings": len(ways),
        "on_earth": sum(bool(way.points) for way in ways),
        "points": sum(len(way.points) for way in ways),
    }
