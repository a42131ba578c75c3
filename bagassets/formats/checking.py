"""Running checks on the artifacts on record, without a Dagster run."""

from collections.abc import Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from bagassets.assets.quality.check import severity_of
from bagassets.assets.quality.evidence import Evidence
from bagassets.assets.quality.finding import Finding
from bagassets.assets.selection import choose_rig
from bagassets.base.cache import Kept
from bagassets.base.errors import PluginError, StoreError
from bagassets.base.fingerprints import PlanNeeded
from bagassets.base.json_types import JsonObject
from bagassets.engine.build_report import Remark
from bagassets.engine.freshness.artifacts import each_once, note_of
from bagassets.engine.freshness.published import Publication
from bagassets.engine.plan import BagPlan, KeptPlan, Plan
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.formats.catalogue import known_assets
from bagassets.formats.dataset_build import Dataset, datasets_of
from bagassets.formats.dataset_lock import LOCK
from bagassets.formats.format import AnyFormat, ByGroups
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_checks import Checks, Severity
from bagassets.recordings.discover import Discovery
from bagassets.recordings.model import RecordingFiles
from bagassets.store.artifact import Artifact
from bagassets.store.canonical import digest_json
from bagassets.store.store import Store

_VERDICTS = "verdicts"


@dataclass(frozen=True)
class Verdict:
    """The verdict of one check.

    Attributes:
        recording: partition key; None for the dataset.
        asset: the checked asset.
        check: name of the check.
        severity: severity of a finding.
        finding: its finding; None if the asset is not materialized.
    """

    recording: str | None
    asset: str
    check: str
    severity: Severity
    finding: Finding | None

    @property
    def is_error(self) -> bool:
        """Tell whether the check failed with the severity of an error."""
        return self.finding is not None and not self.finding.passed and self.weight == "error"

    @property
    def weight(self) -> Severity:
        """Severity of the finding."""
        return (
            self.severity
            if self.finding is None or self.finding.passed
            else self.finding.weight(self.severity)
        )

    def as_json(self) -> JsonObject:
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
    assets: RecordingAssets, discovery: Discovery, bag: BagPlan, *, quick: bool = False
) -> Iterator[Verdict]:
    """Check the artifacts of one recording; a skipped recording has no verdicts.

    Args:
        assets: the assets of recordings under the recipe, which has the thresholds.
        discovery: the recordings on disk.
        bag: the recording.
        quick: run only those checks that take no time, on artifacts that are of its files and the recipe as they are now.
    """
    recipe, recording = assets.recipe, discovery.recordings.get(bag.key)
    rig = None if recording is None else choose_rig(recipe, *recording.names)
    if rig is None or bag.skipped is not None:
        return
    evidence = Evidence(recipe, rig, assets.store, partial(_artifact_on_record, assets.store, bag))
    for asset in assets:
        for check in asset.checks:
            severity = severity_of(recipe.checks, check.section)
            if severity == "skip" or (quick and not check.quick):
                continue
            finding = None
            is_old = quick and bag.assets[asset.name].state not in {"fresh", "record-only"}
            if asset.name in bag.recorded and not is_old:
                try:
                    finding = check.rule(evidence)
                except StoreError as err:
                    finding = Unchecked([str(err)])
                except PluginError as err:  # as long as its code is the same, so is this
                    finding = Finding([str(err)])
            yield Verdict(bag.key, asset.name, check.name, severity, finding)


class Unchecked(Finding):
    """What is said of a check that could not run, as an artifact could not be read."""


class KeptVerdicts(Kept):
    """Verdicts about recordings in the project's cache; they hold while code, recipe and artifacts stay as they were.

    Args:
        recipe: the recipe.
        project: fingerprint of the code, the recipe and the files that it names; None if that is not known.
    """

    def __init__(self, recipe: Recipe, project: str | None) -> None:
        super().__init__(recipe.state, _VERDICTS)
        self._artifacts, self._project = f"{recipe.store_path}/artifacts", project

    def verdicts(self, recording: RecordingFiles, made: bytes) -> list[Verdict] | None:
        """Return the verdicts about a recording if its artifacts are as noted (see `note_of`); None if there are none."""
        rows = self.find(recording.key, self._mark(recording, made))
        return rows and [
            Verdict(recording.key, asset, check, severity, found and Finding(**found))
            for asset, check, severity, found in rows
        ]

    def add(self, recording: RecordingFiles, artifacts: Iterable[str], verdicts: Iterable[Verdict]) -> None:
        """Keep the verdicts of all checks of a recording, with its artifacts (digests) as they are now.

        Nothing is kept if a check could not run: next time, the disk or file server may answer.
        """
        verdicts = list(verdicts)
        if not could_run(verdicts):
            return
        rows = [[one.asset, one.check, one.severity, one.finding and vars(one.finding)] for one in verdicts]
        with suppress(PlanNeeded):  # one is gone
            self.keep(recording.key, self._mark(recording, note_of(self._artifacts, artifacts)), rows)

    def _mark(self, recording: RecordingFiles, made: bytes) -> bytes:
        return digest_json([self._project, recording.names, each_once(made).hex()]).encode()


def check_bags(
    assets: RecordingAssets, plan: Plan, bags: Iterable[BagPlan]
) -> Iterator[tuple[str, list[Verdict]]]:
    """Yield key and verdicts of recordings; of those that have not changed since they were checked, as they were then."""
    kept, recordings = KeptVerdicts(assets.recipe, plan.project), plan.discovery.recordings
    with kept.cache.kept_open():
        for bag in bags:
            # Of other plans, nobody has looked at the artifacts.
            known = kept.verdicts(recordings[bag.key], bag.made) if isinstance(bag, KeptPlan) else None
            found = [*check_bag(assets, plan.discovery, bag)] if known is None else known
            if known is None and isinstance(bag, KeptPlan):
                kept.add(recordings[bag.key], bag.artifacts, found)
            yield bag.key, found
    kept.write()


def remarks_on_record(
    assets: RecordingAssets, discovery: Discovery, bags: Iterable[BagPlan]
) -> Iterator[Remark]:
    """Yield the findings of quick checks on recordings built earlier, such as losses and dropped keyframes."""
    for bag in bags:
        found = bag.findings
        for one in _problems(check_bag(assets, discovery, bag, quick=True)) if found is None else found:
            yield Remark(bag.key, *one)


def findings_to_keep(
    assets: RecordingAssets, discovery: Discovery, bag: BagPlan
) -> tuple[tuple[str, str, str], ...] | None:
    """Return what quick checks find in a recording (`BagPlan.findings`); None if one could not run."""
    verdicts = [*check_bag(assets, discovery, bag, quick=True)]
    return _problems(verdicts) if could_run(verdicts) else None


def could_run(verdicts: Iterable[Verdict]) -> bool:
    """Return whether all checks could run."""
    return not any(isinstance(one.finding, Unchecked) for one in verdicts)


def _problems(verdicts: Iterable[Verdict]) -> tuple[tuple[str, str, str], ...]:
    found = []
    for verdict in verdicts:
        if verdict.finding is not None and not verdict.finding.passed:
            first, *more = verdict.finding.sentences
            problem = first + (f" (and {len(more)} more)" if more else "")
            found.append((str(verdict.weight), verdict.check, problem))
    return tuple(found)


def render_checks() -> str:
    """Return the checks of recordings' assets as a Markdown table, with default severities."""
    defaults = Checks()
    rows = [
        f"| `{check.name}` | `{asset.name}` | {check.fails_if} | {severity_of(defaults, check.section)} |"
        for asset in known_assets()
        for check in asset.checks
    ]
    return "\n".join(["| check | asset | fails if | severity |", "|---|---|---|---|", *rows]) + "\n"


def check_datasets(recipe: Recipe) -> Iterator[Verdict]:
    """Check the whole datasets on disk, one per format.

    Raises:
        DatasetError: a file of a dataset cannot be read.
    """
    for dataset in datasets_of(recipe).values():
        if dataset.selection is None:
            names = dataset_checks(recipe, dataset.kind)
            is_there = names and (dataset.folder / LOCK).exists()
            findings = check_dataset(dataset, frozenset(names), recipe.state) if is_there else {}
            for name, severity in names.items():
                yield Verdict(None, dataset.asset, name, severity, findings.get(name))


def dataset_checks(recipe: Recipe, kind: AnyFormat) -> dict[str, Severity]:
    """Return the checks of a format that the recipe does not skip -> severity."""
    weights = {check.name: severity_of(recipe.checks, check.section) for check in kind.checks}
    return {name: severity for name, severity in weights.items() if severity != "skip"}


def check_dataset(
    dataset: Dataset, names: AbstractSet[str], state: Path | None = None
) -> Mapping[str, Finding]:
    """Run the named checks on a dataset on disk; return check -> finding.

    Args:
        dataset: the dataset.
        names: names of the checks.
        state: the state folder, which has on record what earlier checks have found; None has everything read.

    Raises:
        DatasetError: a file of the dataset cannot be read.
    """
    kind = dataset.kind
    if kind.check is None:
        return {}
    if state is None or not isinstance(kind.join, ByGroups):
        return kind.check(dataset.settings, names)
    return kind.check(dataset.settings, names, Publication(state, dataset.asset))


def _artifact_on_record(store: Store, bag: BagPlan, asset: str) -> Artifact:
    if asset not in bag.recorded:
        raise StoreError(f"{bag.key}: {asset} is not materialized for this recording.")
    return store.artifact(bag.recorded[asset])
