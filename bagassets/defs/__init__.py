"""The Dagster side: assets, checks, the sensor, runs and how they are launched.

What steps of your own need::

    from bagassets.defs import Workspace, build_definitions, per_recording, publish

Names are imported on first use: the launcher is imported by processes that need no assets.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bagassets.defs.graph.location import build_definitions
    from bagassets.defs.graph.steps import (
        all_recordings,
        channels,
        follow_recordings,
        per_recording,
        publish,
        recipe_beside,
        skipped,
    )
    from bagassets.defs.records.reporting import errors_explained
    from bagassets.defs.records.workspace import Workspace

__all__ = [
    "Workspace",
    "all_recordings",
    "build_definitions",
    "channels",
    "errors_explained",
    "follow_recordings",
    "per_recording",
    "publish",
    "recipe_beside",
    "skipped",
]

_MODULES = dict.fromkeys(__all__, "graph.steps") | {
    "Workspace": "records.workspace",
    "build_definitions": "graph.location",
    "errors_explained": "records.reporting",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
