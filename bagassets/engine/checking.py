"""Running the checks now, on what is on record, without a run in Dagster."""

from collections.abc import Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Any

from bagassets.bags.discover import Discovery
from bagassets.engine.build_report import Remark
from bagassets.engine.plan_model import BagPlan
from bagassets.errors import StoreError
from bagassets.nuscenes.dataset import read_lock
from bagassets.quality.catalogue import (
    DATASET_CHECKS,
    QUICK_CHECKS,
    RECORDING_CHECKS,
    check_dataset_now,
    severity_of,
)
from bagassets.quality.evidence import Evidence
from bagassets.quality.finding import Finding
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_checks import Severity
from bagassets.steps.selection import choose_rig
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store

__all__ = ["Verdict", "check_bag", "check_nuscenes", "remarks_on_record"]


@dataclass(frozen=True)
class Verdict:
    """What one check said.

    Attributes:
        recording: partition key; None for the dataset.
        asset: what was checked.
        check: name of the check.
        severity: how much a finding weighs.
        finding: what was found; None if the asset is not materialized.
    """

    recording: str | None
    asset: str
    check: str
    severity: Severity
    finding: Finding | None

    @property
    def is_error(self) -> bool:
        """Tell whether something was found that weighs as an error."""
        return self.finding is not None and not self.finding.passed and self.weight == "error"

    @property
    def weight(self) -> Severity:
        """How much what was found weighs."""
        return (
            self.severity
            if self.finding is None or self.finding.passed
            else self.finding.weight(self.severity)
        )

    def as_json(self) -> dict[str, Any]:
        """Return the verdict as JSON."""
        return {
            "recording": self.recording,
            "asset": self.asset,
            "check": self.check,
            "severity": self.weight,
            "passed": None if self.finding is None else self.finding.passed,
            "problems": [] if self.finding is None else self.finding.sentences,
            "facts": {} if self.finding is None else dict(self.finding.facts),
        }


def check_bag(
    recipe: Recipe,
    store: Store,
    discovery: Discovery,
    bag: BagPlan,
    only: AbstractSet[str] | None = None,
) -> Iterator[Verdict]:
    """Check what is on record of one recording; nothing is said about one that is skipped.

    Args:
        recipe: the recipe, with the thresholds.
        store: where the artifacts are.
        discovery: the recordings on disk.
        bag: the recording.
        only: names of the checks to make; None = all.
    """
    found = discovery.found.get(bag.key)
    rig = None if found is None else choose_rig(recipe, found.relative)
    if rig is None or bag.skipped is not None:
        return
    evidence = Evidence(recipe, rig, store, _Current(bag.key, store, bag.recorded).artifact)
    for check in RECORDING_CHECKS:
        severity = severity_of(recipe.checks, check.section)
        if severity == "skip" or (only is not None and check.name not in only):
            continue
        finding = None
        if check.asset in bag.recorded:
            try:
                finding = check.rule(evidence)
            except StoreError as err:
                finding = Finding([str(err)])
        yield Verdict(bag.key, check.asset, check.name, severity, finding)


def remarks_on_record(
    recipe: Recipe, store: Store, discovery: Discovery, bags: Iterable[BagPlan]
) -> Iterator[Remark]:
    """Yield what the quick checks find in recordings that were built some time: losses, keyframes that were dropped."""
    for bag in bags:
        for verdict in check_bag(recipe, store, discovery, bag, QUICK_CHECKS):
            if verdict.finding is not None and not verdict.finding.passed:
                first, *more = verdict.finding.sentences
                yield Remark(
                    bag.key,
                    verdict.weight,
                    verdict.check,
                    first + (f" (and {len(more)} more)" if more else ""),
                )


def check_nuscenes(recipe: Recipe) -> Iterator[Verdict]:
    """Check the nuScenes dataset as it lies on disk.

    Raises:
        DatasetError: a table cannot be read.
    """
    settings = recipe.nuscenes
    findings: Mapping[str, Finding] = {}
    if read_lock(settings.output, settings.version) is not None:
        findings = check_dataset_now(settings.output, settings.version, recipe.checks)
    for check in DATASET_CHECKS:
        severity = severity_of(recipe.checks, check.section)
        if severity != "skip":
            yield Verdict(None, "nuscenes_dataset", check.name, severity, findings.get(check.name))


@dataclass(frozen=True)
class _Current:
    """The artifacts that are on record for one recording."""

    key: str
    store: Store
    recorded: Mapping[str, str]

    def artifact(self, asset: str) -> Artifact:
        if asset not in self.recorded:
            raise StoreError(f"{self.key}: {asset} is not materialized for this recording.")
        return self.store.artifact(self.recorded[asset])
