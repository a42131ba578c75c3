"""Planning scenes: cutting a recording into scenes of equal length, their keyframes, the readings at these, and the sample of every other reading.

Keyframes are where every channel has a reading within tolerance. A channel without any reading in the recording drops no
keyframe: a sample without it is better than no sample, and checks report the channel.
"""

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bagassets.assets.timeline.keyframes import (
    Stamps,
    choose_keyframes,
    match_readings,
    owning_keyframe,
    partner_readings,
)
from bagassets.recipe.model import Scenes
from bagassets.recipe.model_base import ChannelName

# A reference is silent for this long only if it was off, however long scenes are; of one that is slow, three readings
# may be missing.
_LONGEST_PAUSE_NS = 3_600_000_000_000
_MISSING_READINGS = 3


@dataclass(frozen=True, slots=True)
class SceneSpan:
    """One scene.

    Attributes:
        start_ns: start of its keyframe grid, the first target.
        end_ns: last nanosecond of the scene, inclusive.
        window_start_ns: first stamp of readings that belong to the scene.
        window_end_ns: end of the window, exclusive.
    """

    start_ns: int
    end_ns: int
    window_start_ns: int
    window_end_ns: int

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return (self.end_ns - self.start_ns) / 1e9


def stretches(
    stamps_ns: Stamps, length_ns: int, period_ns: int, breaks_ns: Sequence[int] = ()
) -> list[tuple[int, int]]:
    """Return the first and last stamp of each stretch of readings between pauses that are longer than a scene.

    No scene could have readings from both sides of such a pause: the recorder waited for an event, or its clock was set.
    Shorter pauses stay inside of scenes.

    Args:
        stamps_ns: (N,) stamps of the reference readings, N >= 1.
        length_ns: length of a scene.
        period_ns: time between keyframes.
        breaks_ns: increasing times at which a stretch ends, however close its readings are.
    """
    steps_ns = np.diff(stamps_ns)
    usual_ns = int(np.median(steps_ns)) if len(steps_ns) else 0
    pause_ns = max(period_ns, min(_LONGEST_PAUSE_NS, max(length_ns, _MISSING_READINGS * usual_ns)))
    broken = np.diff(np.searchsorted(np.array(breaks_ns, dtype=np.int64), stamps_ns)) > 0
    parts = np.split(stamps_ns, np.flatnonzero((steps_ns > pause_ns) | broken) + 1)
    return [(int(part[0]), int(part[-1])) for part in parts]


def cut_scenes(
    first_ns: int, last_ns: int, length_ns: int, min_length_ns: int, period_ns: int
) -> tuple[list[SceneSpan], int]:
    """Cut the time from the first to the last reference reading of a stretch into scenes.

    Scenes follow each other without gaps. The remainder at the end becomes a shorter scene if it
    is at least `min_length_ns` long. A stretch of a single instant is a remainder of length zero.

    The window of readings opens half a keyframe period before the first target, so that the reading
    of a camera that fired just before the first keyframe belongs to this scene, and to no other.

    Args:
        first_ns: stamp of the first reference reading.
        last_ns: stamp of the last reference reading.
        length_ns: length of a scene, > 0.
        min_length_ns: least length of the remainder.
        period_ns: time between keyframes, > 0.

    Returns:
        The scenes in order, whose windows do not overlap, and the time at the end that is too short for a scene; 0 if there
        is none.
    """
    half_ns = period_ns // 2
    whole, remainder_ns = divmod(last_ns - first_ns, length_ns)
    starts = [first_ns + length_ns * number for number in range(whole)]
    scenes = [
        SceneSpan(start, start + length_ns - 1, start - half_ns, start + length_ns - half_ns)
        for start in starts
    ]
    if remainder_ns < min_length_ns or (remainder_ns == 0 and scenes):
        return scenes, remainder_ns
    start = first_ns + length_ns * whole
    scenes.append(SceneSpan(start, last_ns, start - half_ns, last_ns + half_ns + 1))
    return scenes, 0


class SceneParams(Scenes):
    """How a recording is cut: the recipe's `scenes`, and the reference channel whose readings become keyframes."""

    reference: ChannelName

    @property
    def period_ns(self) -> int:
        """Time from one keyframe to the next."""
        return round(1e9 / self.keyframe_hz)

    @property
    def tolerance_ns(self) -> int:
        """Longest time between a keyframe and the readings that belong to it."""
        return round(self.tolerance_s * 1e9)

    @property
    def box_gap_ns(self) -> int:
        """Longest time between two observations of a box that it is interpolated over."""
        return round(self.box_gap_s * 1e9)


@dataclass(frozen=True, eq=False)
class ChannelPlan:
    """The readings of one channel in one scene.

    Attributes:
        readings: (N,) indices into the channel's readings, increasing.
        sample: (N,) index of the keyframe that each belongs to.
        is_keyframe: (N,) whether it is the reading of that keyframe itself.
    """

    readings: NDArray[np.intp]
    sample: NDArray[np.intp]
    is_keyframe: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ScenePlan:
    """One scene.

    Attributes:
        span: its time span.
        keyframes_ns: (K,) stamps of its samples, K >= 1.
        channels: channel -> its readings.
    """

    span: SceneSpan
    keyframes_ns: Stamps
    channels: Mapping[str, ChannelPlan]


@dataclass
class Shortage:
    """Keyframes at which a channel has no reading within tolerance: dropped, or kept without it.

    Attributes:
        keyframes: number of these keyframes.
        before_first: number before the channel's first reading.
        after_last: number after its last reading.
    """

    keyframes: int = 0
    before_first: int = 0
    after_last: int = 0


@dataclass
class RecordingPlan:
    """The scenes of a recording, and counts of what is in none.

    Attributes:
        scenes: in order.
        remainder_s: time at the end of each stretch of the reference, too short for a scene.
        longest_remainder_s: that of one stretch.
        empty_scenes: scenes left out because they have no keyframe.
        dropped_keyframes: keyframes left out because a channel has no reading there.
        lacking_samples: samples that lack a channel.
        shortages: channel -> keyframes at which it has no reading.
    """

    scenes: list[ScenePlan] = field(default_factory=list)
    remainder_s: float = 0.0
    longest_remainder_s: float = 0.0
    empty_scenes: int = 0
    dropped_keyframes: int = 0
    lacking_samples: int = 0
    shortages: dict[str, Shortage] = field(default_factory=dict)


def plan_scenes(
    stamps_ns: Mapping[str, Stamps], params: SceneParams, breaks_ns: Sequence[int] = ()
) -> RecordingPlan:
    """Cut a recording into scenes by the readings of its reference channel.

    Args:
        stamps_ns: channel -> stamps of its readings, strictly increasing.
        params: the recipe's scenes.
        breaks_ns: increasing times that no scene leads across.
    """
    plan = RecordingPlan(shortages={channel: Shortage() for channel in sorted(stamps_ns)})
    reference = stamps_ns[params.reference]
    if not len(reference):
        return plan
    length_ns, min_length_ns = (round(seconds * 1e9) for seconds in (params.length_s, params.min_length_s))
    parts = stretches(reference, length_ns, params.period_ns, breaks_ns)
    cuts = [cut_scenes(*part, length_ns, min_length_ns, params.period_ns) for part in parts]
    plan.remainder_s = sum(remainder_ns for _, remainder_ns in cuts) / 1e9
    plan.longest_remainder_s = max(remainder_ns for _, remainder_ns in cuts) / 1e9
    edges_ns = [-(2**63), *breaks_ns, 2**63 - 1]
    for span in (_between(edges_ns, span) for scenes, _ in cuts for span in scenes):
        scene = _plan_scene(span, stamps_ns, params, plan)
        if scene is None:
            plan.empty_scenes += 1
        else:
            plan.scenes.append(scene)
    return plan


def _between(edges_ns: Sequence[int], span: SceneSpan) -> SceneSpan:
    """Return a scene whose window does not lead across the edges around it: a hole may be shorter than a window is wider."""
    after = bisect_right(edges_ns, span.start_ns)
    start_ns = max(span.window_start_ns, edges_ns[after - 1])
    return replace(span, window_start_ns=start_ns, window_end_ns=min(span.window_end_ns, edges_ns[after]))


def _plan_scene(
    span: SceneSpan, stamps_ns: Mapping[str, Stamps], params: SceneParams, plan: RecordingPlan
) -> ScenePlan | None:
    inside = {}
    for channel, stamps in sorted(stamps_ns.items()):
        first, last = np.searchsorted(stamps, [span.window_start_ns, span.window_end_ns], side="left")
        inside[channel] = np.arange(first, last, dtype=np.intp)
    readings = {channel: stamps_ns[channel][window] for channel, window in inside.items()}
    keyframes = _keyframes(span, readings, stamps_ns, params, plan)
    if not len(keyframes):
        return None
    channels = {}
    for channel, stamps in readings.items():
        matched = match_readings(keyframes, stamps, params.tolerance_ns)
        sample = owning_keyframe(keyframes, stamps)
        is_keyframe = np.zeros(len(stamps), dtype=np.bool_)
        is_keyframe[matched[matched >= 0]] = True
        sample[matched[matched >= 0]] = np.flatnonzero(matched >= 0)
        channels[channel] = ChannelPlan(inside[channel], sample, is_keyframe)
    return ScenePlan(span, keyframes, channels)


def _keyframes(
    span: SceneSpan,
    readings: Mapping[str, Stamps],
    stamps_ns: Mapping[str, Stamps],
    params: SceneParams,
    plan: RecordingPlan,
) -> Stamps:
    """Return the stamps of a scene's keyframes, and count keyframes that lack a channel.

    Args:
        span: the scene.
        readings: channel -> stamps of its readings in the scene.
        stamps_ns: channel -> stamps of its readings in the recording.
        params: the recipe's scenes.
        plan: takes the counts.
    """
    reference = readings[params.reference]
    others = [name for name in readings if name != params.reference and len(stamps_ns[name])]
    anywhere = placed = choose_keyframes(reference, span.start_ns, span.end_ns, params.period_ns)
    must_be_complete = params.missing == "refuse"
    if must_be_complete and others:
        partners = [partner_readings(reference, readings[name], params.tolerance_ns) for name in others]
        placed = choose_keyframes(reference, span.start_ns, span.end_ns, params.period_ns, np.stack(partners))
    possible = anywhere >= 0
    candidates = reference[anywhere[possible]]
    dropped = placed[possible] < 0
    lacks_any = np.zeros(len(candidates), dtype=np.bool_)
    for name in others:
        lacks = match_readings(candidates, readings[name], params.tolerance_ns) < 0
        lacks &= dropped | (not must_be_complete)
        lacks_any |= lacks
        shortage, stamps = plan.shortages[name], stamps_ns[name]
        shortage.keyframes += int(np.count_nonzero(lacks))
        shortage.before_first += int(np.count_nonzero(candidates[lacks] < stamps[0]))
        shortage.after_last += int(np.count_nonzero(candidates[lacks] > stamps[-1]))
    plan.dropped_keyframes += int(np.count_nonzero(dropped))
    plan.lacking_samples += int(np.count_nonzero(lacks_any & ~dropped))
    return reference[placed[placed >= 0]]
