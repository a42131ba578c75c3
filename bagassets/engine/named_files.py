"""Files besides recordings that steps read because the recipe names them."""

import os
from collections.abc import Iterator
from pathlib import Path

from bagassets.recipe.model import Recipe

__all__ = ["file_signature", "named_files"]


def named_files(recipe: Recipe) -> Iterator[Path]:
    """Yield message definitions and URDF files, in order; whatever is there or not."""
    for folder in recipe.bags.message_definitions:
        yield from sorted(folder.rglob("*.msg"))
    for rig in recipe.rigs:
        if rig.urdf is not None:
            yield rig.urdf


def file_signature(path: Path | str) -> tuple[int, ...]:
    """Return what tells whether a file was changed or replaced, without reading it; empty if there is none."""
    try:
        stat = os.stat(path)  # noqa: PTH116  (twice as fast, for thousands)
    except OSError:
        return ()
    return stat.st_size, stat.st_mtime_ns, stat.st_ino, stat.st_ctime_ns
