"""Pictures of the store in the web UI: what the metadata of a materialization shows.

The event log keeps whatever stands in the metadata twice, for every materialization. So addresses of pictures stand
there, and `bagassets ui` serves the pictures.
"""

import os
import re
from pathlib import Path

from bagassets.recipe import load_recipe
from bagassets.store.store import Store

__all__ = ["PICTURES", "picture_file", "picture_link"]

PICTURES = "/bagassets/artifacts"
"""Address below which the web server of a project serves pictures: digest of the artifact, then the file."""
_DIGEST = re.compile("[0-9a-f]{64}")
# Nothing that a browser would execute: what recordings contain is not trusted.
_SUFFIXES = frozenset({".jpg", ".png"})


def picture_link(artifact: str, name: str) -> str:
    """Return the address of a file of an artifact, without the server."""
    return f"{PICTURES}/{artifact}/{name}"


def picture_file(artifact: str, name: str) -> Path | None:
    """Return a picture of the project in the environment; None if its store has none of that name.

    Raises:
        BagAssetsError: the recipe is wrong, or the artifact is not in the store.
    """
    if _DIGEST.fullmatch(artifact) is None or Path(name).suffix not in _SUFFIXES:
        return None
    found = Store(load_recipe(Path(os.environ["BAGASSETS_RECIPE"])).store_path).artifact(artifact)
    if name not in {entry.path for entry in found.entries()}:
        return None
    file = found.path(name)
    return file if file.is_file() else None
