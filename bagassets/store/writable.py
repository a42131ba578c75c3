"""Whether the state folder of a project can be written."""

import os
from pathlib import Path

from bagassets.errors import StoreError

__all__ = ["require_writable"]

# What any command writes below Dagster's part of the state folder; somebody else may have made it.
_WRITTEN = ("opening.lock", "history/runs.db", "history/runs/index.db")


def require_writable(state: Path) -> None:
    """Refuse a state folder that cannot be written: even a look keeps its databases and locks there.

    Raises:
        StoreError: it, or the folder that it is to be made in, cannot be written.
    """
    for path in (state, *(state / "dagster" / name for name in _WRITTEN)):
        there = next(one for one in (path, *path.parents) if one.exists())
        if not os.access(there, os.W_OK | (os.X_OK if there.is_dir() else 0)):
            raise StoreError(
                f"{state}: this state folder cannot be written ({there} is read-only for this user); mend its permissions, "
                "or set `state` in the recipe to a folder that can be written."
            )
