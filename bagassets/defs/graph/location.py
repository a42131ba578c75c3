"""The code location of a recipe: all assets, checks, sensors and resources."""

import logging
import os
import warnings
from collections.abc import Sequence
from pathlib import Path

import dagster as dg

from bagassets.base.lock_files import RUN_LOCKS
from bagassets.defs.graph.assets import recording_definitions
from bagassets.defs.graph.checks import dataset_checks, recording_checks
from bagassets.defs.graph.dataset import dataset_assets
from bagassets.defs.graph.sensor import recordings_sensor
from bagassets.defs.graph.several import batch_job
from bagassets.defs.records.naming import Naming, checked_prefix
from bagassets.defs.records.partitions import range_policy
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.exclusive import RecordingLock
from bagassets.defs.runs.launching import executes_here
from bagassets.engine.batches import MOST_RECORDINGS
from bagassets.propose.project import dagster_home
from bagassets.recipe import load_recipe


def build_definitions(
    recipe_file: Path,
    *,
    key_prefix: str | Sequence[str] | None = None,
    group_name: str | None = None,
    resource_key: str | None = None,
    in_process: bool | None = None,
) -> dg.Definitions:
    """Return the assets, checks and sensor of a recipe.

    Merge them with your own: `Definitions.merge(build_definitions(file), Definitions(assets=[…]))`.

    Args:
        recipe_file: the recipe.
        key_prefix: stands before the name of each asset in its key, and tells this project from others in the same code
            location and instance.
        group_name: group of all assets; default: `recording` and `dataset`, below the prefix.
        resource_key: of the `Workspace`, which your own assets ask for; default: `workspace`, below the prefix
            (`north__workspace`).
        in_process: the definitions name `in_process_executor`, so that a click on *Materialize* is one process, too, as
            our jobs always are; default: only without a prefix. A code location has one executor, and beside assets of
            others it is theirs to choose.

    Raises:
        RecipeError: the recipe is missing or wrong, or the prefix.
    """
    if os.environ.get("DAGSTER_IS_DEV_CLI"):  # in a code server of `bagassets ui` or `dagster dev`
        # Keep Dagster's messages to its own handlers, which respect the log level that was asked for. Evaluating a sensor
        # sets the level of Dagster's logger to DEBUG. That shows once the root logger has a handler, and it gets one when
        # anything calls `logging.info` itself, as Dagster's storage does.
        logging.getLogger("dagster").propagate = False
    recipe_file = recipe_file.absolute()
    recipe = load_recipe(recipe_file)
    names = Naming(recipe.name, checked_prefix(key_prefix), group_name, resource_key)
    in_process = not names.prefix if in_process is None else in_process
    with warnings.catch_warnings():
        # Partitioned checks are a preview feature, but without partitions one recording's pass would hide another's
        # failure.
        warnings.simplefilter("ignore", category=dg.PreviewWarning)
        checks = [*recording_checks(recipe, names), *dataset_checks(recipe, names)]
    # Where a sensor has a job, Dagster copies the sensor with a parameter of its own that it calls beta.
    warnings.filterwarnings("ignore", "Parameter `owners` of initializer `SensorDefinition", dg.BetaWarning)
    # Where a run has one process, or a queue packs runs, each recording is better off with a run of its own.
    shares_runs = executes_here(lambda: os.environ.get("DAGSTER_HOME") or dagster_home(recipe_file, recipe))
    of_range, shared = range_policy(), dg.BackfillPolicy.multi_run(MOST_RECORDINGS) if shares_runs else None
    assets = [
        *recording_definitions(recipe, names, of_range or shared),
        *dataset_assets(recipe, names, of_range),
    ]
    batches = batch_job(names)
    return dg.Definitions(
        assets=assets,
        asset_checks=checks,
        jobs=[batches],
        sensors=[recordings_sensor(recipe_file, names, assets, batches)],
        resources={
            names.workspace: Workspace(recipe_file=str(recipe_file), key_prefix=list(names.prefix)),
            names.lock: RecordingLock(folder=str(recipe.state / RUN_LOCKS)),
        },
        executor=dg.in_process_executor if in_process else None,
    )


def note_without_recipe(looked_for: Sequence[Path]) -> dg.Definitions:
    """Return an asset that nothing makes, whose description says what to do; commands show that as a warning.

    Args:
        looked_for: the recipes that are not there, below the current folder.
    """
    sentence = (
        "No recipe yet: run `bagassets init PROJECT --bags FOLDER` and start Dagster in PROJECT; or `bagassets demo` (in a "
        f"checkout, `make demo`), and reload this code location. {Path.cwd()} has no {' or '.join(map(str, looked_for))}."
    )
    logging.getLogger(__name__).warning(sentence)
    return dg.Definitions(assets=[dg.AssetSpec("no_recipe_yet", description=sentence)])
