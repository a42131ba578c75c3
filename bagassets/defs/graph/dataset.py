"""The assets that exist once: the index of inputs, the datasets made from it, and the map.

The report is written with the main dataset: the link on its page in the web UI opens it.
"""

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import partial

import dagster as dg

from bagassets.base.errors import BagAssetsError
from bagassets.base.escaping import markdown
from bagassets.defs.records.artifact_files import page_link
from bagassets.defs.records.fence import refuse_if_ended
from bagassets.defs.records.instance_plan import plan_instance
from bagassets.defs.records.naming import DATASET_INPUTS, Naming
from bagassets.defs.records.recorder import Made, Recorder
from bagassets.defs.records.reporting import code_link, dataset_metadata, errors_explained, inputs_metadata
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.batches import DATASET
from bagassets.engine.plan import AssetState, Plan
from bagassets.engine.targets import NOTHING_TO_MAKE_IT_FROM, TO_MAKE, Evidence, Read, Target, target_state
from bagassets.formats.catalogue import formats, formats_of, recording_assets
from bagassets.formats.dataset_build import (
    Dataset,
    DatasetInputs,
    build_dataset,
    dataset_code_versions,
    is_on_disk,
    made_once,
    select_inputs,
    what_changed,
)
from bagassets.formats.format import ByGroups
from bagassets.formats.report_data import build_map, map_path, report_data, report_path
from bagassets.recipe.model import Recipe
from bagassets.report.page import report_page
from bagassets.report.write import write_page

INPUTS_CODE_VERSION = "1"
_READS = (Read(DATASET_INPUTS, "whole"),)
_CODE_CHANGED = "its settings, the splits or its version changed"
MOST_REPORTED = 1000
"""It takes a millisecond or two for each recording, and a change of one is not to cost more the more there are."""

_INPUTS = """Which recordings the datasets are made from, and why others are left out.

Its data version is a digest over the partition keys and data versions of all recordings that take part, so it changes
with each of them and when one is removed, however many there are; Dagster itself compares fewer than 100 partitions.
The sensor and `bagassets build` record it without a run."""


def dataset_is_current(workspace: Workspace, inputs: DatasetInputs) -> bool:
    """Return whether all datasets that can be made are on disk as made from `inputs` with this recipe and code."""
    states = dataset_states(workspace, inputs, says_why=False)
    return not any(one.state in TO_MAKE for one in states.values())


def dataset_states(
    workspace: Workspace, inputs: DatasetInputs, waits_for: str = "", *, says_why: bool = True
) -> dict[str, AssetState]:
    """Return the state of each dataset, and of the map.

    Args:
        workspace: recipe, store and records.
        inputs: what they would be made from.
        waits_for: results that are yet to come, and change what they are made from.
        says_why: somebody wants to know which change of recordings makes one stale.
    """
    recipe, versions = workspace.recipe, dataset_code_versions(workspace.recipe)
    recorded = workspace.records.wholes(versions)
    now, is_due = {DATASET_INPUTS: inputs.digest}, any(inputs.parts.values())
    found = {}
    for asset, version in versions.items():
        last = recorded.get(asset)
        evidence = Evidence(
            now,
            last,
            {} if last is None else last.inputs,
            is_whole=partial(is_on_disk, recipe, asset),
            changed=partial(what_changed, recipe, inputs, asset) if says_why else str,
            waits_for=waits_for,
            is_due=is_due,
        )
        found[asset] = target_state(Target(asset, _READS, version, code_changed=_CODE_CHANGED), evidence)
    return found


def record_inputs(workspace: Workspace, inputs: DatasetInputs) -> None:
    """Record `dataset_inputs` without a run (about 10 ms) if it changed, or records that it points to did.

    Its tags name its inputs, as those of a run would: without them Dagster would mark it as stale.
    """
    read = dict.fromkeys(_read_of_recordings(workspace.recipe), inputs.digest)
    made = Made(DATASET_INPUTS, inputs.digest, INPUTS_CODE_VERSION, {}, read)
    recorder = Recorder(workspace, DATASET)
    if not recorder.is_recorded(made):
        recorder.record(replace(made, metadata=inputs_metadata(inputs)))


def _read_of_recordings(recipe: Recipe) -> list[str]:
    """Return the assets of a recording that datasets are made from."""
    return [kind.part for kind in formats() if kind.part in recording_assets(recipe).names]


def dataset_assets(
    recipe: Recipe, names: Naming, policy: dg.BackfillPolicy | None
) -> list[dg.AssetsDefinition]:
    """Return the assets that exist once; the `policy` is for those runs that are about a range of recordings, too."""
    read = [
        dg.AssetDep(names.key(asset), partition_mapping=dg.AllPartitionMapping())
        for asset in _read_of_recordings(recipe)
    ]

    def definition(
        asset: str, version: str, kinds: Collection[str], about: str, make: Callable[..., object]
    ) -> dg.AssetsDefinition:
        @dg.asset(
            key=names.key(asset),
            deps=read if asset == DATASET_INPUTS else [names.key(DATASET_INPUTS)],
            required_resource_keys={names.workspace},
            group_name=names.dataset_group,
            kinds={*kinds},
            description=about,
            code_version=version,
            metadata=code_link(make),
            backfill_policy=policy,
        )
        def made_once(context: dg.AssetExecutionContext) -> Iterator[dg.MaterializeResult[None]]:
            workspace = Workspace.of(context, names.workspace)
            with errors_explained():
                # Made once, so that all datasets that the run makes have the same inputs.
                plan = workspace.once_in_run(context.run.run_id, partial(plan_instance, workspace))
                inputs = select_inputs(plan)
                if asset == DATASET_INPUTS:
                    made = Made(asset, inputs.digest, version, inputs_metadata(inputs), {})
                else:
                    # Also if it is made alone. What a step reads Dagster looks up before the step begins.
                    recorded = workspace.records.whole(DATASET_INPUTS)
                    if recorded is None or recorded.data_version != inputs.digest:
                        record_inputs(workspace, inputs)
                        step = context.op_execution_context.get_step_execution_context()
                        step.fetch_external_input_asset_version_info()
                    if not any(inputs.parts.values()) and workspace.records.whole(asset) is None:
                        raise BagAssetsError(
                            f"{asset}: {NOTHING_TO_MAKE_IT_FROM}; materialize the assets of recordings first, "
                            "or run `bagassets build`, and see `bagassets status`."
                        )
                    made = make_dataset(workspace, plan, inputs, asset, context.run.run_id)
                yield from Recorder(workspace, DATASET, context).record(made)

        return made_once

    versions = dataset_code_versions(recipe)
    found = [definition(DATASET_INPUTS, INPUTS_CODE_VERSION, {"json"}, _INPUTS, select_inputs)]
    for name, one in made_once(recipe).items():
        kinds, how = (one.kind.kinds, one.kind.join) if isinstance(one, Dataset) else ({"html"}, build_map)
        make = how.finish if isinstance(how, ByGroups) else how
        found.append(definition(name, versions[name], kinds, one.description, make))
    return found


def make_dataset(workspace: Workspace, plan: Plan, inputs: DatasetInputs, asset: str, run_id: str) -> Made:
    """Make a dataset, or the map, from what is planned, and return what is to be recorded of it.

    Raises:
        BagAssetsError: it could not be made.
        RunEndedError: the run was given up meanwhile.
    """
    recipe = workspace.recipe  # as it is now: this process may be older
    dataset, read = made_once(recipe)[asset], {DATASET_INPUTS: inputs.digest}
    version, permit = (
        dataset.code_version(recipe.splits),
        partial(refuse_if_ended, workspace.instance, run_id),
    )
    if not isinstance(dataset, Dataset):
        permit()
        outcome = build_map(workspace.assets, plan, inputs)
        metadata = {
            "map": dg.MetadataValue.md(page_link("map", map_path(recipe))),
            "cached": outcome.cached,
            **outcome.artifact.summary(),
        }
        return Made(asset, outcome.artifact.digest, version, metadata, read)
    summary = build_dataset(dataset, recipe, workspace.store, plan, inputs, permit)
    failed = inputs.failed.get(dataset.kind.name, {})
    is_first = dataset.kind in formats_of(recipe)[:1] and dataset.selection is None  # the report is about all
    report = {"report": write_report(workspace, plan)} if is_first else {}
    return Made(asset, summary.digest, version, report | dataset_metadata(summary, failed), read)


def write_report(workspace: Workspace, plan: Plan) -> dg.MarkdownMetadataValue:
    """Write the report, with what checks find in recordings; return a link to it, or why there is none."""
    if len(plan.bags) > MOST_REPORTED:
        return dg.MetadataValue.md(f"`bagassets report` writes it (more than {MOST_REPORTED} recordings)")
    try:
        data = report_data(workspace.assets, plan, "recordings")
        write_page(report_path(workspace.recipe), report_page(data))
    except (BagAssetsError, OSError) as err:  # the dataset is as good without it
        return dg.MetadataValue.md(f"It could not be written: {markdown(str(err))}")
    return dg.MetadataValue.md(page_link("report", report_path(workspace.recipe)))
