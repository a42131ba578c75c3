"""Which readings make up which scene: keyframes, their readings, and the sample of every other reading."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bagassets.timeline.keyframes import Stamps, choose_keyframes, match_readings, owning_keyframe
from bagassets.timeline.scenes import SceneSpan, cut_scenes

__all__ = ["ChannelPlan", "RecordingPlan", "SceneParams", "ScenePlan", "plan_scenes"]


@dataclass(frozen=True)
class SceneParams:
    """The recipe's scenes, in integer nanoseconds."""

    reference: str
    period_ns: int
    length_ns: int
    min_length_ns: int
    tolerance_ns: int
    box_gap_ns: int
    refuse_incomplete: bool

    @classmethod
    def from_json(cls, params: Mapping[str, Any]) -> "SceneParams":
        """Return the parameters of a `request`."""

        def ns(name: str) -> int:
            return round(float(params[name]) * 1e9)

        return cls(
            reference=params["reference"],
            period_ns=round(1e9 / params["keyframe_hz"]),
            length_ns=ns("length_s"),
            min_length_ns=ns("min_length_s"),
            tolerance_ns=ns("tolerance_s"),
            box_gap_ns=ns("box_gap_s"),
            refuse_incomplete=params["missing"] == "refuse",
        )


@dataclass(frozen=True, eq=False)
class ChannelPlan:
    """The readings of one channel in one scene.

    Attributes:
        readings: (N,) indices into the channel's readings, increasing.
        sample: (N,) keyframe that each belongs to.
        is_keyframe: (N,) whether it is the reading of that keyframe itself.
    """

    readings: NDArray[np.intp]
    sample: NDArray[np.intp]
    is_keyframe: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ScenePlan:
    """One scene.

    Attributes:
        span: its time.
        keyframes_ns: (K,) stamps of its samples, K >= 1.
        channels: channel -> its readings.
    """

    span: SceneSpan
    keyframes_ns: Stamps
    channels: Mapping[str, ChannelPlan]


@dataclass
class RecordingPlan:
    """The scenes of a recording, and what became of the rest.

    Attributes:
        scenes: in order.
        remainder_s: time at the end that was too short for a scene.
        empty_scenes: scenes left out because no keyframe was found in them.
        refused_keyframes: keyframes left out because they lack a channel.
        missing: channel -> keyframes that have no reading of it.
    """

    scenes: list[ScenePlan] = field(default_factory=list)
    remainder_s: float = 0.0
    empty_scenes: int = 0
    refused_keyframes: int = 0
    missing: dict[str, int] = field(default_factory=dict)


def plan_scenes(stamps_ns: Mapping[str, Stamps], params: SceneParams) -> RecordingPlan:
    """Cut a recording into scenes by the readings of its reference channel.

    Args:
        stamps_ns: channel -> stamps of its readings, strictly increasing.
        params: the recipe's scenes.
    """
    plan = RecordingPlan(missing=dict.fromkeys(sorted(stamps_ns), 0))
    reference = stamps_ns[params.reference]
    if not len(reference):
        return plan
    cuts = cut_scenes(
        int(reference[0]), int(reference[-1]), params.length_ns, params.min_length_ns, params.period_ns
    )
    plan.remainder_s = cuts.remainder_ns / 1e9
    for span in cuts.scenes:
        scene = _plan_scene(span, stamps_ns, params, plan)
        if scene is None:
            plan.empty_scenes += 1
        else:
            plan.scenes.append(scene)
    return plan


def _plan_scene(
    span: SceneSpan, stamps_ns: Mapping[str, Stamps], params: SceneParams, plan: RecordingPlan
) -> ScenePlan | None:
    inside = {channel: _window(stamps, span) for channel, stamps in stamps_ns.items()}
    reference = stamps_ns[params.reference][inside[params.reference]]
    keyframes = reference[choose_keyframes(reference, span.start_ns, span.end_ns, params.period_ns)]
    if params.refuse_incomplete:
        complete = np.ones(len(keyframes), dtype=np.bool_)
        for channel, stamps in stamps_ns.items():
            complete &= match_readings(keyframes, stamps[inside[channel]], params.tolerance_ns) >= 0
        plan.refused_keyframes += int(np.count_nonzero(~complete))
        keyframes = keyframes[complete]
    if not len(keyframes):
        return None
    channels = {}
    for channel, stamps in sorted(stamps_ns.items()):
        readings = stamps[inside[channel]]
        matched = match_readings(keyframes, readings, params.tolerance_ns)
        plan.missing[channel] += int(np.count_nonzero(matched < 0))
        sample = owning_keyframe(keyframes, readings)
        is_keyframe = np.zeros(len(readings), dtype=np.bool_)
        is_keyframe[matched[matched >= 0]] = True
        sample[matched[matched >= 0]] = np.flatnonzero(matched >= 0)
        channels[channel] = ChannelPlan(inside[channel], sample, is_keyframe)
    return ScenePlan(span, keyframes, channels)


def _window(stamps_ns: Stamps, span: SceneSpan) -> NDArray[np.intp]:
    first, last = np.searchsorted(stamps_ns, [span.window_start_ns, span.window_end_ns], side="left")
    return np.arange(first, last, dtype=np.intp)
