"""The step `trajectory_map`: the interactive map of all recordings, one HTML file.

The step `map_shell` makes the page without routes, which is the same for all datasets.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from bagassets.base.files import write_atomically
from bagassets.base.json_types import JsonObject
from bagassets.engine.run_action import run_action
from bagassets.report.map_shell import map_shell
from bagassets.report.trajectory_map import MapRoute, trajectory_map_page
from bagassets.store.action import Step
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_json
from bagassets.store.store import Outcome, Store

STEP = Step("trajectory_map", 5)
SHELL_STEP = Step("map_shell", 3, ("folium", "branca"))
MAP, SHELL = "trajectory_map.html", "shell.html"
_RECORDINGS = "trajectory_map.json"


def map_shell_of(store: Store) -> Artifact:
    """Return the page without the routes, made once in a store: that takes a third of a second."""

    def make(out: ArtifactWriter) -> JsonObject:
        out.write(SHELL, map_shell().encode())
        return {}

    return run_action(store, SHELL_STEP.action({}, {}), make).artifact


def map_of(store: Store, routes: Sequence[MapRoute]) -> Outcome:
    """Return the map of these recordings, from the store or made now."""
    shell = map_shell_of(store)

    def make(out: ArtifactWriter) -> JsonObject:
        page = trajectory_map_page(routes, shell.path(SHELL).read_text(encoding="utf-8"))
        out.write(MAP, page.encode())
        return {
            "recordings": len(routes),
            "on_earth": sum(bool(route.points) for route in routes),
            "points": sum(len(route.points) for route in routes),
        }

    digest = digest_json([[*vars(route).values()] for route in routes])
    return run_action(store, STEP.action({}, {"ways": digest, "shell": shell.digest}), make)


def note_recordings(folder: Path, contents: Mapping[str, str]) -> None:
    """Note beside the map which recordings (key -> digest of the content) it was made from."""
    write_atomically(folder / _RECORDINGS, json.dumps(dict(contents)).encode())


def recordings_on_map(folder: Path) -> dict[str, str] | None:
    """Return what `note_recordings` noted; None if it is not there, as of a map of an earlier version."""
    try:
        noted: dict[str, str] = json.loads((folder / _RECORDINGS).read_bytes())
    except (OSError, ValueError):
        return None
    return noted
