"""What a run makes of a recording, whether it is about this recording alone or about several."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import dagster as dg

from bagassets.assets.inventory import INVENTORY
from bagassets.base.errors import StoreError
from bagassets.defs.records.events import CONTENT, MADE_ALONG, SEVERAL, recorded_partition
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.not_made import last_failure
from bagassets.defs.records.reporting import Metadata, bag_metadata, result_metadata, skip_metadata
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.run_progress import readings_noted
from bagassets.engine.execute import Skipped, execute
from bagassets.engine.first_pass import first_pass
from bagassets.engine.graph import SELECTION, Graph
from bagassets.engine.plan import skip_version
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.recordings.digest import RecordingStat, recording_digest, recording_stat
from bagassets.recordings.model import RecordingFiles

__all__ = ["MadeAsset", "Source", "dependencies", "make_assets", "read_bag", "recorded_bag"]


@dataclass(frozen=True)
class Source:
    """A recording as it was when it was hashed.

    Attributes:
        recording: its files.
        digest: digest of its content.
        stat: its status before it was hashed.
        made_along: digest of the action whose artifact was made in the same pass of the same run; "" if none was.
    """

    recording: RecordingFiles
    digest: str
    stat: RecordingStat
    made_along: str = ""


@dataclass(frozen=True)
class MadeAsset:
    """An asset of a recording to be recorded as materialized, which it is if it was skipped, too.

    Without a materialization Dagster would take it as failed in a backfill, and request nothing below it.
    """

    asset: str
    data_version: str
    metadata: Metadata


def dependencies(assets: RecordingAssets, asset: str) -> list[str]:
    """Return the upstream assets that Dagster knows of an asset.

    All but the inventory depend on the recording through the inventory, which has a digest of each topic: so a recording
    that was only re-indexed or re-compressed leaves them fresh in Dagster's markers, too.
    """
    return list(assets.upstream(asset)) or ["bag"]


def read_bag(
    instance: dg.DagsterInstance,
    workspace: Workspace,
    recording: RecordingFiles,
    run_id: str,
    *,
    makes_inventory: bool,
) -> tuple[Source, MadeAsset]:
    """Hash a recording, and return it with what is recorded of it as `bag`.

    If the run makes its inventory, and has to hash it, both take one pass.

    Raises:
        RecordingError: it cannot be read, or changed meanwhile.
    """
    stat, made_along = recording_stat(recording), ""
    if makes_inventory:
        with readings_noted(instance, run_id, recording.key):
            first = first_pass(workspace.recipe, workspace.store, recording, stat, workspace.index)
        if first.inventory is not None and not first.inventory.cached:
            made_along = first.inventory.action_digest
        digest = first.digest
    else:
        digest = recording_digest(recording, workspace.index)
    # On record, as the step that makes the inventory may be another process.
    metadata = bag_metadata(recording, stat, digest) | ({MADE_ALONG: made_along} if made_along else {})
    return Source(recording, digest.digest, stat.as_of(digest), made_along), MadeAsset(
        "bag", digest.digest, metadata
    )


def recorded_bag(
    instance: dg.DagsterInstance, names: Naming, recording: RecordingFiles, run_id: str
) -> Source:
    """Return a recording as it was when `bag` was last recorded, in this run or another.

    Raises:
        StoreError: it never was.
    """
    record = recorded_partition(instance, names, "bag", recording.key)
    if record is None or record.stat is None:
        raise StoreError(
            f"{recording.key}: bag is not materialized for this recording; materialize bag first."
        )
    made_along = record.made_along if record.run_id == run_id else ""
    return Source(recording, record.data_version, record.stat, made_along)


def make_assets(
    instance: dg.DagsterInstance, workspace: Workspace, source: Source, wanted: set[str], run_id: str
) -> Iterator[MadeAsset]:
    """Bring assets of a recording up to date, and yield each as soon as it is.

    Args:
        instance: where their upstream is recorded.
        workspace: recipe and store.
        source: the recording.
        wanted: names of the assets, without `bag`.
        run_id: the run that records them.

    Raises:
        BuildFailure: some could not be made; raised after all others were.
        StoreError: an artifact that they need is not in the store.
    """
    key, assets, names = source.recording.key, workspace.assets, workspace.names
    # The inventory decides whether the recording takes part, even if the asset (of a package) does not read it.
    upstream = {INVENTORY.name, *(name for asset in wanted for name in assets.upstream(asset))} - wanted
    records = {name: recorded_partition(instance, names, name, key) for name in sorted(upstream)}
    found = {name: record for name, record in records.items() if record is not None and not record.is_skip}
    given = {name: workspace.store.artifact(record.data_version) for name, record in found.items()}
    failures = {
        name: why
        for name in sorted(upstream - found.keys())
        if (why := last_failure(instance, names, name, key)) is not None
    }
    contents = {source.digest, *(record.content for record in found.values())}
    # Of assets that an older version recorded, it is not known.
    content = "" if "" in contents else source.digest if len(contents) == 1 else SEVERAL
    graph = Graph(
        assets,
        workspace.store,
        source.recording,
        source.digest,
        source.stat,
        wanted=wanted,
        given=given,
        failures=failures,
    )
    with readings_noted(instance, run_id, key):
        for result in execute(graph):
            if isinstance(result, Skipped):
                version, metadata = skip_version(result.reason), skip_metadata(result.reason)
            else:
                reason = graph.node(SELECTION).skipped if result.asset == INVENTORY.name else None
                cached = result.cached and result.action_digest != source.made_along
                skipped: Metadata = {"skipped": reason} if reason else {}  # first: nothing else follows of it
                metadata = skipped | result_metadata(
                    replace(result, cached=cached), assets[result.asset].face
                )
                version = result.artifact.digest
            if content:
                metadata[CONTENT] = content
            yield MadeAsset(result.asset, version, metadata)
