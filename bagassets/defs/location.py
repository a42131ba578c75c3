"""The code location of a recipe: all assets, checks, sensors and resources."""

import logging
import os
import warnings
from pathlib import Path

import dagster as dg

from bagassets.defs.assets import recording_definitions
from bagassets.defs.batch_job import batch_job
from bagassets.defs.checks import dataset_checks, recording_checks
from bagassets.defs.dataset import dataset_assets
from bagassets.defs.exclusive import RecordingLock
from bagassets.defs.sensor import recordings_sensor
from bagassets.defs.workspace import Workspace
from bagassets.lock_files import RUN_LOCKS
from bagassets.recipe import load_recipe

__all__ = ["build_definitions"]


def build_definitions(recipe_file: Path) -> dg.Definitions:
    """Return the assets, checks and sensor of a recipe.

    Merge them with your own: `Definitions.merge(build_definitions(file), Definitions(assets=[…]))`.

    Raises:
        RecipeError: the recipe is missing or wrong.
    """
    if os.environ.get("DAGSTER_IS_DEV_CLI"):  # in a code server of `bagassets ui` or `dagster dev`
        _keep_log_level()
    recipe_file = recipe_file.absolute()
    recipe = load_recipe(recipe_file)
    with warnings.catch_warnings():
        # Partitioned checks are a preview feature, but without partitions one recording's pass would hide another's
        # failure.
        warnings.simplefilter("ignore", category=dg.PreviewWarning)
        checks = [*recording_checks(recipe), *dataset_checks(recipe)]
    # Where a sensor has a job, Dagster copies the sensor with a parameter of its own that it calls beta.
    warnings.filterwarnings("ignore", "Parameter `owners` of initializer `SensorDefinition", dg.BetaWarning)
    batches = batch_job()
    return dg.Definitions(
        assets=[*recording_definitions(recipe), *dataset_assets(recipe)],
        asset_checks=checks,
        jobs=[batches],
        sensors=[recordings_sensor(batches)],
        resources={
            "workspace": Workspace(recipe_file=str(recipe_file)),
            "recording_lock": RecordingLock(folder=str(recipe.state / RUN_LOCKS)),
        },
        # A run is one process, whatever launched it: our workers are forked from a server.
        executor=dg.in_process_executor,
    )


def _keep_log_level() -> None:
    """Keep Dagster's messages to its own handlers, which respect the log level that was asked for.

    Evaluating a sensor sets the level of Dagster's logger to DEBUG. That shows once the root logger has a handler, and
    it gets one when anything calls `logging.info` itself, as Dagster's storage does.
    """
    logging.getLogger("dagster").propagate = False
