"""Opening a Dagster instance, here or in another process, and the variables that it gives to code locations."""

from collections.abc import Mapping
from pathlib import Path

import dagster as dg

from bagassets.defs.dagster_private import InstanceRef, get_env_var_dict
from bagassets.defs.records.connections import pool_connections
from bagassets.defs.records.databases import make_whole, read_settings, storage_folder


def pack_instance(instance: dg.DagsterInstance) -> str:
    """Return text from which another process opens the same instance."""
    return dg.serialize_value(instance.get_ref())


def open_instance(place: str) -> dg.DagsterInstance:
    """Open the instance of a Dagster home folder, or one packed by `pack_instance`."""
    if place.startswith("{"):
        instance = dg.DagsterInstance.from_ref(dg.deserialize_value(place, InstanceRef))
    else:
        home = Path(place)
        if (folder := storage_folder(home)) is not None:
            make_whole(folder)
        instance = dg.DagsterInstance.from_ref(read_settings(home))
    pool_connections(instance)
    return instance


def dotenv_variables(folder: Path) -> dict[str, str]:
    """Return the variables in the `.env` of a folder, read as Dagster reads it."""
    return get_env_var_dict(str(folder))


def location_variables(instance: dg.DagsterInstance, location: str | None) -> Mapping[str, str]:
    """Return the variables that the `secrets` of an instance give a code location: with ours, those of its `.env`."""
    loader = instance.get_ref().secrets_loader  # `inject_env_vars` would set them in this process
    return {} if loader is None else loader.get_secrets_for_environment(location)
