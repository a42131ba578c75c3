"""Asset checks: the rules of `bagassets.assets.quality`, shown per recording and for the dataset."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial

import dagster as dg

from bagassets.assets.quality.check import RecordingCheck, severity_of
from bagassets.assets.quality.evidence import Evidence
from bagassets.assets.quality.finding import Finding
from bagassets.assets.selection import choose_rig, skip_reason
from bagassets.base.escaping import markdown, visible
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import recording_partitions
from bagassets.defs.records.recorder import Recorder
from bagassets.defs.records.reporting import errors_explained
from bagassets.defs.records.workspace import Workspace
from bagassets.formats import checking
from bagassets.formats.catalogue import recording_assets
from bagassets.formats.checking import KeptVerdicts, Verdict
from bagassets.formats.dataset_build import Dataset, datasets_of
from bagassets.recipe.model import Recipe
from bagassets.recordings.model import RecordingFiles
from bagassets.store.artifact import Artifact

Checks = Mapping[str, Sequence[RecordingCheck]]
"""Asset -> checks of it."""

MOST_SENTENCES = 20
FAILED = "FAILED"
"""As Dagster's `AssetCheckExecutionRecordStatus` has a check that did not pass."""


def recording_checks(recipe: Recipe, names: Naming) -> list[dg.AssetChecksDefinition]:
    """Return the checks of a recording's assets.

    The checks of the assets extracted from the recording are one operation, because each operation costs a run 0.1 s;
    each other asset has an operation of its own for its checks, since it may fail where the rest did not.
    They are partitioned, or one recording's pass would hide another's failure.
    """
    wanted, extracted = wanted_checks(recipe), recording_assets(recipe).extracted
    groups = {"recording_checks": {name: checks for name, checks in wanted.items() if name in extracted}}
    groups |= {f"{name}_checks": {name: checks} for name, checks in wanted.items() if name not in extracted}
    partitions = recording_partitions(recipe.bags, names)
    return [_operation(names, name, of, partitions) for name, of in groups.items() if any(of.values())]


def wanted_checks(recipe: Recipe) -> Checks:
    """Return the checks of a recording that the recipe does not skip."""
    return {
        asset.name: [one for one in asset.checks if severity_of(recipe.checks, one.section) != "skip"]
        for asset in recording_assets(recipe)
    }


def _operation(
    names: Naming, name: str, wanted: Checks, partitions: dg.PartitionsDefinition[str]
) -> dg.AssetChecksDefinition:
    """Return an operation that runs the checks of some assets."""

    @dg.multi_asset_check(
        name=names.spell(name),
        can_subset=True,
        required_resource_keys={names.workspace},
        specs=[
            dg.AssetCheckSpec(
                check.name, asset=names.key(asset), description=check.description, partitions_def=partitions
            )
            for asset, checks in wanted.items()
            for check in checks
        ],
    )
    def run(context: dg.AssetCheckExecutionContext) -> Iterator[dg.AssetCheckResult]:
        workspace = Workspace.of(context, names.workspace)
        selected = {(names.asset_of(key.asset_key), key.name) for key in context.selected_asset_check_keys}
        chosen = {
            asset: [check for check in checks if (asset, check.name) in selected]
            for asset, checks in wanted.items()
        }
        with errors_explained():
            recording = workspace.recording(context.partition_key)
            verdicts = run_checks(workspace, recording, chosen, partial(workspace.artifact, context))
            yield from map(partial(_result, names), verdicts)

    return run


def check_recording(
    recorder: Recorder, recording: RecordingFiles, assets: Collection[str], kept: KeptVerdicts | None = None
) -> Iterator[dg.AssetCheckResult]:
    """Yield the results of the checks of assets that were recorded; see `run_checks`. If these are all, they are `kept`."""
    workspace, verdicts = recorder.workspace, list[Verdict]()
    if recorder.skipped:
        yield from _no_longer_red(recorder, wanted_checks(workspace.recipe))
        return
    wanted = {name: checks for name, checks in wanted_checks(workspace.recipe).items() if name in assets}
    for verdict in run_checks(workspace, recording, wanted, recorder.artifact):
        verdicts.append(verdict)
        yield _result(workspace.names, verdict)
    if kept is not None and recorder.made.issuperset(workspace.assets.names):
        kept.add(recording, recorder.artifacts, verdicts)


def _no_longer_red(recorder: Recorder, wanted: Checks) -> Iterator[dg.AssetCheckResult]:
    """Yield a result of each check that did not pass before the recording was skipped, and would stay red."""
    names = recorder.workspace.names
    keys = [dg.AssetCheckKey(names.key(asset), one.name) for asset, of in wanted.items() for one in of]
    storage = recorder.instance.event_log_storage
    for info in storage.get_asset_check_partition_info(keys, partition_keys=[recorder.key]):
        if info.latest_execution_status.value == FAILED:
            asset, name = info.check_key.asset_key, info.check_key.name
            said = "There is nothing to check, since the recording is skipped."
            yield dg.AssetCheckResult(asset_key=asset, check_name=name, passed=True, description=said)


def run_checks(
    workspace: Workspace, recording: RecordingFiles, wanted: Checks, artifact: Callable[[str], Artifact]
) -> Iterator[Verdict]:
    """Yield the verdicts of checks of a recording; there are none of one that is skipped.

    Args:
        workspace: recipe and store.
        recording: the recording.
        wanted: the checks, by asset.
        artifact: finds the current artifact of an asset of the recording.

    Raises:
        BagAssetsError: an artifact is missing.
    """
    rig = choose_rig(workspace.recipe, *recording.names)
    if rig is None or not any(wanted.values()):
        return
    evidence = Evidence(workspace.recipe, rig, workspace.store, artifact)
    if skip_reason(workspace.recipe, rig, evidence.inventory) is not None:
        return
    for asset, checks in wanted.items():
        for check in checks:
            severity = severity_of(evidence.checks, check.section)
            yield Verdict(recording.key, asset, check.name, severity, check.rule(evidence))


def dataset_checks(recipe: Recipe, names: Naming) -> list[dg.AssetChecksDefinition]:
    """Return the checks of the datasets on disk, one operation per dataset."""
    whole = (dataset for dataset in datasets_of(recipe).values() if dataset.selection is None)
    wanted = ((dataset, checking.dataset_checks(recipe, dataset.kind)) for dataset in whole)
    return [_dataset_operation(names, dataset, checks) for dataset, checks in wanted if checks]


def _dataset_operation(names: Naming, dataset: Dataset, wanted: Collection[str]) -> dg.AssetChecksDefinition:
    asset, kind = dataset.asset, dataset.kind

    @dg.multi_asset_check(
        name=names.spell(f"{asset}_checks"),
        required_resource_keys={names.workspace},
        specs=[
            dg.AssetCheckSpec(check.name, asset=names.key(asset), description=check.description)
            for check in kind.checks
            if check.name in wanted
        ],
    )
    def run(context: dg.AssetCheckExecutionContext) -> Iterator[dg.AssetCheckResult]:
        with errors_explained():
            yield from run_dataset_checks(Workspace.of(context, names.workspace), asset, wanted)

    return run


def run_dataset_checks(
    workspace: Workspace, asset: str, names: Collection[str] | None = None
) -> list[dg.AssetCheckResult]:
    """Return the results of checks of a dataset on disk: of those named, or all; none of a named dataset, or the map.

    Raises:
        DatasetError: a file of the dataset cannot be read.
    """
    dataset = datasets_of(workspace.recipe).get(asset)
    if dataset is None or dataset.selection is not None:
        return []
    severities = checking.dataset_checks(workspace.recipe, dataset.kind)
    names = severities.keys() if names is None else names
    findings = checking.check_dataset(dataset, frozenset(names), workspace.recipe.state)
    verdicts = [Verdict(None, asset, name, severities.get(name, "skip"), findings[name]) for name in names]
    return [_result(workspace.names, verdict) for verdict in verdicts]


def _result(names: Naming, verdict: Verdict) -> dg.AssetCheckResult:
    finding = verdict.finding or Finding()
    sentences = "\n".join(f"- {markdown(problem)}" for problem in finding.sentences[:MOST_SENTENCES])
    metadata: dict[str, dg.MetadataValue | int] = {"problems": len(finding.sentences)}
    if sentences:
        metadata["found"] = dg.MetadataValue.md(sentences)
    if finding.facts:
        metadata["facts"] = dg.MetadataValue.json(dict(finding.facts))
    return dg.AssetCheckResult(
        passed=finding.passed,
        asset_key=names.key(verdict.asset),
        check_name=verdict.check,
        severity=dg.AssetCheckSeverity.WARN if verdict.weight == "warn" else dg.AssetCheckSeverity.ERROR,
        description=None if finding.passed else visible(finding.sentences[0]),
        metadata=metadata,
    )
