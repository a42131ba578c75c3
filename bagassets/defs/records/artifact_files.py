"""Pictures of the store, the map and the report in the web UI: what the metadata of a materialization shows or links to.

The event log keeps whatever stands in the metadata twice, for every materialization. So addresses of pictures stand
there, and `bagassets ui` serves the pictures.
"""

import os
import re
from pathlib import Path

from bagassets.base.escaping import markdown
from bagassets.formats.report_data import map_path, report_path
from bagassets.recipe import load_recipe
from bagassets.store.store import Store

PICTURES = "/bagassets/artifacts"
"""Address below which the web server of a project serves pictures: digest of the artifact, then the file."""
PAGES = "/bagassets/pages"
"""Address below which it serves the map and the report of the project."""
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


def page_link(name: str, file: Path) -> str:
    """Return Markdown that names the file of a page of the project, `map` or `report`, and links to it where that is served.

    The link is empty, so that there is none in another web server of Dagster; the style of ours shows its title.
    """
    return f'[]({PAGES}/{name} "Open the {name}") {markdown(str(file))}'


def page_file(name: str) -> Path | None:
    """Return where a page of the project in the environment is, if it was made; None if there is no such page.

    Raises:
        BagAssetsError: the recipe is wrong.
    """
    recipe_file = Path(os.environ["BAGASSETS_RECIPE"]).absolute()
    if name == "map":
        return map_path(load_recipe(recipe_file))
    if name != "report":
        return None
    # That of the last build, unless `bagassets report` has written one since.
    places = (report_path(load_recipe(recipe_file)), recipe_file.with_name("report.html"))
    return max(places, key=lambda file: file.stat().st_mtime_ns if file.is_file() else 0)
