"""All checks: their names, the assets they are about, and the rules behind them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bagassets.nuscenes.check import broken_references, duplicate_tokens
from bagassets.quality import dataset_rules
from bagassets.quality.box_rules import boxes_plausible
from bagassets.quality.calibration_rules import calibration_plausible
from bagassets.quality.channel_rules import channels_complete
from bagassets.quality.dataset_rows import DatasetRows, read_dataset
from bagassets.quality.devkit_rules import devkit_ready
from bagassets.quality.evidence import Evidence
from bagassets.quality.file_rules import files_match
from bagassets.quality.finding import Finding
from bagassets.quality.pose_rules import poses_cover_sensors
from bagassets.quality.scene_rules import keyframes_complete, scenes_made
from bagassets.quality.sweep_rules import sweeps_timed
from bagassets.quality.topic_rules import channels_present, stamps_monotonic, topic_rates
from bagassets.recipe.model_checks import Checks, Severity

__all__ = [
    "DATASET_CHECKS",
    "QUICK_CHECKS",
    "RECORDING_CHECKS",
    "DatasetCheck",
    "RecordingCheck",
    "check_dataset_now",
    "severity_of",
]


@dataclass(frozen=True)
class RecordingCheck:
    """A check of one asset of each recording.

    Attributes:
        name: unique; shown in Dagster.
        asset: what it is about.
        section: field of the recipe's `checks` with its severity and thresholds.
        description: what holds if it passes.
        rule: evidence -> what was found.
    """

    name: str
    asset: str
    section: str
    description: str
    rule: Callable[[Evidence], Finding]


@dataclass(frozen=True)
class DatasetCheck:
    """A check of the finished dataset; attributes as of `RecordingCheck`."""

    name: str
    section: str
    description: str
    rule: Callable[[DatasetRows], Finding]


RECORDING_CHECKS = (
    RecordingCheck(
        "channels_present",
        "inventory",
        "channels_present",
        "Every configured channel has readable messages in the recording.",
        lambda e: channels_present(e.rig, e.inventory, e.checks.channels_present),
    ),
    RecordingCheck(
        "topic_rates",
        "inventory",
        "topic_rates",
        "Topics of channels and poses keep to their rates and make no long pauses.",
        lambda e: topic_rates(e.rig, e.inventory, e.checks.topic_rates),
    ),
    RecordingCheck(
        "stamps_monotonic",
        "inventory",
        "stamps_monotonic",
        "Header stamps of channels and poses go forward and are near the log time.",
        lambda e: stamps_monotonic(e.rig, e.inventory, e.checks.stamps_monotonic),
    ),
    RecordingCheck(
        "calibration_plausible",
        "calibration",
        "calibration_plausible",
        "Sensors sit on the vehicle, cameras look out of it through real lenses.",
        lambda e: calibration_plausible(e.calibration, e.rig, e.checks.calibration_plausible),
    ),
    RecordingCheck(
        "boxes_plausible",
        "annotations",
        "boxes_plausible",
        "Few boxes were lost, tracks do not jump, sizes are those of things on roads.",
        lambda e: boxes_plausible(*e.boxes, e.checks.boxes_plausible),
    ),
    RecordingCheck(
        "frames_complete",
        "frames",
        "channels_present",
        "Every message read was written, merged or counted as lost, and every camera has images.",
        lambda e: channels_complete(e.channels("frames"), e.max_lost, e.clock_of),
    ),
    RecordingCheck(
        "sweeps_complete",
        "sweeps",
        "channels_present",
        "Every message read was written, merged or counted as lost, and every lidar and radar has files.",
        lambda e: channels_complete(e.channels("sweeps"), e.max_lost, e.clock_of),
    ),
    RecordingCheck(
        "scenes_made",
        "nuscenes_tables",
        "scenes_made",
        "The recording gives at least one scene.",
        lambda e: scenes_made(e.table_facts, e.stamps_of),
    ),
    RecordingCheck(
        "keyframes_complete",
        "nuscenes_tables",
        "keyframes_complete",
        "No keyframe was dropped for want of a channel, and no sample lacks one.",
        lambda e: keyframes_complete(e.table_facts, e.stamps_of),
    ),
    RecordingCheck(
        "poses_cover_sensors",
        "nuscenes_tables",
        "poses_cover_sensors",
        "Readings have an ego pose at their time, and the vehicle does not jump.",
        lambda e: poses_cover_sensors(e.trajectory, e.stamps_ns(), e.checks.poses_cover_sensors),
    ),
    RecordingCheck(
        "sweeps_timed",
        "nuscenes_tables",
        "sweeps_timed",
        "Clouds of lidars fit each other best with the poses of their own times.",
        lambda e: sweeps_timed(e.rig, e.sweeps(), e.trajectory, e.checks.sweeps_timed),
    ),
    RecordingCheck(
        "references_intact",
        "nuscenes_tables",
        "references_intact",
        "Every token that a row refers to exists; chains are closed, in order, and as long as they say.",
        lambda e: Finding(broken_references(e.tables), {name: len(rows) for name, rows in e.tables.items()}),
    ),
    RecordingCheck(
        "tokens_unique",
        "nuscenes_tables",
        "tokens_unique",
        "No token and no file name exists twice.",
        lambda e: Finding(duplicate_tokens(e.tables)),
    ),
    RecordingCheck(
        "files_match",
        "nuscenes_tables",
        "files_match",
        "The files that the tables name are in the store, whole, and no others are listed.",
        lambda e: files_match(e.tables["sample_data"], e.files, e.store.artifact),
    ),
)

QUICK_CHECKS = frozenset({"frames_complete", "sweeps_complete", "keyframes_complete"})
"""Checks that read counts, and stamps only where keyframes lack a channel: a moment for thousands of recordings."""

DATASET_CHECKS = (
    DatasetCheck(
        "dataset_references_intact",
        "references_intact",
        "Over all recordings, every token leads somewhere and chains are closed.",
        dataset_rules.references_intact,
    ),
    DatasetCheck(
        "dataset_tokens_unique",
        "tokens_unique",
        "Over all recordings, no token and no file name exists twice.",
        dataset_rules.tokens_unique,
    ),
    DatasetCheck(
        "dataset_files_match",
        "files_match",
        "The files below the dataroot are those that the tables name.",
        dataset_rules.files_match,
    ),
    DatasetCheck(
        "devkit_ready",
        "devkit_ready",
        "The dataset has what nuscenes-devkit and its users ask for: formats, units, maps, splits, layouts of files, all "
        "channels in every sample.",
        devkit_ready,
    ),
)


def severity_of(checks: Checks, section: str) -> Severity:
    """Return how much a finding of a section weighs; `skip` if checks are off altogether."""
    severity: Severity = getattr(checks, section).severity if checks.enabled else "skip"
    return severity


def check_dataset_now(dataroot: Path, version: str, checks: Checks) -> dict[str, Finding]:
    """Return check -> what it finds in a dataset on disk, of the checks that are not skipped.

    Raises:
        DatasetError: a table is missing or cannot be read.
    """
    rows = read_dataset(dataroot, version)
    return {
        check.name: check.rule(rows)
        for check in DATASET_CHECKS
        if severity_of(checks, check.section) != "skip"
    }
