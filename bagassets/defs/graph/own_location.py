"""The code locations that a project's `workspace.yaml` names besides ours, with the assets of its users.

They are imported into this process, as Dagster imports them into a code server.
"""

import os
import sys
import sysconfig
from collections.abc import Iterator, Mapping
from contextlib import chdir, contextmanager
from dataclasses import replace
from pathlib import Path

import dagster as dg

from bagassets.base.errors import RecipeError, kind_and_text
from bagassets.base.fingerprints import contents_fingerprint, site_folders
from bagassets.defs.dagster_private import (
    ManagedGrpcPythonEnvCodeLocationOrigin,
    loadable_targets_from_python_module,
    location_origins_from_yaml_paths,
    recon_repository_from_origin,
)
from bagassets.defs.graph.sensor import KEY_PREFIX, RECIPE
from bagassets.defs.records.instances import dotenv_variables
from bagassets.defs.records.naming import parse_prefix
from bagassets.defs.runs.execution import CodeLocation

_OURS = CodeLocation().module
_WORKSPACE = "workspace.yaml"
_PACKAGE = str(Path(__file__).resolve().parents[2])
# Names of imported modules that are ours, Python's, or those of an installed package.
_INSTALLED: set[str] = set()


Locations = Mapping[CodeLocation, dg.RepositoryDefinition]
"""Code location of the user's, as `workspace.yaml` names it -> what it defines."""


def load_locations(home: Path) -> Locations:
    """Import the user's code locations; none if only ours is named.

    Locations of other interpreters and of servers are left out, as nothing of them can be imported here.

    Raises:
        RecipeError: `workspace.yaml` is wrong, or a module cannot be imported.
    """
    file = home / _WORKSPACE
    loaded = {}
    for named in _named(file):
        try:
            with chdir(home), _variables_of(home):  # as where Dagster is started
                location = named
                if not named.attribute:
                    (target,) = loadable_targets_from_python_module(named.module, named.working_directory)
                    location = replace(named, attribute=target.attribute)
                repository = recon_repository_from_origin(location.python_origin())
                loaded[location] = repository.get_definition()
        except (Exception, SystemExit) as err:
            raise RecipeError(
                f"{file}: {named.module} cannot be loaded ({kind_and_text(err)}), so nothing of yours is brought up to date; "
                f"`dagster definitions validate -m {named.module}` in {home} shows where."
            ) from err
    return loaded


@contextmanager
def _variables_of(home: Path) -> Iterator[None]:
    """Set the variables in the `.env` of a project, as Dagster does for its code locations."""
    given = {name: value for name, value in dotenv_variables(home).items() if name not in os.environ}
    os.environ.update(given)
    try:
        yield
    finally:
        for name in given:
            os.environ.pop(name, None)


def home_of(home: Path, recipe_file: Path, locations: Locations) -> tuple[tuple[str, ...], CodeLocation]:
    """Return the key prefix of a project, and the code location that defines it: ours, unless it has a prefix.

    A project that is defined without a prefix as well has none.
    """
    found: dict[tuple[str, ...], CodeLocation] = {}
    for location, repository in locations.items():
        for sensor in repository.sensor_defs:
            recipe, prefix = sensor.metadata.get(RECIPE), sensor.metadata.get(KEY_PREFIX)
            if recipe is not None and Path(str(recipe.value)).resolve() == recipe_file.resolve():
                found[parse_prefix(str(prefix.value) if prefix is not None else "")] = location
    if not found or () in found:
        return (), CodeLocation()
    if any(origin.loadable_target_origin.module_name == _OURS for origin in _origins(home / _WORKSPACE)):
        return (), CodeLocation()
    return min(found.items(), key=lambda one: one[0])


def _origins(file: Path) -> list[ManagedGrpcPythonEnvCodeLocationOrigin]:
    """Return the code locations in a workspace but for those of servers."""
    if not file.is_file():
        return []
    try:
        found = location_origins_from_yaml_paths([str(file)])
    except Exception as err:
        problem = str(err).strip().splitlines()
        raise RecipeError(
            f"{file}: this cannot be read as a workspace of Dagster ({problem[0] if problem else err!r})."
        ) from err
    return [origin for origin in found if isinstance(origin, ManagedGrpcPythonEnvCodeLocationOrigin)]


def _named(file: Path) -> Iterator[CodeLocation]:
    for origin in _origins(file):
        target = origin.loadable_target_origin
        if target.executable_path not in {None, sys.executable} or target.module_name == _OURS:
            continue
        folder = file.parent / (target.working_directory or "")
        module = target.module_name or target.package_name
        if target.python_file is not None:
            module, folder = Path(target.python_file).stem, (file.parent / target.python_file).parent
        if module is not None:
            yield CodeLocation(module, target.attribute or "", origin.location_name, str(folder.resolve()))


def files_of(home: Path) -> tuple[str, ...]:
    """Return the files that say what the user's code locations define, whether they are there or not."""
    return (str(home / _WORKSPACE), str(home / ".env"), *_modules())


def _modules() -> list[str]:
    """Return the imported files that belong neither to us, nor to Python, nor to an installed package."""
    foreign = tuple(
        f"{folder}/"
        for folder in (_PACKAGE, *site_folders(), *map(sysconfig.get_path, ("stdlib", "platstdlib")))
    )
    own = set()
    for name in sys.modules.keys() - _INSTALLED:
        file = getattr(sys.modules.get(name), "__file__", None) or ""
        # There are thousands, and to resolve a path takes as long as reading a small file.
        if file.endswith(".py") and not file.startswith(foreign):
            path = Path(file)
            if not str(path.resolve()).startswith(foreign):
                own.add(str(path.absolute()))
                continue
        _INSTALLED.add(name)
    return sorted(own)


def know_installed_modules() -> None:
    """Look at the imported modules once, before the process is forked: each look copies memory that is shared until then."""
    _modules()


def code_digest() -> str:
    """Return a digest of the user's modules."""
    return contents_fingerprint(_modules())[:16]
