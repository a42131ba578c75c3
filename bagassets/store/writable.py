"""Whether the state folder of a project can be written."""

import os
from pathlib import Path

from bagassets.base.errors import StoreError

# Files that every command writes in Dagster's part of the state folder; they may belong to another user.
_WRITTEN = ("opening.lock", "history/runs.db", "history/runs/index.db")


def nearest_existing(path: Path) -> Path:
    """Return a path, or the nearest folder above it that exists: where it would be created."""
    return next(one for one in (path, *path.parents) if one.exists())


def require_writable(state: Path) -> None:
    """Check that the state folder can be written: even commands that only read keep databases and locks there.

    Raises:
        StoreError: the state folder, or the folder in which it would be created, cannot be written.
    """
    for path in (state, *(state / "dagster" / name for name in _WRITTEN)):
        existing = nearest_existing(path)
        if not os.access(existing, os.W_OK | (os.X_OK if existing.is_dir() else 0)):
            raise StoreError(
                f"{state}: this state folder cannot be written ({existing} is read-only for this user); fix its permissions, "
                "or set `state` in the recipe to a folder that can be written."
            )
