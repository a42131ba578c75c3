"""Cutting a recording into scenes of equal length."""

from dataclasses import dataclass

__all__ = ["SceneCuts", "SceneSpan", "cut_scenes"]


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
    """The scenes of a recording, in order.

    Attributes:
        scenes: spans whose windows do not overlap.
        remainder_ns: time at the end that is too short for a scene; 0 if there is none.
    """

    scenes: tuple[SceneSpan, ...]
    remainder_ns: int


def cut_scenes(first_ns: int, last_ns: int, length_ns: int, min_length_ns: int, period_ns: int) -> SceneCuts:
    """Cut the time from the first to the last reference reading into scenes.

    Scenes follow each other without gaps. The remainder at the end becomes a shorter scene if it
    is at least `min_length_ns` long. A recording of a single instant is a remainder of length zero.

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
