"""Attributes that the motion of an object determines.

nuScenes distinguishes vehicles that are moving, stopped (at rest, about to go on) and parked (at rest for good), and
persons that are moving, standing, and sitting or lying. From a track alone follows:

- a vehicle or person at `moving_mps` or more is moving;
- a slower vehicle is parked if it never moved in this recording, else stopped;
- a slower person who moved before or after is standing. One who never moved may as well sit or lie.

Motion does not show whether a cycle has a rider. Attributes that are not determined stay empty.

The speed at a time is measured over ground, within `window_s` around it as far as the track reaches, and over at
least half of that: labels are off by decimetres, which over 0.1 s would be metres per second. An object moved if it
was ever that fast, or farther than `parked_m` from its first position.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.assets.boxes.tracks import Track
from bagassets.assets.timeline.keyframes import Stamps, nearest
from bagassets.geometry.se3 import Floats

_CYCLES = frozenset({"vehicle.bicycle", "vehicle.motorcycle"})
# Classes that nuscenes-devkit detects as pedestrians; somebody in a wheelchair never stands.
_PERSONS = frozenset(
    f"human.pedestrian.{name}" for name in ("adult", "child", "construction_worker", "police_officer")
)


@dataclass(frozen=True)
class MotionRule:
    """When an object counts as moving.

    Attributes:
        moving_mps: least speed of a moving object.
        window_ns: time over which a speed is measured.
        parked_m: an object that never moved stays within this distance of its first position.
        gap_ns: no speed is measured across a longer gap between observations.
    """

    moving_mps: float
    window_ns: int
    parked_m: float
    gap_ns: int


def has_attributes(category: str) -> bool:
    """Return whether nuScenes has attributes for a category."""
    return category.startswith(("vehicle.", "human.pedestrian."))


def motion_attributes(category: str, track: Track, times_ns: Stamps, rule: MotionRule) -> list[str]:
    """Return for each of (T,) times the attribute of an object of a category; empty where it is not determined."""
    is_person = category in _PERSONS
    is_vehicle = category.startswith("vehicle.") and category not in _CYCLES
    moved = _moved(track, rule) if is_person or is_vehicle else None
    if moved is None:
        return [""] * len(times_ns)
    if not moved:
        return ["" if is_person else "vehicle.parked"] * len(times_ns)
    moving, still = (
        ("pedestrian.moving", "pedestrian.standing") if is_person else ("vehicle.moving", "vehicle.stopped")
    )
    return [
        "" if np.isnan(speed) else moving if speed >= rule.moving_mps else still
        for speed in speeds_of(track, times_ns, rule.window_ns, rule.gap_ns).tolist()
    ]


def _moved(track: Track, rule: MotionRule) -> bool | None:
    """Return whether an object ever moved in the recording; None if every part of the track is too short."""
    observed = speeds_of(track, track.stamps_ns, rule.window_ns, rule.gap_ns)
    known = observed[np.isfinite(observed)]
    if not len(known):
        return None
    away = track.centers_m[:, :2] - track.centers_m[0, :2]
    farthest_m = np.sqrt((away * away).sum(axis=1).max())
    return bool(known.max() >= rule.moving_mps or farthest_m > rule.parked_m)


def speeds_of(track: Track, times_ns: Stamps, window_ns: int, gap_ns: int) -> Floats:
    """Return the speed over ground at (T,) times in m/s; NaN where the track is too short.

    Args:
        track: the object.
        times_ns: (T,).
        window_ns: time over which a speed is measured.
        gap_ns: no speed is measured across a longer gap between observations.
    """
    stamps = track.stamps_ns
    breaks = np.flatnonzero(np.diff(stamps) > gap_ns) + 1
    firsts, lasts = np.concatenate([[0], breaks]), np.concatenate([breaks, [len(stamps)]]) - 1
    stretch = np.searchsorted(breaks, nearest(stamps, times_ns), side="right")
    start, end = stamps[firsts[stretch]], stamps[lasts[stretch]]
    half_ns = window_ns // 2
    middle = np.clip(times_ns, start, end)
    before, after = np.maximum(middle - half_ns, start), np.minimum(middle + half_ns, end)
    moves = _positions(track, after) - _positions(track, before)
    speeds = np.full(len(times_ns), np.nan)
    enough = after - before >= max(half_ns, 1)
    seconds = (after - before)[enough] / 1e9
    speeds[enough] = np.sqrt((moves * moves).sum(axis=1))[enough] / seconds
    return speeds


def _positions(track: Track, times_ns: NDArray[np.int64]) -> Floats:
    """Return positions of the track, x and y (T, 2), at times between its first and its last observation."""
    last = len(track.stamps_ns) - 1
    left = np.clip(np.searchsorted(track.stamps_ns, times_ns, side="right") - 1, 0, last)
    right = np.minimum(left + 1, last)
    gap_ns = np.maximum(track.stamps_ns[right] - track.stamps_ns[left], 1)
    fraction = (times_ns - track.stamps_ns[left]) / gap_ns
    start, end = track.centers_m[left, :2], track.centers_m[right, :2]
    positions: Floats = start + (end - start) * fraction[:, None]
    return positions
