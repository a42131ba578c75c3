"""The assets that exist once: the index of inputs, the datasets made from it, and the map.

The report is written with the main dataset: the link on its page in the web UI opens it.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import dagster as dg

from bagassets.base.errors import BagAssetsError
from bagassets.base.escaping import markdown
from bagassets.defs.graph.check_records import findings_on_record
from bagassets.defs.graph.making import MadeAsset
from bagassets.defs.records.artifact_files import page_link
from bagassets.defs.records.events import CODE_VERSION, DATA_VERSION, latest_ids, recorded_wholes
from bagassets.defs.records.instance_plan import InstancePlan, plan_in_run
from bagassets.defs.records.naming import DATASET_INPUTS, Naming
from bagassets.defs.records.reporting import code_link, dataset_metadata, errors_explained, inputs_metadata
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.fence import refuse_if_ended
from bagassets.engine.plan import AssetState
from bagassets.engine.targets import Evidence, Read, Target, target_state
from bagassets.formats import trajectory_map
from bagassets.formats.catalogue import formats, formats_of, recording_assets
from bagassets.formats.dataset_build import (
    DatasetInputs,
    build_dataset,
    dataset_code_versions,
    datasets_of,
    is_on_disk,
    select_inputs,
)
from bagassets.formats.report_data import build_map, map_path, report_data, report_path
from bagassets.recipe.model import Recipe
from bagassets.report.page import report_page
from bagassets.report.write import write_page

__all__ = [
    "dataset_assets",
    "dataset_is_current",
    "dataset_states",
    "make_dataset",
    "record_inputs",
    "write_report",
]

TRAJECTORY_MAP = trajectory_map.STEP.name
INPUTS_CODE_VERSION = "1"
_READS = (Read(DATASET_INPUTS, "whole", "its recordings changed since it was made"),)
_CODE_CHANGED = "its settings, the splits or its version changed"
MOST_REPORTED = 1000
"""It takes a millisecond or two for each recording, and a change of one is not to cost more the more there are."""

_INPUTS = """Which recordings the datasets are made from, and why others are left out.

Its data version is a digest over the partition keys and data versions of all recordings that take part, so it changes
with each of them and when one is removed, however many there are; Dagster itself compares at most 100 partitions. The
sensor and `bagassets build` record it without a run."""
_MAP = """Where all recordings were driven: an interactive map with a layer per split and a heat layer.

Without a network, it shows the same routes on a plain grid."""


def dataset_is_current(instance: dg.DagsterInstance, workspace: Workspace, inputs: DatasetInputs) -> bool:
    """Return whether all datasets on disk were made from `inputs` with this recipe and code."""
    return all(one.state == "fresh" for one in dataset_states(instance, workspace, inputs).values())


def dataset_states(
    instance: dg.DagsterInstance, workspace: Workspace, inputs: DatasetInputs, waits_for: str = ""
) -> dict[str, AssetState]:
    """Return the state of each dataset, and of the map.

    Args:
        instance: where materializations are recorded.
        workspace: recipe and store.
        inputs: what they would be made from.
        waits_for: results that are yet to come, and change what they are made from.
    """
    recipe, versions = workspace.recipe, dataset_code_versions(workspace.recipe)
    recorded = recorded_wholes(instance, workspace.names, versions)
    now, is_due = {DATASET_INPUTS: inputs.digest}, any(inputs.parts.values())
    found = {}
    for asset, version in versions.items():
        last = recorded.get(asset)
        evidence = Evidence(
            now,
            last,
            {} if last is None else last.inputs,
            is_whole=partial(is_on_disk, recipe, asset),
            waits_for=waits_for,
            is_due=is_due,
        )
        found[asset] = target_state(Target(asset, _READS, version, code_changed=_CODE_CHANGED), evidence)
    return found


def record_inputs(instance: dg.DagsterInstance, workspace: Workspace, inputs: DatasetInputs) -> None:
    """Record `dataset_inputs` without a run (about 10 ms), if it changed, or records that it points to did.

    Its tags name its inputs, as those of a run would: without them Dagster would mark it as stale.
    """
    key = workspace.names.key(DATASET_INPUTS)
    tags = {
        DATA_VERSION: inputs.digest,
        CODE_VERSION: INPUTS_CODE_VERSION,
        **_provenance(instance, workspace, inputs),
    }
    newest = instance.get_latest_materialization_event(key)
    recorded = None if newest is None else newest.asset_materialization
    if recorded is None or not tags.items() <= (recorded.tags or {}).items():
        metadata = inputs_metadata(inputs)
        instance.report_runless_asset_event(
            dg.AssetMaterialization(asset_key=key, metadata=metadata, tags=tags)
        )


def _note_inputs(context: dg.AssetExecutionContext, workspace: Workspace, inputs: DatasetInputs) -> None:
    """See to it that a dataset is recorded as made from `inputs`, also if it is made alone and they were recorded before.

    What a step reads Dagster looks up before the step begins.
    """
    recorded = context.instance.get_latest_materialization_event(workspace.names.key(DATASET_INPUTS))
    tags = recorded.asset_materialization.tags if recorded and recorded.asset_materialization else None
    if (tags or {}).get(DATA_VERSION) != inputs.digest:
        record_inputs(context.instance, workspace, inputs)
        context.op_execution_context.get_step_execution_context().fetch_external_input_asset_version_info()


def _provenance(instance: dg.DagsterInstance, workspace: Workspace, inputs: DatasetInputs) -> dict[str, str]:
    """Return tags that point to the newest record of all recordings, which Dagster compares with later ones."""
    tags, names = {}, workspace.names
    for asset, ids in latest_ids(instance, names, _read_of_recordings(workspace.recipe)).items():
        tags[names.input_tag(asset)] = inputs.digest
        tags[names.pointer_tag(asset)] = str(max(ids.values(), default=0))
    return tags


def _read_of_recordings(recipe: Recipe) -> list[str]:
    """Return the assets of a recording that datasets are made from."""
    return [kind.part for kind in formats() if kind.part in recording_assets(recipe).names]


def dataset_assets(recipe: Recipe, names: Naming) -> list[dg.AssetsDefinition]:
    """Return the assets that exist once."""

    @dg.asset(
        key=names.key(DATASET_INPUTS),
        deps=[
            dg.AssetDep(names.key(asset), partition_mapping=dg.AllPartitionMapping())
            for asset in _read_of_recordings(recipe)
        ],
        required_resource_keys={names.workspace},
        group_name=names.dataset_group,
        kinds={"json"},
        description=_INPUTS,
        code_version=INPUTS_CODE_VERSION,
        metadata=code_link(select_inputs),
    )
    def dataset_inputs(context: dg.AssetExecutionContext) -> dg.MaterializeResult[None]:
        workspace: Workspace = getattr(context.resources, names.workspace)
        with errors_explained():
            inputs = plan_in_run(context, workspace).inputs
            return dg.MaterializeResult(
                data_version=dg.DataVersion(inputs.digest), metadata=inputs_metadata(inputs)
            )

    datasets = [
        _made_from_inputs(recipe, names, one.asset, set(one.kind.kinds), one.description, one.kind.join)
        for one in datasets_of(recipe).values()
    ]
    if TRAJECTORY_MAP in dataset_code_versions(recipe):
        datasets.append(_made_from_inputs(recipe, names, TRAJECTORY_MAP, {"html"}, _MAP, build_map))
    return [dataset_inputs, *datasets]


def _made_from_inputs(
    recipe: Recipe, names: Naming, asset: str, kinds: set[str], about: str, make: Callable[..., object]
) -> dg.AssetsDefinition:
    """Return the definition of a dataset, or of the map."""

    @dg.asset(
        key=names.key(asset),
        deps=[names.key(DATASET_INPUTS)],
        required_resource_keys={names.workspace},
        group_name=names.dataset_group,
        kinds=kinds,
        description=about,
        code_version=dataset_code_versions(recipe)[asset],
        metadata=code_link(make),
    )
    def made_from_inputs(context: dg.AssetExecutionContext) -> dg.MaterializeResult[None]:
        workspace: Workspace = getattr(context.resources, names.workspace)
        with errors_explained():
            planned = plan_in_run(context, workspace)
            _note_inputs(context, workspace, planned.inputs)
            made = make_dataset(context.instance, workspace, planned, asset, context.run.run_id)
            return dg.MaterializeResult(
                data_version=dg.DataVersion(made.data_version), metadata=made.metadata
            )

    return made_from_inputs


def make_dataset(
    instance: dg.DagsterInstance, workspace: Workspace, planned: InstancePlan, asset: str, run_id: str
) -> MadeAsset:
    """Make a dataset, or the map, from what is planned, and return what is to be recorded of it.

    Raises:
        BagAssetsError: it could not be made.
        RunEndedError: the run was given up meanwhile.
    """
    recipe = workspace.recipe  # as it is now: this process may be older

    permit = partial(refuse_if_ended, instance, run_id)
    if asset == TRAJECTORY_MAP:
        permit()
        outcome = build_map(recipe, workspace.store, planned.plan)
        return MadeAsset(
            asset,
            outcome.artifact.digest,
            {
                "open": dg.MetadataValue.md(f"[Open the map]({page_link('map')})"),
                "map": dg.MetadataValue.path(str(map_path(recipe))),
                "cached": outcome.cached,
                **outcome.artifact.summary(),
            },
        )
    dataset = datasets_of(recipe)[asset]
    summary = build_dataset(dataset, recipe, workspace.store, planned.plan, planned.inputs, permit)
    failed = planned.inputs.failed.get(dataset.kind.name, {})
    is_first = dataset.kind in formats_of(recipe)[:1] and dataset.selection is None  # the report is about all
    report = {"report": write_report(instance, workspace, planned)} if is_first else {}
    return MadeAsset(asset, summary.digest, report | dataset_metadata(summary, failed))


def write_report(
    instance: dg.DagsterInstance, workspace: Workspace, planned: InstancePlan
) -> dg.MarkdownMetadataValue:
    """Write the report with what the checks of recordings found when they ran; return a link to it, or why there is none."""
    if len(planned.plan.bags) > MOST_REPORTED:
        return dg.MetadataValue.md(f"`bagassets report` writes it (more than {MOST_REPORTED} recordings)")
    try:
        data = report_data(workspace.recipe, workspace.store, planned.plan)
        problems, passed = findings_on_record(instance, workspace)
        recordings = [
            replace(one, problems=problems.get(one.key, ()), checks_passed=passed.get(one.key, 0))
            for one in data.recordings
        ]
        write_page(report_path(workspace.recipe), report_page(replace(data, recordings=recordings)))
    except (BagAssetsError, OSError) as err:  # the dataset is as good without it
        return dg.MetadataValue.md(f"It could not be written: {markdown(str(err))}")
    return dg.MetadataValue.md(f"[Open the report]({page_link('report')})")
