"""Asset checks in the recipe: how much each finding weighs, and the thresholds.

Thresholds shape no artifact: changing one makes nothing stale.
"""

from typing import Literal, Self

from pydantic import Field, model_validator

from bagassets.recipe.model_base import ChannelName, FieldValueError, Model, TopicName

__all__ = ["Checks", "Severity", "TopicLimits"]

Severity = Literal["error", "warn", "skip"]

_SEVERITY = "How much a finding weighs: error, warn, or skip for no check at all."


class Check(Model):
    """A check without thresholds."""

    severity: Severity = Field("error", description=_SEVERITY)


class ChannelsCheck(Model):
    """Configured channels are there: messages in the recording, files made from them."""

    severity: Severity = Field("error", description=_SEVERITY)
    optional: tuple[ChannelName, ...] = Field((), description="Channels that a recording may lack.")
    max_lost: float | None = Field(
        None,
        ge=0,
        le=1,
        description="Share of a channel's messages that may be lost without a finding; default: limits.reported_losses.",
    )


class TopicLimits(Model):
    """What is expected of one topic, by log time."""

    min_hz: float | None = Field(None, gt=0, description="Lowest mean rate.")
    max_hz: float | None = Field(None, gt=0, description="Highest mean rate.")
    max_gap_s: float | None = Field(None, gt=0, description="Longest pause; default: that of all topics.")
    required: bool = Field(False, description="A recording without the topic is a finding.")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min_hz is not None and self.max_hz is not None and self.min_hz > self.max_hz:
            raise FieldValueError(("min_hz",), "must not be greater than max_hz")
        return self


class TopicsCheck(Model):
    """Rates and pauses of topics: those of the channels, of the poses, and those named here."""

    severity: Severity = Field("warn", description=_SEVERITY)
    max_gap_s: float = Field(1.0, gt=0, description="Longest pause of any of the topics.")
    limits: dict[TopicName, TopicLimits] = Field(default_factory=dict, description="Topic -> its own limits.")


class StampsCheck(Model):
    """Header stamps go forward."""

    severity: Severity = Field("warn", description=_SEVERITY)
    max_backward: int = Field(0, ge=0, description="Messages of a topic whose stamp may go back in time.")
    max_offset_s: float = Field(
        60.0, gt=0, description="Header stamps may be this far from the log time (median of a topic)."
    )


class PosesCheck(Model):
    """Readings of the sensors have an ego pose at their time."""

    severity: Severity = Field("error", description=_SEVERITY)
    min_share: float = Field(
        0.99, ge=0, le=1, description="Share of each channel's readings that must have a pose."
    )
    max_speed_mps: float = Field(
        70.0, gt=0, description="A faster move between two poses is a jump, not a drive."
    )


class SweepTimesCheck(Model):
    """Clouds of lidars fit each other best with the poses of their own times."""

    severity: Severity = Field("warn", description=_SEVERITY)
    min_gain: float = Field(
        0.05,
        gt=0,
        lt=1,
        description="Share by which clouds must fit each other better with the poses of other times for a finding.",
    )


class CalibrationCheck(Model):
    """Extrinsics and intrinsics are those of a vehicle with real lenses."""

    severity: Severity = Field("warn", description=_SEVERITY)
    max_distance_m: float = Field(10.0, gt=0, description="Farthest that a sensor sits from the ego frame.")
    max_tilt_deg: float = Field(
        60.0,
        gt=0,
        le=90,
        description="Steepest look of a camera up or down; a frame that is not optical looks straight up.",
    )
    min_view_deg: float = Field(5.0, gt=0, description="Narrowest horizontal field of view of a camera.")
    max_view_deg: float = Field(200.0, gt=0, description="Widest horizontal field of view of a camera.")
    max_aspect: float = Field(1.1, ge=1, description="Greatest ratio of the focal lengths fx and fy.")
    max_offset: float = Field(
        0.2,
        gt=0,
        description="Principal point's distance from the image centre, as share of width or height.",
    )


class BoxesCheck(Model):
    """Boxes were understood, and are those of things that move on roads."""

    severity: Severity = Field("warn", description=_SEVERITY)
    max_lost: float = Field(
        0.01, ge=0, le=1, description="Share of a source's boxes that may be lost without a finding."
    )
    max_speed_mps: float = Field(60.0, gt=0, description="A track that moves faster jumps.")
    noise_m: float = Field(
        0.5, ge=0, description="Labels may be this far off, whatever the time between them."
    )
    min_size_m: float = Field(0.05, ge=0, description="Smallest width, length or height.")
    max_size_m: float = Field(40.0, gt=0, description="Greatest width, length or height.")


class Checks(Model):
    """Checks of finished assets, shown in Dagster per recording and for the dataset."""

    enabled: bool = Field(True, description="Make checks at all.")
    channels_present: ChannelsCheck = Field(ChannelsCheck(), description="Configured channels are there.")
    topic_rates: TopicsCheck = Field(TopicsCheck(), description="Rates and pauses of topics.")
    stamps_monotonic: StampsCheck = Field(StampsCheck(), description="Header stamps go forward.")
    calibration_plausible: CalibrationCheck = Field(
        CalibrationCheck(), description="Extrinsics and intrinsics make sense."
    )
    boxes_plausible: BoxesCheck = Field(BoxesCheck(), description="Boxes were understood and make sense.")
    poses_cover_sensors: PosesCheck = Field(PosesCheck(), description="Readings have an ego pose.")
    sweeps_timed: SweepTimesCheck = Field(
        SweepTimesCheck(), description="Clouds fit each other best with the poses of their own times."
    )
    scenes_made: Check = Field(Check(severity="warn"), description="A recording gives at least one scene.")
    keyframes_complete: Check = Field(
        Check(severity="warn"),
        description="No keyframe was dropped for want of a channel; no sample lacks one.",
    )
    references_intact: Check = Field(Check(), description="Tokens, chains and counts of the tables agree.")
    tokens_unique: Check = Field(Check(), description="No token and no file name exists twice.")
    files_match: Check = Field(Check(), description="Files on disk are those that the tables name.")
    devkit_ready: Check = Field(Check(), description="The dataset has what nuscenes-devkit asks for.")
