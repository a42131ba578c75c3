"""Telling in words that a database cannot be used: a full disk, a folder without permission, a server that is down."""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy.exc import OperationalError

from bagassets.errors import StoreError

__all__ = ["database_in_words", "require_writable"]

# What any command writes below Dagster's part of the state folder; somebody else may have made it.
_WRITTEN = ("opening.lock", "history/runs.db", "history/runs/index.db")


@contextmanager
def database_in_words(place: str) -> Iterator[None]:
    """Turn errors of the database into ours.

    Args:
        place: the Dagster home, for the sentence.

    Raises:
        StoreError: the database refused.
    """
    try:
        yield
    except OperationalError as err:
        raise StoreError(
            f"{place}: Dagster's database cannot be used ({err.orig}); free space, or mend the folder or server that "
            "dagster.yaml names. Nothing that is in the store is lost."
        ) from err
    except sqlite3.OperationalError as err:
        # Of a file of our own in the state folder, opened without SQLAlchemy.
        raise StoreError(
            f"{place}: a database of this project cannot be used ({err}); free space, or mend the permissions of its "
            "state folder. Nothing that is in the store is lost."
        ) from err


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
