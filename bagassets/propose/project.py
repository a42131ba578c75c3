"""A project folder: the recipe, and what makes Dagster find it and keep its state.

Dagster reads `dagster.yaml` from DAGSTER_HOME or, if that is unset, from the current folder, and in
the latter case it would keep its storage in a temporary folder that is deleted on exit. So that
no way of starting it loses registered recordings, every storage in `dagster.yaml` is an absolute
path, and `.env` sets DAGSTER_HOME for commands started in the project folder.
"""

import json
import os
import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from bagassets.base.disk_errors import disk_advice
from bagassets.base.errors import RecipeError
from bagassets.base.files import make_folder, write_atomically
from bagassets.recipe.model import Recipe

FILES = ("recipe.yaml", "dagster.yaml", "workspace.yaml", ".env")
"""What every project folder holds."""

_DAGSTER_YAML = """\
# The Dagster instance of this project, written by `bagassets init`. Its state lives in one folder:
#   {state}
# Paths are absolute, since Dagster takes relative ones from wherever it is started. After moving the
# project, run `bagassets init PROJECT` again: it keeps recipe.yaml and rewrites the rest.
storage:
  # Dagster's SQLite storage, but with the events of all runs in one file, which takes half of the room.
  custom:
    module: bagassets.defs.sqlite_storage
    class: ProjectStorage
    config:
      base_dir: {storage}
local_artifact_storage:
  module: dagster._core.storage.root
  class: LocalArtifactStorage
  config:
    base_dir: {storage}
compute_logs:
  module: dagster._core.storage.local_compute_log_manager
  class: LocalComputeLogManager
  config:
    base_dir: {logs}

# Gives code locations the variables in .env, whichever folder Dagster is started in.
secrets:
  custom:
    module: dagster._core.secrets.env_file
    class: PerProjectEnvFileLoader
    config:
      location_paths:
        bagassets.definitions: {project}

# Runs start at once instead of after seconds: they are forked from a process that has imported everything.
run_launcher:
  module: bagassets.defs.launcher
  class: BagAssetsRunLauncher
  config:
    recipe: {recipe}
    state_folder: {state}
run_coordinator:
  module: dagster._core.run_coordinator
  class: QueuedRunCoordinator
  config:
    dequeue_interval_seconds: 1
    # As many as this machine had processors; each run needs one, and some memory.
    max_concurrent_runs: {runs}
    tag_concurrency_limits:
      - key: dagster/partition
        value:
          applyLimitPerUniqueValue: true
        limit: 1
# Notices runs whose machine or container died. A run that waits for its turn counts as starting.
run_monitoring:
  enabled: true
  start_timeout_seconds: 86400

# The sensor looks every five seconds; looks that found nothing to do are not kept for long.
retention:
  sensor:
    purge_after_days:
      skipped: 1
      failure: 30
      success: -1

telemetry:
  enabled: false
nux:
  enabled: false
"""

_WORKSPACE_YAML = """\
# What Dagster loads: the assets of the recipe that BAGASSETS_RECIPE names (see .env).
# Code locations with steps of your own are further entries of this list.
load_from:
  - python_module: bagassets.definitions
"""

_ENV = """\
# Read by every dagster command that is started in this folder.
DAGSTER_HOME={project}
BAGASSETS_RECIPE={recipe}
"""


_DEFINITIONS_PY = '''\
"""What `dg dev`, `dg list defs` and `dg launch` load.

`pip install 'bagassets[dg]'` brings `dg`. Assets of your own can be merged in here;
have workspace.yaml name this module then, so that `bagassets` and `dagster` load them,
too.
"""

from pathlib import Path

from bagassets.defs import build_definitions

defs = build_definitions(Path(__file__).with_name("recipe.yaml"))
'''

_PYPROJECT_TOML = """\
# Makes this folder a project of `dg`, Dagster's command line, which `pip install 'bagassets[dg]'` brings.
[tool.dg]
directory_type = "project"

[tool.dg.project]
root_module = "definitions"
defs_module = "definitions"
code_location_target_module = "definitions"
# The name that dagster.yaml knows this location by.
code_location_name = "bagassets.definitions"
"""

# Where the files of a project name its recipe, as they are written here; of what people write, nothing is concluded.
_NAMED_RECIPE = {
    ".env": re.compile(r"^BAGASSETS_RECIPE='?([^'\"#\n]+?)'?$", re.MULTILINE),
    "dagster.yaml": re.compile(r'^ +recipe: ("(?:[^"\\]|\\["\\/bfnrtu])*")$', re.MULTILINE),
}
_FOR_DG = {"definitions.py": _DEFINITIONS_PY, "pyproject.toml": _PYPROJECT_TOML}


def dagster_files(project: Path, state: Path, recipe: Path | None = None) -> dict[str, str]:
    """Return file name -> content of everything in a project folder but the recipe.

    Args:
        project: the project folder.
        state: the recipe's state folder; Dagster's part of it is `dagster` below.
        recipe: the recipe file; default `recipe.yaml` in the project.
    """
    project = project.absolute()
    storage = state.absolute() / "dagster"
    recipe = project / "recipe.yaml" if recipe is None else recipe.absolute()
    # JSON strings are YAML strings, whatever a path holds.
    dagster_yaml = _DAGSTER_YAML.format(
        state=json.dumps(str(state.absolute())),
        storage=json.dumps(str(storage)),
        logs=json.dumps(str(storage / "compute_logs")),
        project=json.dumps(str(project)),
        recipe=json.dumps(str(recipe)),
        runs=os.cpu_count() or 1,
    )
    env = _ENV.format(project=_env_value(str(project)), recipe=_env_value(str(recipe)))
    return {"dagster.yaml": dagster_yaml, "workspace.yaml": _WORKSPACE_YAML, ".env": env}


def write_project(
    project: Path,
    recipe_text: str | None,
    state: Path | None = None,
    more: Mapping[str, str] = MappingProxyType({}),
) -> list[str]:
    """Write the files of a project, replacing those that are there; return their names.

    Those for `dg` are written only if neither is there, as they may be the user's own.

    Args:
        project: the project folder; made if missing.
        recipe_text: content of `recipe.yaml`; None leaves the recipe and an existing `workspace.yaml` alone.
        state: the recipe's state folder; default `.bagassets` in the project.
        more: name -> content of files that the recipe expects beside it.

    Raises:
        RecipeError: the folder cannot be written, or its path is one that no `.env` can hold.
    """
    state = project / Recipe.model_fields["state"].default if state is None else state
    files = {**dagster_files(project, state), **more}
    if recipe_text is not None:
        files["recipe.yaml"] = recipe_text
    elif (project / "workspace.yaml").is_file():
        del files["workspace.yaml"]  # it names no path of ours, and may name steps of the user's
    if not any((project / name).exists() for name in _FOR_DG):
        files |= _FOR_DG
    try:
        # Dagster refuses a log folder that does not exist.
        make_folder(state / "dagster")
        for name, text in files.items():
            write_atomically(project / name, text.encode(), folders=True)
    except OSError as err:
        raise RecipeError(
            f"{project}: the project cannot be written ({err.strerror or err}); {disk_advice(err)}."
        ) from err
    return [name for name in (*FILES, *more, *_FOR_DG) if name in files]


def dagster_home(recipe_file: Path, recipe: Recipe) -> Path:
    """Return the Dagster home of a recipe: its project folder, else one below its state.

    The latter is made if need be, with the `dagster.yaml` that a project has.

    Raises:
        RecipeError: the project is made for another recipe, or the state folder cannot be written.
    """
    recipe_file = recipe_file.absolute()
    project = recipe_file.parent
    if (project / "dagster.yaml").is_file():
        _refuse_other_recipe(recipe_file)
        return project
    home = recipe.dagster_home
    config = home / "dagster.yaml"
    if not config.is_file():
        text = dagster_files(project, recipe.state, recipe_file)[config.name]
        try:
            write_atomically(config, text.encode(), folders=True)
        except OSError as err:
            raise RecipeError(
                f"{home}: the Dagster home cannot be made ({err.strerror or err}); {disk_advice(err)}: `state` in the recipe names it."
            ) from err
    return home


def _refuse_other_recipe(recipe_file: Path) -> None:
    """Raise if the files beside a recipe name another, whose state Dagster's processes would take."""
    project = recipe_file.parent
    for name, pattern in _NAMED_RECIPE.items():
        file = project / name
        for found in pattern.finditer(file.read_text("utf-8")) if file.is_file() else ():
            named = project / (json.loads(found[1]) if found[1].startswith('"') else found[1])
            if named.exists() and named.samefile(recipe_file):
                continue
            if named.exists() and named.parent.samefile(project):
                raise RecipeError(
                    f"{recipe_file}: this project is made for {named.name} (its {name} says so); keep each recipe in a "
                    "folder of its own."
                )
            raise RecipeError(
                f"{file}: it names {named}, so this project was moved or copied from there. Run `bagassets init "
                f"{shlex.quote(str(project))}`: it keeps recipe.yaml and has the rest name this folder."
            )


def _env_value(path: str) -> str:
    if any(character in path for character in "'\n\r") or "${" in path:
        raise RecipeError(
            f"{path}: a .env file cannot hold this path; choose a project folder without quotes, line breaks and `${{`."
        )
    return f"'{path}'"
