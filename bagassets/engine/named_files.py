"""Files besides recordings that steps read because the recipe names them, or where they lie beside one."""

import os
from collections.abc import Iterator
from pathlib import Path

from bagassets.annotations.files.find import label_paths
from bagassets.bags.model import Found
from bagassets.recipe.model import Recipe
from bagassets.steps.selection import choose_rig

__all__ = ["file_signature", "files_beside", "named_files"]


def named_files(recipe: Recipe) -> Iterator[Path]:
    """Yield message definitions and URDF files, in order; whatever is there or not."""
    for folder in recipe.bags.message_definitions:
        yield from sorted(folder.rglob("*.msg"))
    for rig in recipe.rigs:
        if rig.urdf is not None:
            yield rig.urdf


def files_beside(recipe: Recipe, found: Found) -> list[Path]:
    """Return the label files of a recording and the places where they might be; whatever is there or not."""
    if not any(rig.annotation_files for rig in recipe.rigs):
        return []
    rig = choose_rig(recipe, found.relative)
    return [] if rig is None else label_paths(rig, found)


def file_signature(path: Path | str) -> tuple[int, ...]:
    """Return what tells whether a file was changed or replaced, without reading it; empty if there is none."""
    try:
        stat = os.stat(path)  # noqa: PTH116  (twice as fast, for thousands)
    except OSError:
        return ()
    return stat.st_size, stat.st_mtime_ns, stat.st_ino, stat.st_ctime_ns
