"""Cutting a recording into scenes of equal length."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bagassets.assets.timeline.keyframes import Stamps

__all__ = ["SceneCuts", "SceneSpan", "cut_scenes", "stretches"]

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


@dataclass(frozen=True, slots=True)
class SceneCuts:
    """The scenes of a stretch of a recording, in order.

    Attributes:
        scenes: spans whose windows do not overlap.
        remainder_ns: time at the end that is too short for a scene; 0 if there is none.
    """

    scenes: tuple[SceneSpan, ...]
    remainder_ns: int


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


def cut_scenes(first_ns: int, last_ns: int, length_ns: int, min_length_ns: int, period_ns: int) -> SceneCuts:
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
    """
    half_ns = period_ns // 2
    whole, remainder_ns = divmod(last_ns - first_ns, length_ns)
    starts = [first_ns + length_ns * number for number in range(whole)]
    scenes = [
        SceneSpan(start, start + length_ns - 1, start - half_ns, start + length_ns - half_ns)
        for start in starts
    ]
    if remainder_ns < min_length_ns or (remainder_ns == 0 and scenes):
        return SceneCuts(tuple(scenes), remainder_ns)
    start = first_ns + length_ns * whole
    scenes.append(SceneSpan(start, last_ns, start - half_ns, last_ns + half_ns + 1))
    return SceneCuts(tuple(scenes), 0)
