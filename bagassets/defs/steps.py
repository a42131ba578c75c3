"""Steps of your own: what an ordinary Dagster asset needs to read our artifacts and to publish one.

`docs/steps.md` tells how; `examples/step_plugin` is a worked example.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import dagster as dg

from bagassets.build.execute import AssetResult
from bagassets.defs.events import live_partitions, recorded_states
from bagassets.defs.partitions import recording_partitions
from bagassets.defs.reporting import failures_in_words, result_metadata
from bagassets.defs.workspace import Workspace
from bagassets.errors import StoreError
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Recipe
from bagassets.store.action import Step
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_json

__all__ = ["all_recordings", "channels", "follow_recordings", "per_recording", "publish", "recipe_beside"]

_ACTIVE = [
    dg.DagsterRunStatus.QUEUED,
    dg.DagsterRunStatus.NOT_STARTED,
    dg.DagsterRunStatus.STARTING,
    dg.DagsterRunStatus.STARTED,
    dg.DagsterRunStatus.CANCELING,
]


def recipe_beside(file: str | Path) -> Recipe:
    """Return the recipe in the folder of a file; for `__file__` of a project's own definitions.

    Raises:
        RecipeError: there is none, or it is wrong.
    """
    return load_recipe(Path(file).absolute().with_name("recipe.yaml"))


def per_recording(recipe: Recipe) -> dg.PartitionsDefinition[str]:
    """Return the partitions of our assets, one key per recording, for assets of your own beside them."""
    return recording_partitions(recipe)


def channels(
    context: dg.AssetExecutionContext | dg.AssetCheckExecutionContext, workspace: Workspace, asset: str
) -> dict[str, Artifact]:
    """Return channel -> artifact of `frames` or `sweeps` of the recording that is being materialized.

    Each artifact holds the files and `index.parquet` of one channel.

    Raises:
        StoreError: the asset is not materialized, or an artifact is not in the store.
    """
    listed = workspace.artifact(context, asset).read_json("channels.json")
    return {name: workspace.store.artifact(entry["artifact"]) for name, entry in sorted(listed.items())}


def all_recordings(
    context: dg.AssetExecutionContext | dg.AssetCheckExecutionContext, workspace: Workspace, asset: str
) -> dict[str, Artifact]:
    """Return partition key -> artifact of an asset of every recording that has one now, sorted by key.

    Recordings that were removed, skipped, or not materialized yet are left out.

    Raises:
        StoreError: an artifact is not in the store.
    """
    recorded = recorded_states(context.instance, [asset])[asset]
    live = live_partitions(context.instance, workspace.recipe)
    return {
        key: workspace.store.artifact(recorded[key].data_version) for key in sorted(live & recorded.keys())
    }


def publish(
    context: dg.AssetExecutionContext,
    workspace: Workspace,
    make: Callable[[ArtifactWriter], dict[str, Any]],
    inputs: Mapping[str, Artifact],
    *,
    params: Mapping[str, Any] | None = None,
    libraries: tuple[str, ...] = (),
) -> dg.MaterializeResult[None]:
    """Make the artifact of this asset, unless the store has one that was made of the same.

    The same means: asset key, its `code_version`, `params`, versions of `libraries`, and the
    content of `inputs`. The artifact's digest becomes the asset's data version.

    Args:
        context: of the asset.
        workspace: its resource.
        make: writes files into the artifact, and returns counts and other small facts, which
            become metadata. What it writes must depend on nothing but what is listed here.
        inputs: name -> artifact that `make` reads.
        params: JSON values that shape the result, such as thresholds.
        libraries: installed distributions whose version shapes the result.

    Raises:
        dagster.Failure: an error of bagassets, in words, or the asset has no `code_version`.
    """
    key = context.asset_key
    with failures_in_words():
        version = context.assets_def.code_versions_by_key.get(key)
        if version is None:
            raise StoreError(
                f"{key.to_user_string()}: give this asset a code_version, and raise it when its code changes; without "
                "one an old result would be taken for a new one."
            )
        # The prefix keeps steps of yours apart from ours, whatever they are called.
        step = Step(f"own/{key.to_user_string()}", 1, libraries)
        digests = {name: artifact.digest for name, artifact in inputs.items()}
        action = step.action({"code_version": version, "params": dict(params or {})}, digests)
        outcome = workspace.store.run(action, make)
        result = AssetResult(
            key.to_user_string(), outcome.artifact, outcome.action_digest, outcome.cached, outcome.seconds
        )
        return dg.MaterializeResult(
            data_version=dg.DataVersion(outcome.artifact.digest), metadata=result_metadata(result)
        )


def follow_recordings(asset: str, *, upstream: str, interval_s: int = 30) -> dg.SensorDefinition:
    """Return a sensor that runs an asset of the whole dataset when a recording changed, came or went.

    Automation conditions wait for ever for recordings that are skipped, miss removals, and lose
    what lands between a run and the next tick.

    Args:
        asset: key of an asset without partitions.
        upstream: key of the asset per recording that it reads.
        interval_s: least time between two looks.
    """
    key = dg.AssetKey(asset)

    @dg.sensor(
        name=f"{asset}_follows_recordings",
        target=dg.AssetSelection.assets(key),
        minimum_interval_seconds=interval_s,
        default_status=dg.DefaultSensorStatus.RUNNING,
        description=f"Asks for {asset} whenever {upstream} of a recording changed, came or went.",
    )
    def follow(context: dg.SensorEvaluationContext, workspace: Workspace) -> dg.SensorResult:
        with failures_in_words():
            recorded = recorded_states(context.instance, [upstream])[upstream]
            live = live_partitions(context.instance, workspace.recipe)
        now = digest_json({key: recorded[key].data_version for key in sorted(live & recorded.keys())})
        runs = context.instance.get_runs(dg.RunsFilter(statuses=_ACTIVE))
        busy = any(key in (run.asset_selection or ()) for run in runs)
        if now == context.cursor or busy:
            return dg.SensorResult()
        return dg.SensorResult(run_requests=[dg.RunRequest(asset_selection=[key])], cursor=now)

    return follow
