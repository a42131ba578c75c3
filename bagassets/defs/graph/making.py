"""What a run makes of a recording, whether it is about this recording alone or about several."""

from collections.abc import Collection, Iterator
from dataclasses import replace

from bagassets.assets.inventory import INVENTORY
from bagassets.base.errors import StoreError
from bagassets.defs.records.events import CONTENT, MADE_ALONG, SEVERAL
from bagassets.defs.records.recorder import Made, Recorder
from bagassets.defs.records.reporting import (
    BAG_CODE_VERSION,
    Metadata,
    bag_metadata,
    result_metadata,
    skip_metadata,
)
from bagassets.defs.runs.run_progress import readings_noted
from bagassets.engine.execute import Skipped, execute
from bagassets.engine.first_pass import first_pass, was_just_made
from bagassets.engine.graph import SELECTION, Graph
from bagassets.engine.plan import Recorded, skip_version
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.model import RecordingFiles


def dependencies(assets: RecordingAssets, asset: str) -> list[str]:
    """Return the upstream assets that Dagster knows of an asset.

    All but the inventory depend on the recording through the inventory, which has a digest of each topic: so a recording
    that was only re-indexed or re-compressed leaves them fresh in Dagster's markers, too.
    """
    return list(assets.upstream(asset)) or ["bag"]


def read_bag(recorder: Recorder, recording: RecordingFiles) -> tuple[Recorded, Made]:
    """Hash a recording; return its record, with the status of its files that the digest is valid for, and what to record.

    If the run makes its inventory, and has to hash it, both take one pass.

    Raises:
        RecordingError: it cannot be read, or changed meanwhile.
    """
    workspace, run_id = recorder.workspace, recorder.step.run_id
    stat, made_along = recording_stat(recording), ""
    if INVENTORY.name in recorder.wanted:
        with readings_noted(recorder.step, recording.key):
            first = first_pass(workspace.assets, recording, stat)
        if first.inventory is not None and not first.inventory.cached:
            made_along = first.inventory.action_digest
        digest = first.digest
    else:
        digest = recording_digest(recording, workspace.assets.index)
    # On record, as the step that makes the inventory may be another process.
    metadata = bag_metadata(recording, stat, digest) | ({MADE_ALONG: made_along} if made_along else {})
    made = Made("bag", digest.digest, BAG_CODE_VERSION, metadata, {})
    stat = stat.as_of(digest)
    return Recorded(
        made.data_version, made.code_version, stat=stat, run_id=run_id, made_along=made_along
    ), made


def make_recording(recorder: Recorder, recording: RecordingFiles, assets: Collection[str]) -> Iterator[Made]:
    """Bring assets of a recording that is locked up to date, and yield each as soon as it is, to be recorded before the next.

    Raises:
        BuildFailure: some could not be made; raised after all others were.
        RecordingError: it cannot be read, or changed meanwhile.
        StoreError: `bag` never was recorded, or an artifact that they need is not in the store.
    """
    workspace, run_id = recorder.workspace, recorder.step.run_id
    key, project, records = recording.key, workspace.assets, workspace.records
    bag: Recorded | None
    if "bag" in assets:
        bag, made = read_bag(recorder, recording)
        yield made
    else:
        bag = records.of("bag", key)
    wanted = {*assets} - {"bag"}
    if not wanted:
        return
    if bag is None or bag.stat is None:
        raise StoreError(f"{key}: bag is not materialized for this recording; materialize bag first.")
    # The inventory decides whether the recording takes part, even if the asset (of a package) does not read it.
    upstream = {INVENTORY.name, *(name for asset in wanted for name in project.upstream(asset))} - wanted
    found, failures = {}, {}
    for name in sorted(upstream):
        record = records.of(name, key)
        if record is not None and not record.is_skip:
            found[name] = record
        elif (why := records.last_failure(name, key)) is not None:
            failures[name] = why
    given = {name: workspace.store.artifact(record.data_version) for name, record in found.items()}
    contents = {bag.data_version, *(record.content for record in found.values())}
    # Of assets that an older version recorded, it is not known.
    content = "" if "" in contents else bag.data_version if len(contents) == 1 else SEVERAL
    source = recording, bag.data_version, bag.stat
    graph = Graph(project, *source, wanted=wanted, given=given, failures=failures)
    with readings_noted(recorder.step, key):
        for result in execute(graph):
            if isinstance(result, Skipped):
                version, metadata = skip_version(result.reason), skip_metadata(result.reason)
            else:
                reason = graph.node(SELECTION).skipped if result.asset == INVENTORY.name else None
                # The inventory was made in the pass that hashed the recording, if this was in the same run.
                is_new = bag.run_id == run_id and result.action_digest == bag.made_along
                is_new = is_new or was_just_made(workspace.recipe.state, result.action_digest)
                cached = result.cached and not is_new
                skipped: Metadata = {"skipped": reason} if reason else {}  # first: nothing else follows of it
                metadata = skipped | result_metadata(
                    replace(result, cached=cached), project[result.asset].face
                )
                version = result.artifact.digest
            if content:
                metadata[CONTENT] = content
            inputs = dict.fromkeys(dependencies(project, result.asset))
            parts = () if isinstance(result, Skipped) else result.channels.values()
            yield Made(result.asset, version, project.versions[result.asset], metadata, inputs, parts=parts)
