"""Why an asset of a recording was not made, as an observation: the page of its partition shows it.

A run that fails says it in its log only, among the tracebacks of Dagster, and on no page of an asset.
"""

from collections.abc import Collection, Iterator
from contextlib import contextmanager

import dagster as dg

from bagassets.base.errors import BagAssetsError, RunEndedError
from bagassets.defs.records.naming import Naming
from bagassets.engine.execute import BuildFailure
from bagassets.engine.recording_assets import RecordingAssets

__all__ = ["failures_observed", "is_selected", "last_failure", "observations_of"]

_WHY = "not_made"


def observations_of(
    assets: RecordingAssets, names: Naming, key: str, missing: Collection[str], err: BagAssetsError | str
) -> list[dg.AssetObservation]:
    """Return an observation of each asset of a recording, or dataset, that a failure kept from being made.

    An asset that failed itself has its own sentence, and one that reads it says which one failed.

    Args:
        assets: of recordings.
        names: of the project in Dagster.
        key: partition key of the recording; empty for datasets.
        missing: names of the assets that were to be made and are not; may include `bag`.
        err: what went wrong, or its sentence.
    """
    own = {name: str(error) for name, error in err.errors.items()} if isinstance(err, BuildFailure) else {}
    return [
        _observation(names.key(name), key, _why(assets, name, own) or str(err)) for name in sorted(missing)
    ]


def _why(assets: RecordingAssets, asset: str, failed: dict[str, str]) -> str:
    if asset in failed:
        return failed[asset]
    above = [name for name in assets.with_upstream([asset]) if name in failed]
    return "\n".join(f"{name} failed: {failed[name]}" for name in above)


def _observation(asset: dg.AssetKey, key: str, why: str) -> dg.AssetObservation:
    return dg.AssetObservation(
        asset, description=why, partition=key or None, metadata={_WHY: dg.MetadataValue.text(why)}
    )


def last_failure(instance: dg.DagsterInstance, names: Naming, asset: str, key: str) -> str | None:
    """Return why an asset of a recording was not made when that was last tried; None if it is not known."""
    about = dg.AssetRecordsFilter(asset_key=names.key(asset), asset_partitions=[key])
    for record in instance.fetch_observations(about, limit=1).records:
        if record.asset_observation is not None and _WHY in record.asset_observation.metadata:
            return record.asset_observation.description
    return None


@contextmanager
def failures_observed(
    context: dg.AssetExecutionContext, assets: RecordingAssets, names: Naming, wanted: Collection[str]
) -> Iterator[set[str]]:
    """Record why assets were not made: those of a step, and those of its run that Dagster will not even begin.

    Args:
        context: of the step.
        assets: of recordings.
        names: of the project in Dagster.
        wanted: names of the assets that the step is to make.

    Yields:
        names to which the step adds each asset that it has made.
    """
    made: set[str] = set()
    try:
        yield made
    except RunEndedError:
        raise  # Whoever ended the run has said why, and a later one may have made them.
    except BagAssetsError as err:
        missing = {*wanted, *(err.errors if isinstance(err, BuildFailure) else ())} - made
        for asset in ("bag", *assets.names):
            if not missing.isdisjoint(assets.with_upstream([asset])) and is_selected(
                context, names.key(asset)
            ):
                missing.add(asset)
        for observation in observations_of(assets, names, context.partition_key, missing, err):
            context.log_event(observation)
        raise


def is_selected(context: dg.AssetExecutionContext, asset: dg.AssetKey) -> bool:
    """Return whether the run of a step is to make an asset."""
    selected = context.run.asset_selection
    return not selected or asset in selected
