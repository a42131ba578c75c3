"""Steps of your own: what an ordinary Dagster asset needs to read our artifacts and to publish one.

See `docs/steps.md`; `examples/step_plugin` is a complete example.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import dagster as dg

from bagassets.assets.face import Face
from bagassets.base.errors import StoreError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.defs.graph.own_assets import FOLLOWS, sensor_tags
from bagassets.defs.records.events import Records
from bagassets.defs.records.naming import AssetName, Naming, checked_prefix
from bagassets.defs.records.partitions import ACTIVE, recording_partitions
from bagassets.defs.records.reporting import errors_explained, result_metadata, skip_metadata
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.execute import AssetResult
from bagassets.engine.run_action import run_action
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Recipe
from bagassets.store.action import Step
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_json


def recipe_beside(file: str | Path) -> Recipe:
    """Return the recipe in the folder of a file; pass `__file__` in the definitions of a project.

    Raises:
        RecipeError: there is none, or it is wrong.
    """
    return load_recipe(Path(file).absolute().with_name("recipe.yaml"))


def per_recording(
    recipe: Recipe, *, key_prefix: str | Sequence[str] | None = None
) -> dg.PartitionsDefinition[str]:
    """Return the partitions of our assets, one key per recording, for your own assets.

    Args:
        recipe: the project.
        key_prefix: as given to `build_definitions`.
    """
    return recording_partitions(recipe.bags, Naming(recipe.name, checked_prefix(key_prefix)))


def channels(
    context: dg.AssetExecutionContext | dg.AssetCheckExecutionContext, workspace: Workspace, asset: AssetName
) -> dict[str, Artifact]:
    """Return channel -> artifact of `frames` or `sweeps`, for the recording that is being materialized.

    Each artifact holds the files and `index.parquet` of one channel.

    Raises:
        StoreError: the asset is not materialized, or an artifact is not in the store.
    """
    listed = workspace.artifact(context, asset).read_json("channels.json")
    return {name: workspace.store.artifact(entry["artifact"]) for name, entry in sorted(listed.items())}


def all_recordings(
    context: dg.AssetExecutionContext | dg.AssetCheckExecutionContext, workspace: Workspace, asset: AssetName
) -> dict[str, Artifact]:
    """Return partition key -> current artifact of an asset, sorted by key.

    Recordings that were removed, are skipped or have not been materialized are left out.

    Raises:
        StoreError: an artifact is not in the store.
    """
    versions = _versions(workspace.on(context.instance).records, asset)
    return {key: workspace.store.artifact(version) for key, version in versions.items()}


def _versions(records: Records, asset: AssetName) -> dict[str, str]:
    """Return partition key -> data version of an asset, of the recordings that are registered."""
    recorded = records.states([asset])[asset]
    live = sorted(records.live() & recorded.keys())
    return {key: recorded[key].data_version for key in live if not recorded[key].is_skip}


def skipped(
    context: dg.AssetExecutionContext, workspace: Workspace, asset: AssetName
) -> dg.MaterializeResult[None] | None:
    """Return what a step returns for a recording that is skipped; None if it is not.

    A step that fails on it is red in the web UI, and ends a backfill as failed.

    Args:
        context: context of the step.
        workspace: its resource.
        asset: what the step reads: name of one of our assets, or the key of any.
    """
    recorded = workspace.on(context.instance).records.of(asset, context.partition_key)
    if recorded is None or not recorded.is_skip:
        return None
    version = dg.DataVersion(recorded.data_version)
    return dg.MaterializeResult(data_version=version, metadata=skip_metadata(recorded.why_skipped))


def publish(
    context: dg.AssetExecutionContext,
    workspace: Workspace,
    make: Callable[[ArtifactWriter], JsonObject],
    inputs: Mapping[str, Artifact],
    *,
    params: JsonMapping | None = None,
    libraries: tuple[str, ...] = (),
) -> dg.MaterializeResult[None]:
    """Make the artifact of this asset, unless the store has the result of the same action.

    The action consists of the asset key and its `code_version`, `params`, the versions of `libraries`, and the content
    of `inputs`. The digest of the artifact becomes the data version of the asset.

    Args:
        context: context of the asset.
        workspace: its resource.
        make: writes files into the artifact, and returns counts and other small facts, which become metadata. What it
            writes must depend on nothing but the action.
        inputs: name -> artifact that `make` reads.
        params: JSON values that shape the result, such as thresholds.
        libraries: installed distributions whose versions shape the result.

    Raises:
        dagster.Failure: an error of bagassets, with its message, or the asset has no `code_version`.
    """
    key = context.asset_key
    with errors_explained():
        version = context.assets_def.code_versions_by_key.get(key)
        if version is None:
            raise StoreError(
                f"{key.to_user_string()}: give this asset a code_version, and raise it when its code changes; without "
                "one, an old result would pass for a new one."
            )
        # The prefix keeps users' steps apart from ours, whatever they are called.
        step = Step(f"own/{key.to_user_string()}", 1, libraries)
        digests = {name: artifact.digest for name, artifact in inputs.items()}
        action = step.action({"code_version": version, "params": dict(params or {})}, digests)
        outcome = run_action(workspace.store, action, make)
        result = AssetResult(
            key.to_user_string(), outcome.artifact, outcome.action_digest, outcome.cached, outcome.seconds
        )
        return dg.MaterializeResult(
            data_version=dg.DataVersion(outcome.artifact.digest), metadata=result_metadata(result, Face())
        )


def follow_recordings(
    asset: AssetName,
    *,
    upstream: AssetName,
    interval_s: int = 30,
    resource_key: str = "workspace",
) -> dg.SensorDefinition:
    """Return a sensor that runs an unpartitioned asset when a recording was added, changed or removed.

    Automation conditions wait for ever for skipped recordings, miss removals, and lose changes between a run and the
    next tick.

    Args:
        asset: key of an unpartitioned asset.
        upstream: the partitioned asset that it reads: name of one of ours, or the key of any.
        interval_s: least time between two ticks.
        resource_key: of the project, as given to `build_definitions`.
    """
    key = asset if isinstance(asset, dg.AssetKey) else dg.AssetKey(asset)
    read = upstream.to_user_string() if isinstance(upstream, dg.AssetKey) else upstream

    @dg.sensor(
        name=f"{key.to_python_identifier()}_follows_recordings",
        target=dg.AssetSelection.assets(key),
        required_resource_keys={resource_key},
        minimum_interval_seconds=interval_s,
        default_status=dg.DefaultSensorStatus.RUNNING,
        metadata={FOLLOWS: key.to_user_string()},
        description=f"Requests a run of {key.to_user_string()} whenever {read} of a recording was added, changed or removed.",
    )
    # Called directly, as in tests, a sensor is given its resources as parameters, too.
    def follow(context: dg.SensorEvaluationContext, **_resources: object) -> dg.SensorResult:
        workspace = Workspace.of(context, resource_key)
        with errors_explained():
            now = digest_json(_versions(workspace.records, upstream))
        runs = context.instance.get_runs(dg.RunsFilter(statuses=ACTIVE))
        busy = any(key in (run.asset_selection or ()) for run in runs)
        if now == context.cursor or busy:
            return dg.SensorResult()
        tags = sensor_tags(context, workspace.records, key, ("bag", *workspace.assets.names))
        if tags is None:  # a build has made it meanwhile
            return dg.SensorResult(cursor=now)
        return dg.SensorResult(run_requests=[dg.RunRequest(asset_selection=[key], tags=tags)], cursor=now)

    return follow
