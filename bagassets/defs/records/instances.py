"""Opening a Dagster instance, here or in another process, and the variables that it gives to code locations.

With PostgreSQL each connection is a process of the server: so a few are kept, as Dagster's web server does, and each is
tried before it is used again, since the server may have been restarted. For SQLite see `sqlite_storage`.
"""

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import dagster as dg
from sqlalchemy import event
from sqlalchemy.exc import DisconnectionError
from sqlalchemy.pool import Pool

from bagassets.defs.dagster_private import InstanceRef, get_env_var_dict
from bagassets.defs.records.databases import (
    database_errors_explained,
    make_whole,
    read_settings,
    storage_folder,
)
from bagassets.defs.records.events import event_database

_NO_TIMEOUT = 0
_RECYCLE_S = 1800
_MORE_CONNECTIONS = 20  # for a moment, beside the one of each storage that is kept


def pack_instance(instance: dg.DagsterInstance) -> str:
    """Return text from which another process opens the same instance."""
    return dg.serialize_value(instance.get_ref())


@contextmanager
def open_instance(place: str) -> Iterator[dg.DagsterInstance]:
    """Open the instance of a Dagster home folder, or one packed by `pack_instance`.

    Raises:
        StoreError: its database cannot be used, at once or in the block.
    """
    is_packed = place.startswith("{")
    with database_errors_explained("this instance" if is_packed else place):
        if is_packed:
            settings = dg.deserialize_value(place, InstanceRef)
        else:
            home = Path(place)
            if (folder := storage_folder(home)) is not None:
                make_whole(folder)
            settings = read_settings(home)
        with dg.DagsterInstance.from_ref(settings) as instance:
            if event_database(instance) is None:
                _try_before_use()
                instance.optimize_for_webserver(_NO_TIMEOUT, _RECYCLE_S, _MORE_CONNECTIONS)
            yield instance


@cache
def _try_before_use() -> None:
    """Let all connections to PostgreSQL that this process takes from a pool be tried first."""
    event.listen(Pool, "checkout", _try)


def _try(connection: Any, _record: object, _proxy: object) -> None:
    if isinstance(connection, sqlite3.Connection):
        return
    try:
        with closing(connection.cursor()) as cursor:
            cursor.execute("SELECT 1")
    except Exception as err:  # of whatever driver: the pool opens another connection
        raise DisconnectionError from err


def dotenv_variables(folder: Path) -> dict[str, str]:
    """Return the variables in the `.env` of a folder, read as Dagster reads it."""
    return get_env_var_dict(str(folder))


def location_variables(instance: dg.DagsterInstance, location: str | None) -> Mapping[str, str]:
    """Return the variables that the `secrets` of an instance give a code location: with ours, those of its `.env`."""
    loader = instance.get_ref().secrets_loader  # `inject_env_vars` would set them in this process
    return {} if loader is None else loader.get_secrets_for_environment(location)
