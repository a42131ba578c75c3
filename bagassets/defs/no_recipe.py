"""The code location of a folder that has no recipe yet, as a checkout before `make demo`: a note that says what to do."""

import logging
from collections.abc import Sequence
from pathlib import Path

import dagster as dg

__all__ = ["note_without_recipe"]

_NOTE = "no_recipe_yet"
_LOG = logging.getLogger(__name__)


def note_without_recipe(looked_for: Sequence[Path]) -> dg.Definitions:
    """Return definitions of an asset that nothing makes, whose description is the note; commands show it as a warning.

    Args:
        looked_for: the recipes that are not there, below the current folder.
    """
    sentence = (
        "No recipe yet: run `bagassets init PROJECT --bags FOLDER` and start Dagster in PROJECT; or `bagassets demo` (in a "
        f"checkout, `make demo`), and reload this code location. {Path.cwd()} has no {' or '.join(map(str, looked_for))}."
    )
    _LOG.warning(sentence)
    return dg.Definitions(assets=[dg.AssetSpec(_NOTE, description=sentence)])
