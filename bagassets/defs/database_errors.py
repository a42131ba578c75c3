"""Telling in words that a database cannot be used: a full disk, a folder without permission, a server that is down."""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.exc import OperationalError

from bagassets.errors import StoreError

__all__ = ["database_in_words"]


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
