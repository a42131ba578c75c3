"""Where the code of an asset is, for "View code" in the web UI."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import dagster as dg

__all__ = ["code_link"]

_PACKAGE = Path(__file__).resolve().parent.parent


def code_link(make: Callable[..., object]) -> dict[str, Any]:
    """Return the metadata that names the function which decides what an asset is, or makes it."""
    code = getattr(make, "__code__", None)
    if code is None:  # made by `functools.partial`, or not written in Python
        return {}
    file = Path(code.co_filename)
    label = f"{_PACKAGE.name}/{file.relative_to(_PACKAGE)}" if file.is_relative_to(_PACKAGE) else file.name
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", category=dg.BetaWarning)
        reference = dg.LocalFileCodeReference(
            file_path=str(file), line_number=code.co_firstlineno, label=label
        )
        return {"dagster/code_references": dg.CodeReferencesMetadataValue(code_references=[reference])}
