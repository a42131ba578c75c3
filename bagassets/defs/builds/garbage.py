"""What `gc` must keep in a store: all that the Dagster instances and dataset locks of its projects refer to.

Recordings are neither opened nor planned for this. The bag root may be a file server that is not mounted just now, and
then a plan would find no recordings: all artifacts would be garbage.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import dagster as dg

from bagassets.base.errors import DatasetError, RecipeError, StoreError
from bagassets.defs.records.events import DATA_VERSION, Records, all_assets
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.projects import instances_of
from bagassets.formats.dataset_build import dataset_folders
from bagassets.formats.dataset_lock import LOCK, locked_artifacts
from bagassets.propose.project import dagster_home
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Recipe
from bagassets.store.store import Store
from bagassets.store.users import User, forget_user, users_of

KEPT_LOCKS = "kept-locks"
"""Folder in the state folder: copies of locks whose datasets must stay restorable."""


@dataclass
class Roots:
    """The artifacts to keep, and who refers to them.

    Attributes:
        artifacts: their digests.
        locks: dataset locks that were read.
        projects: recipes of the projects whose instances were read.
    """

    artifacts: set[str] = field(default_factory=set)
    locks: list[Path] = field(default_factory=list)
    projects: list[Path] = field(default_factory=list)


def find_roots(
    store: Store, recipe_file: Path, more_locks: tuple[Path, ...] = (), forget: tuple[Path, ...] = ()
) -> Roots:
    """Return the artifacts that the projects of a store need.

    Args:
        store: the store.
        recipe_file: the recipe of a project that counts even if it is not a known user of the store.
        more_locks: further lock files.
        forget: recipe files of projects that no longer exist, and so cannot be reached.

    Raises:
        StoreError: a project cannot be read, so nothing may be removed.
    """
    roots = Roots()
    for user in users_of(store.root):
        if user.recipe in forget or user.has_moved:
            forget_user(store.root, user)
        elif user.is_here or user.recipe != recipe_file:
            _add_user(store, user, roots)
    if recipe_file not in roots.projects:
        _add_project(recipe_file, load_recipe(recipe_file), roots)
    for lock in more_locks:
        _add_lock(lock, roots)
    return roots


def locks_of(recipe: Recipe) -> Iterator[Path]:
    """Yield the locks of all datasets of a recipe, of every version on disk, and the locks in `KEPT_LOCKS`.

    Raises:
        DatasetError: the package of a format in the recipe cannot be used, so nobody knows where its locks are.
    """
    unusable = sorted(recipe.formats.keys() - recipe.dataset_settings.keys())
    if unusable:
        raise DatasetError(
            f"formats.{unusable[0]} in the recipe: the package of this format cannot be used (`bagassets formats` says "
            "why), so the artifacts that its datasets need are unknown, and nothing is collected; repair the package, "
            "or remove the section and copy the locks whose datasets must stay restorable to "
            f"{recipe.state / KEPT_LOCKS}."
        )
    for folder in dict.fromkeys(dataset_folders(recipe).values()):
        yield from sorted(folder.glob(f"*/{LOCK}"))
    yield from sorted((recipe.state / KEPT_LOCKS).glob("**/*.json"))


def recorded_versions(records: Records) -> set[str]:
    """Return the current data versions in an instance, those of users' own assets included.

    Those of removed recordings do not count.
    """
    versions: set[str] = set()
    live, instance, names = records.live(), records.instance, records.names
    storage, kind = instance.event_log_storage, dg.DagsterEventType.ASSET_MATERIALIZATION
    once = storage.get_latest_tags_by_partition(names.key("bag"), kind, [DATA_VERSION])
    removed = once.keys() - live
    for key in storage.all_asset_keys():
        by_partition = storage.get_latest_tags_by_partition(key, kind, [DATA_VERSION])
        ours = names.asset_of(key) in all_assets()
        for partition, tags in by_partition.items():
            if partition in live or not (ours or partition in removed):
                versions.add(tags[DATA_VERSION])
        latest = instance.get_latest_materialization_event(key)
        event = None if latest is None else latest.asset_materialization
        if event is not None and event.partition is None:
            versions.add((event.tags or {}).get(DATA_VERSION, ""))
    return versions


def _add_user(store: Store, user: User, roots: Roots) -> None:
    if not user.recipe.is_file():
        raise _unreachable(user, "it")
    try:
        recipe = load_recipe(user.recipe)
    except RecipeError as err:
        raise StoreError(
            f"{user.recipe}: this project uses the store too, but its recipe is wrong, so nothing was removed; correct it:",
            *str(err).split("\n"),
        ) from err
    is_store = recipe.store_path.resolve() == store.root.resolve()
    # Another machine may have it elsewhere.
    if not is_store and (user.is_here or recipe.store_path != user.store):
        forget_user(store.root, user)  # it has moved to another store
    elif not recipe.state.is_dir():  # elsewhere, or not mounted; a new one has no records
        raise _unreachable(user, f"its state folder {recipe.state}")
    else:
        _add_project(user.recipe, recipe, roots)


def _unreachable(user: User, what: str) -> StoreError:
    where = "" if user.is_here else f" on {user.host}"
    return StoreError(
        f"{user.recipe}: this project{where} uses the store too, but {what} cannot be reached from here, so nothing was removed; "
        f"run gc where it can be reached or, if it no longer exists, pass --forget {user.recipe}."
    )


def _add_project(recipe_file: Path, recipe: Recipe, roots: Roots) -> None:
    roots.projects.append(recipe_file)
    for lock in locks_of(recipe):
        _add_lock(lock, roots)
    places = [(str(dagster_home(recipe_file, recipe)), ()), *instances_of(recipe.state)]
    for place, prefix in places:
        with open_instance(place) as instance:
            roots.artifacts |= recorded_versions(Records(instance, Naming(recipe.name, prefix)))


def _add_lock(lock: Path, roots: Roots) -> None:
    roots.locks.append(lock)
    roots.artifacts |= locked_artifacts(lock)
