"""Recipe sections about checks: severities and thresholds.

They shape no artifact, so changing one makes nothing stale.
"""

from typing import Literal, Self

from pydantic import Field, model_validator

from bagassets.recipe.model_base import FieldValueError, Model, TopicName
from bagassets.recipe.model_signals import SignalName

Severity = Literal["error", "warn", "skip"]

_SEVERITY = "Severity of a finding: error, warn, or skip to disable the check."


class Check(Model):
    """A check without thresholds, whose findings are errors."""

    severity: Severity = Field("error", description=_SEVERITY)


class WarningCheck(Model):
    """A check without thresholds, whose findings are warnings."""

    severity: Severity = Field("warn", description=_SEVERITY)


class ChannelsCheck(Check):
    """Configured channels and signals have messages in the recording, and files made from them."""

    optional: tuple[SignalName, ...] = Field(
        (), description="Channels and signals that a recording may lack."
    )
    max_lost: float | None = Field(
        None,
        ge=0,
        le=1,
        description="Share of a channel's messages that may be lost; default: limits.reported_losses.",
    )


class TopicLimits(Model):
    """Expected rate and pauses of one topic, by log time."""

    min_hz: float | None = Field(None, gt=0, description="Lowest mean rate.")
    max_hz: float | None = Field(None, gt=0, description="Highest mean rate.")
    max_gap_s: float | None = Field(
        None, gt=0, description="Longest pause; default: `max_gap_s` of all topics."
    )
    required: bool = Field(False, description="A recording without the topic is a finding.")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min_hz is not None and self.max_hz is not None and self.min_hz > self.max_hz:
            raise FieldValueError(("min_hz",), "must not be greater than max_hz")
        return self


class TopicsCheck(WarningCheck):
    """Rates and pauses of topics: those of channels and poses, and those named here."""

    max_gap_s: float = Field(1.0, gt=0, description="Longest pause of any topic.")
    limits: dict[TopicName, TopicLimits] = Field(default_factory=dict, description="Topic -> its own limits.")


class StampsCheck(WarningCheck):
    """Header stamps go forward."""

    max_backward: int = Field(
        0, ge=0, description="Number of messages of a topic whose stamps may go back in time."
    )
    max_offset_s: float = Field(
        60.0, gt=0, description="Largest difference between header stamps and log times (median of a topic)."
    )
    max_apart_s: float = Field(2.0, gt=0, description="Largest difference between two topics in that.")


class SignalLimits(Model):
    """Expected gaps and values of one signal."""

    min: float | None = Field(None, description="Smallest value of its elements.")
    max: float | None = Field(None, description="Largest value of its elements.")
    max_gap_s: float | None = Field(
        None, gt=0, description="Longest time without a value; default: `max_gap_s` of all signals."
    )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min is not None and self.max is not None and self.min > self.max:
            raise FieldValueError(("min",), "must not be greater than max")
        return self


class SignalsCheck(WarningCheck):
    """Elements of signals have values all the time."""

    max_gap_s: float = Field(1.0, gt=0, description="Longest time without a value of an element.")
    max_empty: float = Field(
        0.01, ge=0, le=1, description="Share of the messages of a signal that may lack an element."
    )
    max_backward_s: float = Field(1.0, ge=0, description="How far stamps may go back in time.")
    limits: dict[SignalName, SignalLimits] = Field(
        default_factory=dict, description="Signal -> its own limits."
    )


class PosesCheck(Check):
    """Readings of the sensors have an ego pose at their time."""

    min_share: float = Field(
        0.99, ge=0, le=1, description="Share of each channel's readings that must have a pose."
    )
    max_speed_mps: float = Field(70.0, gt=0, description="A faster movement between two poses is a jump.")


class SweepTimesCheck(WarningCheck):
    """Lidar clouds match best with the ego poses at their own stamps."""

    min_gain: float = Field(
        0.05,
        gt=0,
        lt=1,
        description="Share by which clouds must match better with ego poses at other times.",
    )


class CalibrationCheck(WarningCheck):
    """Extrinsics and intrinsics are plausible for a vehicle with real lenses."""

    max_distance_m: float = Field(10.0, gt=0, description="Largest distance of a sensor from the ego frame.")
    max_tilt_deg: float = Field(
        60.0,
        gt=0,
        le=90,
        description="Steepest view of a camera up or down; in a frame that is not optical it looks straight up.",
    )
    min_view_deg: float = Field(5.0, gt=0, description="Narrowest horizontal field of view of a camera.")
    max_view_deg: float = Field(200.0, gt=0, description="Widest horizontal field of view of a camera.")
    max_aspect: float = Field(1.1, ge=1, description="Largest ratio of the focal lengths fx and fy.")
    max_offset: float = Field(
        0.2,
        gt=0,
        description="Largest distance of the principal point from the image centre, as a share of width or height.",
    )


class BoxesCheck(WarningCheck):
    """Boxes were decoded, and are plausible for road users."""

    max_lost: float = Field(0.01, ge=0, le=1, description="Share of a source's boxes that may be lost.")
    max_speed_mps: float = Field(60.0, gt=0, description="A faster movement of a track is a jump.")
    noise_m: float = Field(
        0.5, ge=0, description="Labels may be off by this much, however close in time they are."
    )
    min_size_m: float = Field(0.05, ge=0, description="Smallest width, length or height.")
    max_size_m: float = Field(40.0, gt=0, description="Largest width, length or height.")


class Checks(Model):
    """Checks of finished assets, shown in Dagster per recording and for the dataset."""

    enabled: bool = Field(True, description="Run checks.")
    recording_whole: WarningCheck = Field(WarningCheck(), description="Nothing of a recording is damaged.")
    channels_present: ChannelsCheck = Field(
        ChannelsCheck(), description="Configured channels have messages and files."
    )
    topic_rates: TopicsCheck = Field(TopicsCheck(), description="Rates and pauses of topics.")
    stamps_monotonic: StampsCheck = Field(StampsCheck(), description="Header stamps go forward.")
    signal_values: SignalsCheck = Field(
        SignalsCheck(), description="Signals have values all the time, and plausible ones."
    )
    calibration_plausible: CalibrationCheck = Field(
        CalibrationCheck(), description="Extrinsics and intrinsics are plausible."
    )
    boxes_plausible: BoxesCheck = Field(BoxesCheck(), description="Boxes were decoded and are plausible.")
    poses_cover_sensors: PosesCheck = Field(PosesCheck(), description="Readings have an ego pose.")
    sweeps_timed: SweepTimesCheck = Field(
        SweepTimesCheck(), description="Lidar clouds match best with the ego poses at their own stamps."
    )
    radar_velocities: WarningCheck = Field(
        WarningCheck(), description="Radar targets that stand still have no velocity over ground."
    )
    scenes_made: WarningCheck = Field(WarningCheck(), description="A recording has at least one scene.")
    keyframes_complete: WarningCheck = Field(
        WarningCheck(),
        description="No keyframe was dropped because a channel is missing; no sample lacks a channel.",
    )
    references_intact: Check = Field(Check(), description="Tokens, chains and counts of the tables agree.")
    tokens_unique: Check = Field(Check(), description="No token and no file name exists twice.")
    files_match: Check = Field(Check(), description="Files on disk are exactly those in the tables.")
    devkit_ready: Check = Field(Check(), description="The dataset meets the requirements of nuscenes-devkit.")
