"""Asset checks: the rules of `bagassets.quality`, shown per recording and for the dataset."""

from collections.abc import Iterator, Sequence

import dagster as dg

from bagassets.defs.reporting import failures_in_words
from bagassets.defs.workspace import Workspace, recording_partitions
from bagassets.errors import RecipeError
from bagassets.escaping import markdown, visible
from bagassets.quality.catalogue import (
    DATASET_CHECKS,
    RECORDING_CHECKS,
    RecordingCheck,
    check_dataset_now,
    severity_of,
)
from bagassets.quality.evidence import Evidence
from bagassets.quality.finding import Finding
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_checks import Severity
from bagassets.steps.selection import choose_rig

__all__ = ["dataset_checks", "recording_checks"]

MOST_SENTENCES = 20
DATASET = "nuscenes_dataset"


def recording_checks(recipe: Recipe) -> list[dg.AssetChecksDefinition]:
    """Return the checks of a recording's assets.

    They are partitioned, or one recording's pass would hide another's failure. The checks of
    what is read from the recording are one operation and those of its tables another, because
    each operation costs a run 0.1 s, and tables may fail where the rest did not.
    """
    wanted = [check for check in RECORDING_CHECKS if severity_of(recipe.checks, check.section) != "skip"]
    of_tables = [check for check in wanted if check.asset == "nuscenes_tables"]
    of_extracts = [check for check in wanted if check.asset != "nuscenes_tables"]
    groups = (("recording_checks", of_extracts), ("tables_checks", of_tables))
    return [_operation(recipe, name, checks) for name, checks in groups if checks]


def _operation(recipe: Recipe, name: str, checks: Sequence[RecordingCheck]) -> dg.AssetChecksDefinition:
    partitions = recording_partitions(recipe)

    @dg.multi_asset_check(
        name=name,
        can_subset=True,
        specs=[
            dg.AssetCheckSpec(
                check.name, asset=check.asset, description=check.description, partitions_def=partitions
            )
            for check in checks
        ],
    )
    def run(context: dg.AssetCheckExecutionContext, workspace: Workspace) -> Iterator[dg.AssetCheckResult]:
        selected = {(key.asset_key.to_user_string(), key.name) for key in context.selected_asset_check_keys}
        with failures_in_words():
            evidence = _evidence(context, workspace)
            for check in checks:
                if (check.asset, check.name) in selected:
                    severity = severity_of(evidence.checks, check.section)
                    yield _result(check.asset, check.name, check.rule(evidence), severity)

    return run


def _evidence(context: dg.AssetCheckExecutionContext, workspace: Workspace) -> Evidence:
    found = workspace.found(context.partition_key)
    rig = choose_rig(workspace.recipe, found.relative)
    if rig is None:
        raise RecipeError(f"{found.relative}: no rig of the recipe matches; correct rigs[].match.")
    return Evidence(workspace.recipe, rig, workspace.store, lambda asset: workspace.artifact(context, asset))


def dataset_checks(recipe: Recipe) -> list[dg.AssetChecksDefinition]:
    """Return the checks of the dataset as it lies on disk."""
    wanted = [check for check in DATASET_CHECKS if severity_of(recipe.checks, check.section) != "skip"]
    if not wanted:
        return []

    @dg.multi_asset_check(
        name="dataset_checks",
        specs=[
            dg.AssetCheckSpec(check.name, asset=DATASET, description=check.description) for check in wanted
        ],
    )
    def run(workspace: Workspace) -> Iterator[dg.AssetCheckResult]:
        settings, checks = workspace.recipe.nuscenes, workspace.recipe.checks
        with failures_in_words():
            findings = check_dataset_now(settings.output, settings.version, checks)
        for check in wanted:
            severity = severity_of(checks, check.section)
            yield _result(DATASET, check.name, findings[check.name], severity)

    return [run]


def _result(asset: str, name: str, finding: Finding, severity: Severity) -> dg.AssetCheckResult:
    sentences = "\n".join(f"- {markdown(problem)}" for problem in finding.sentences[:MOST_SENTENCES])
    metadata: dict[str, dg.MetadataValue | int] = {"problems": len(finding.sentences)}
    if sentences:
        metadata["found"] = dg.MetadataValue.md(sentences)
    weight = severity if finding.passed else finding.weight(severity)
    if finding.facts:
        metadata["facts"] = dg.MetadataValue.json(dict(finding.facts))
    return dg.AssetCheckResult(
        passed=finding.passed,
        asset_key=asset,
        check_name=name,
        severity=dg.AssetCheckSeverity.WARN if weight == "warn" else dg.AssetCheckSeverity.ERROR,
        description=None if finding.passed else visible(finding.sentences[0]),
        metadata=metadata,
    )
