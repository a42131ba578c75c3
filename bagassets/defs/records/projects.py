"""Which projects a Dagster instance has, and which instances a project has, as runs, sensors and builds have noted it.

Two projects with the same asset keys would take each other's records for their own, so the second one is refused. A
launcher learns from here which recipes the definitions of a code location are made from, and `gc` which instances refer to
the artifacts of a project that is at home in somebody else's Dagster.
"""

import json
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import dagster as dg

from bagassets.base.errors import RecipeError, StoreError
from bagassets.base.files import write_atomically
from bagassets.defs.records.instances import location_variables, pack_instance
from bagassets.defs.records.naming import Naming, parse_prefix
from bagassets.store.canonical import digest_json

_KEY = "bagassets/projects"
_RECIPE, _HOME = "recipe", "home"
_INSTANCES = "instances"
_INSTANCE, _PREFIX = "instance", "prefix"


def note_project(instance: dg.DagsterInstance, prefix: tuple[str, ...], recipe_file: Path) -> Path | None:
    """Note the recipe behind a prefix; return that of another project, if one has the prefix, which then keeps it.

    A project that is gone has none any more. Nor has one whose instance was copied to be this one, as with its folder.
    """
    noted = _noted(instance)
    spelled, recipe_file = "/".join(prefix), recipe_file.absolute()
    value = {_RECIPE: str(recipe_file), _HOME: instance.root_directory}
    found = noted.get(spelled)
    if found == value:
        return None
    if found is not None and found[_HOME] == value[_HOME]:
        other = Path(found[_RECIPE])
        if other.is_file() and not (recipe_file.is_file() and other.samefile(recipe_file)):
            return other
    instance.daemon_cursor_storage.set_cursor_values({_KEY: json.dumps({**noted, spelled: value})})
    return None


def require_own_keys(instance: dg.DagsterInstance, prefix: tuple[str, ...], recipe_file: Path) -> None:
    """Note a project, and refuse it if another one has the same asset keys.

    Raises:
        RecipeError: there is another.
    """
    other = note_project(instance, prefix, recipe_file)
    if other is not None:
        keys = f"key_prefix {'/'.join(prefix)!r}" if prefix else "no key_prefix"
        raise RecipeError(
            f"{recipe_file}: the project of {other} has the same asset keys ({keys}) in this Dagster instance, and each "
            "would take the records of the other for its own; keep each recipe in a folder of its own, name another "
            "`state` and other outputs in one of them or, in a Dagster of yours, another prefix: build_definitions(recipe, key_prefix=…)."
        )


def noted_prefix(instance: dg.DagsterInstance, recipe_file: Path) -> tuple[str, ...]:
    """Return the prefix below which an instance knows the project of a recipe; empty if it knows it without one."""
    recipe = recipe_file.resolve()
    prefixes = {key for key, value in _noted(instance).items() if Path(value[_RECIPE]).resolve() == recipe}
    return parse_prefix(min(prefixes, default=""))


def forget_other_prefixes(instance: dg.DagsterInstance, prefix: tuple[str, ...], recipe_file: Path) -> None:
    """Forget that a project had another prefix, or none: what has been recorded there is of the past."""
    noted, spelled = _noted(instance), "/".join(prefix)
    kept = {
        key: value
        for key, value in noted.items()
        if key == spelled or Path(value[_RECIPE]).resolve() != recipe_file.resolve()
    }
    if kept != noted:
        instance.daemon_cursor_storage.set_cursor_values({_KEY: json.dumps(kept)})


def recipes_of(instance: dg.DagsterInstance) -> list[Path]:
    """Return the recipes of the projects that are noted and exist, in order."""
    files = {Path(value[_RECIPE]) for value in _noted(instance).values()}
    return sorted(file for file in files if file.is_file())


def configured_recipe(named: str | None) -> Path | None:
    """Return the recipe that a launcher's configuration or the environment names, or that of this folder, if there is one."""
    named = named or os.environ.get("BAGASSETS_RECIPE")
    if named:
        return Path(named)
    here = Path("recipe.yaml")
    return here if here.is_file() else None


def recipe_of_location(instance: dg.DagsterInstance, run: dg.DagsterRun) -> Path | None:
    """Return the recipe that the `.env` of a run's code location names; None if it names none."""
    location = run.remote_job_origin.location_name if run.remote_job_origin is not None else None
    named = location_variables(instance, location).get("BAGASSETS_RECIPE")
    return Path(named).absolute() if named else None


def recipe_of_assets(instance: dg.DagsterInstance, run: dg.DagsterRun) -> Path | None:
    """Return the recipe of the project whose assets a run makes; None if none is noted, or it is gone."""
    for spelled, value in _noted(instance).items():
        names = Naming("", parse_prefix(spelled))
        makes = any(names.asset_of(key) is not None for key in run.asset_selection or ())
        if makes or run.job_name in {names.batch_job, names.assets_job}:
            file = Path(value[_RECIPE])
            return file if file.is_file() else None
    return None


def _noted(instance: dg.DagsterInstance) -> dict[str, dict[str, str]]:
    """Return prefix -> recipe and instance."""
    text = instance.daemon_cursor_storage.get_cursor_values({_KEY}).get(_KEY)
    return json.loads(text) if text else {}


def note_instance(instance: dg.DagsterInstance, state: Path, prefix: tuple[str, ...]) -> None:
    """Note in the state folder of a project that another instance than its own has records of it.

    `gc` must not remove what that one refers to.
    """
    if instance.is_ephemeral or (not prefix and Path(instance.root_directory) == state / "dagster"):
        return
    value = {_INSTANCE: pack_instance(instance), _PREFIX: list(prefix)}
    file = state / _INSTANCES / f"{digest_json(value)[:32]}.json"
    if file.exists():
        return
    with suppress(OSError):  # the state folder is on another machine, or read-only
        # It may hold the password of a database.
        write_atomically(file, json.dumps(value, sort_keys=True).encode(), mode=0o600, folders=True)


def instances_of(state: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the instances noted in a state folder, packed, and the prefix that the project has in each.

    Raises:
        StoreError: a note cannot be read.
    """
    for file in sorted((state / _INSTANCES).glob("*.json")):
        try:
            value = json.loads(file.read_bytes())
            yield str(value[_INSTANCE]), tuple(value[_PREFIX])
        except (OSError, ValueError, KeyError, TypeError) as err:
            raise StoreError(
                f"{file}: this note of a Dagster instance that has records of the project cannot be read ({err}), so nothing "
                "was removed; remove it, and materialize an asset of the project there once, which writes it again."
            ) from err
