"""Rules about sweeps against the poses: clouds fit each other best at their own stamps; for radars, what stands still does not move over ground.

A few pairs of clouds are chosen in which a wrong time would show: between them the vehicle began to turn, braked or
drove off. The second cloud of a pair is laid over the first by the poses at both stamps, and at stamps shifted by
offsets of up to two revolutions. Upright things (walls, vehicles, poles) must then coincide; their mean distance is
the misfit. Nothing shows while the vehicle stands or moves at a constant velocity, as its motion within a second is
then the same at any time.

The work does not grow with the recording: five pairs, 19 offsets.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.assets.quality.finding import Finding
from bagassets.base.json_types import JsonObject
from bagassets.geometry.radar_motion import sensor_velocities, what_velocities_are
from bagassets.geometry.se3 import SE3, Floats, quaternion_multiply, rotate
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import LidarChannel, Rig
from bagassets.recipe.model_checks import SweepTimesCheck

MOST_PAIRS, LEAST_PAIRS = 5, 3
# Pairs are chosen from those of this many sweeps.
MOST_FIRSTS = 200
SECONDS_BETWEEN = (0.3, 0.6, 1.0, 2.0, 3.0)
# Two clouds show the same things only if they were taken near each other.
MOST_BETWEEN_M = 25.0
# A pair is of use if an offset of one revolution moves things this far; they are assumed to be 10 m away.
LEAST_MOVED_M, THINGS_AT_M = 0.2, 10.0
# Offsets are tried in steps of a quarter of a revolution, up to a little more than two: a stamp of the end that is
# taken for the start is off by that much.
STEPS, MOST_STEPS = 4, 9

REACH_M, CELL_M = 30.0, 0.1
# A cell of a square metre is upright if its points differ this much in height.
UPRIGHT_M = 0.4
MOST_POINTS, MOST_UPRIGHT, LEAST_UPRIGHT = 30_000, 2_000, 200
# A point farther off has no counterpart: that was hidden, or has moved.
MOST_MISFIT_M = 0.3
# Points that are not deskewed hardly ever fit best at the very start or end of their revolution.
LIKELY = 0.7
# The result is clear if all pairs fit best at the same offset, give or take this many steps.
MOST_APART = 2


@dataclass(frozen=True, eq=False)
class Sweeps:
    """The sweeps of one lidar.

    Attributes:
        stamps_ns: (N,) sorted stamps.
        spans_ns: (N, 2) start and end of each revolution; both are the stamp where they are unknown.
        points: number of a sweep -> its points, (M, 5) in the frame of the sensor, or None if they cannot be read.
        ego_SE3_sensor: pose of the sensor.
    """

    stamps_ns: NDArray[np.int64]
    spans_ns: NDArray[np.int64]
    points: Callable[[int], NDArray[np.float32] | None]
    ego_SE3_sensor: SE3


def sweeps_timed(
    rig: Rig, sweeps: Mapping[str, Sweeps], trajectory: Trajectory, check: SweepTimesCheck
) -> Finding:
    """Check that clouds fit each other best with the poses of their own times.

    Args:
        rig: tells what the recipe says of the stamps.
        sweeps: channel -> its sweeps.
        trajectory: `global_SE3_ego`.
        check: thresholds.
    """
    problems: list[str] = []
    facts: JsonObject = {}
    for name, lidar in sorted(sweeps.items()):
        channel = rig.channels.get(name)
        if not isinstance(channel, LidarChannel):
            continue
        fit = _fit(lidar, trajectory)
        if isinstance(fit, str):
            facts[name] = fit
            continue
        facts[name] = {
            "pairs_of_clouds": len(fit.misfits_m),
            "best_offset_ms": round(fit.best_ns / 1e6),
            "misfit_m": round(float(fit.mean(0)), 3),
            "best_misfit_m": round(float(fit.mean(fit.best)), 3),
        }
        problems += [f"{name}: {text}" for text in _late_or_early(channel, lidar, fit, check)]
    return Finding(problems, facts)


@dataclass(frozen=True, eq=False)
class _Fit:
    """How well pairs of clouds fit at each offset.

    Attributes:
        period_ns: length of a revolution.
        misfits_m: (pairs, offsets) mean distance from what is upright in the other cloud.
    """

    period_ns: int
    misfits_m: Floats

    def mean(self, step: int) -> float:
        """Mean misfit at an offset, counted in steps from none."""
        return float(self.misfits_m[:, step + MOST_STEPS].mean())

    @property
    def best(self) -> int:
        """The step with the least misfit; of several the one next to none."""
        return min(range(-MOST_STEPS, MOST_STEPS + 1), key=lambda step: (self.mean(step), abs(step)))

    @property
    def best_ns(self) -> float:
        """The offset with the least misfit, between steps where a parabola through three of them has its lowest point."""
        best = self.best
        if abs(best) == MOST_STEPS:
            return best * self.period_ns / STEPS
        before, least, after = (self.mean(best + step) for step in (-1, 0, 1))
        bend = before - 2 * least + after
        between = 0.5 * (before - after) / bend if bend > 0 else 0.0
        return (best + between) * self.period_ns / STEPS


def _late_or_early(channel: LidarChannel, lidar: Sweeps, fit: _Fit, check: SweepTimesCheck) -> Iterator[str]:
    """Say by how much the stamps are off, if it is clear."""
    rightful = _rightful_ns(channel, lidar, fit.period_ns)
    if abs(fit.best) == MOST_STEPS or _is_within(fit, rightful):
        return
    right = round(min(max(fit.best_ns, rightful[0]), rightful[1]) / fit.period_ns * STEPS)
    misfit, least = fit.mean(right), fit.mean(fit.best)
    if least > (1 - check.min_gain) * misfit or not _agree(fit, rightful):
        return
    offset_ms = round(fit.best_ns / 1e6)
    yield (
        f"its clouds fit each other clearly better with the poses of {abs(offset_ms)} ms {'after' if offset_ms > 0 else 'before'} "
        f"their stamps ({least:.3f} m off instead of {misfit:.3f} m, in each of {len(fit.misfits_m)} pairs of clouds between which "
        f"the motion changed); {_way_out(channel, rightful, fit)}"
    )


Range = tuple[float, float]


def _rightful_ns(channel: LidarChannel, lidar: Sweeps, period_ns: int) -> Range:
    """Return between which offsets clouds may fit best if their stamps are right.

    Points that were not moved to the stamp fit best at the time they were measured, which depends on where things
    were: some time in the revolution.
    """
    if channel.deskew:
        return 0, 0
    begins, ends = (np.sort(lidar.spans_ns[:, edge] - lidar.stamps_ns) for edge in (0, 1))
    begin, end = int(begins[len(begins) // 2]), int(ends[len(ends) // 2])
    if begin == end:  # as recorded: the middle of a revolution, or the instant of all points
        return begin - period_ns / STEPS, end + period_ns / STEPS
    return begin, end


def _is_within(fit: _Fit, between: Range) -> bool:
    """Return whether the best offset lies in a range, give or take a quarter of a revolution."""
    allowed = fit.period_ns / STEPS
    return between[0] - allowed <= fit.best_ns <= between[1] + allowed


def _agree(fit: _Fit, rightful: Range) -> bool:
    """Return whether every pair fits best outside the rightful offsets, and all of them at about the same offset."""
    steps = fit.misfits_m.argmin(axis=1) - MOST_STEPS
    offsets_ns = steps * (fit.period_ns / STEPS)
    late, early = (offsets_ns < rightful[0]).all(), (offsets_ns > rightful[1]).all()
    return bool((late or early) and (np.abs(steps - fit.best) <= MOST_APART).all())


def _way_out(channel: LidarChannel, rightful: Range, fit: _Fit) -> str:
    """Return what to write into the recipe."""
    period, meaning = fit.period_ns, channel.header_stamp_is
    others: dict[str, Range] = {}
    if meaning is not None:
        # Another meaning shifts the revolutions by half or all of their length.
        begins = {"start": 0.0, "middle": -period / 2, "end": -1.0 * period}
        moved = {moment: begin - begins[meaning] for moment, begin in begins.items() if moment != meaning}
        others = {moment: (rightful[0] + by, rightful[1] + by) for moment, by in moved.items()}
    elif not channel.deskew and rightful[0] < 0 < rightful[1]:
        # Stamps as recorded, points as they were measured.
        others = {"start": (0.0, LIKELY * period), "end": (-LIKELY * period, 0.0)}
    for moment in sorted(others, key=lambda moment: abs(sum(others[moment]) / 2 - fit.best_ns)):
        if _is_within(fit, others[moment]):
            return f"the stamps seem to mean the {moment} of a revolution: write header_stamp_is: {moment}"
    seconds = channel.stamp_offset_s + round((fit.best_ns - sum(rightful) / 2) / 1e6) / 1e3
    return f"if the clock of the sensor is off, write stamp_offset_s: {seconds:.3f}"


def _fit(lidar: Sweeps, trajectory: Trajectory) -> _Fit | str:
    """Return how pairs of clouds fit, or why that is unknown."""
    if trajectory.fixed:
        return "the vehicle stands still, so there is nothing to compare"
    if len(lidar.stamps_ns) <= LEAST_PAIRS:
        return "too few clouds to tell"
    periods = np.sort(np.diff(lidar.stamps_ns))
    period_ns = int(periods[len(periods) // 2])
    pairs = _choose_pairs(lidar.stamps_ns, period_ns, trajectory)
    if len(pairs) < LEAST_PAIRS:
        return "the motion of the vehicle changes too little to tell"
    offsets_ns = np.arange(-MOST_STEPS, MOST_STEPS + 1) * period_ns // STEPS
    misfits = []
    for first, second in pairs:
        motion = _motions(lidar.stamps_ns[[first]], lidar.stamps_ns[[second]], offsets_ns, trajectory)
        misfit = _misfits(_upright(lidar, first), _upright(lidar, second), motion)
        if misfit is not None:
            misfits.append(misfit)
    if len(misfits) < LEAST_PAIRS:
        return "too little stands upright around the vehicle to tell"
    return _Fit(period_ns, np.array(misfits))


def _motions(
    firsts_ns: NDArray[np.int64],
    seconds_ns: NDArray[np.int64],
    offsets_ns: NDArray[np.int64],
    trajectory: Trajectory,
) -> tuple[Floats, Floats]:
    """Return `first_SE3_second` of the ego frame for P pairs of stamps, moved by each of D offsets.

    Returns:
        translations (P * D, 3) and rotations (P * D, 4), offsets varying fastest; NaN where there is no pose.
    """
    at_first = trajectory.at((firsts_ns[:, None] + offsets_ns).reshape(-1))
    at_second = trajectory.at((seconds_ns[:, None] + offsets_ns).reshape(-1))
    back = at_first[1] * np.array([1.0, -1.0, -1.0, -1.0])
    return rotate(back, at_second[0] - at_first[0]), quaternion_multiply(back, at_second[1])


def _choose_pairs(
    stamps_ns: NDArray[np.int64], period_ns: int, trajectory: Trajectory
) -> list[tuple[int, int]]:
    """Return the pairs of sweeps, by number, in which a wrong time would show most, each sweep at most once."""
    firsts = np.unique(np.linspace(0, len(stamps_ns) - 1, MOST_FIRSTS).astype(np.int64))
    steps = np.unique([max(1, round(seconds * 1e9 / period_ns)) for seconds in SECONDS_BETWEEN])
    first = np.repeat(firsts, len(steps))
    second = first + np.tile(steps, len(firsts))
    first, second = first[second < len(stamps_ns)], second[second < len(stamps_ns)]
    # Both sides count: a pose that jumps is on one side only.
    offsets_ns = np.array([-2 * period_ns, -period_ns, 0, period_ns, 2 * period_ns])
    translations, rotations = _motions(stamps_ns[first], stamps_ns[second], offsets_ns, trajectory)
    moves = translations.reshape(-1, len(offsets_ns), 3)
    turns = rotations.reshape(-1, len(offsets_ns), 4)
    between_m = _length(moves[:, 2])
    moved_m = np.minimum(
        *(
            _length(moves[:, side] - moves[:, 2]) + THINGS_AT_M * _angle(turns[:, side], turns[:, 2])
            for side in (1, 3)
        )
    )
    usable = np.isfinite(moves).all(axis=(1, 2)) & (between_m <= MOST_BETWEEN_M) & (moved_m >= LEAST_MOVED_M)
    # Clouds that are far apart show less of the same things.
    worth = np.where(usable, moved_m / (5.0 + between_m), 0.0)
    chosen: list[tuple[int, int]] = []
    taken: set[int] = set()
    for number in np.argsort(-worth, kind="stable").tolist():
        pair = int(first[number]), int(second[number])
        if not worth[number] or len(chosen) == MOST_PAIRS:
            break
        if not taken & set(pair):
            chosen.append(pair)
            taken |= set(pair)
    return chosen


def _length(vectors: Floats) -> Floats:
    length: Floats = np.sqrt((vectors * vectors).sum(axis=-1))
    return length


def _angle(one: Floats, other: Floats) -> Floats:
    """Return the angle between rotations as quaternions, radians, if it is small."""
    near = np.where((one * other).sum(axis=-1, keepdims=True) < 0, -other, other)
    return 2 * _length(one - near)


def _upright(lidar: Sweeps, number: int) -> Floats | None:
    """Return points (N, 3) in the ego frame that stand above or below others; None if there are too few."""
    points = lidar.points(number)
    if points is None:
        return None
    xyz = points[:: max(1, len(points) // MOST_POINTS), :3].astype(np.float64)
    ego = lidar.ego_SE3_sensor.transform_points(xyz)
    ego = ego[(np.abs(ego[:, :2]) < REACH_M).all(axis=1)]
    if len(ego) < LEAST_UPRIGHT:
        return None
    if np.ptp(ego[:, 2]) >= UPRIGHT_M:  # of a flat scan, everything is a wall
        cells = np.floor(ego[:, :2] + REACH_M).astype(np.int64)
        cell = cells[:, 0] * int(2 * REACH_M) + cells[:, 1]
        number_of_cells = int(2 * REACH_M) ** 2
        lowest, highest = np.full(number_of_cells, np.inf), np.full(number_of_cells, -np.inf)
        np.minimum.at(lowest, cell, ego[:, 2])
        np.maximum.at(highest, cell, ego[:, 2])
        ego = ego[(highest - lowest)[cell] >= UPRIGHT_M]
    return ego if len(ego) >= LEAST_UPRIGHT else None


def _misfits(first: Floats | None, second: Floats | None, motion: tuple[Floats, Floats]) -> Floats | None:
    """Return for each motion (D,) how far the points of the second cloud are from those of the first, seen from above."""
    if first is None or second is None:
        return None
    size = int(2 * REACH_M / CELL_M)
    free = np.full((size, size), 255, np.uint8)
    cells = ((first[:, :2] + REACH_M) / CELL_M).astype(np.int64)
    free[cells[:, 1], cells[:, 0]] = 0
    distances = np.minimum(cv2.distanceTransform(free, cv2.DIST_L2, 3) * CELL_M, MOST_MISFIT_M)
    second = second[:: max(1, len(second) // MOST_UPRIGHT)]
    misfits = []
    for translation, rotation in zip(*motion, strict=True):
        if np.isnan(translation).any():  # no pose at that time
            misfits.append(MOST_MISFIT_M)
            continue
        seen = rotate(rotation[None, :], second)[:, :2] + translation[:2]
        cells = np.clip(((seen + REACH_M) / CELL_M).astype(np.int64), 0, size - 1)
        misfits.append(float(distances[cells[:, 1], cells[:, 0]].mean()))
    return np.array(misfits)


RadarReadings = tuple[SE3, Sequence[tuple[int, Floats]]]
"""Pose of a radar; stamp (ns) and targets of readings: x, y, z (m), vx, vy (m/s) over ground, (5, N) in its frame."""

_NOISE_SHARE = 0.01
_STILL_MOVES = "what stands still moves over ground as fast as the vehicle drives, so its velocities seem to"


def radar_velocities(radars: Mapping[str, RadarReadings], trajectory: Trajectory) -> Finding:
    """Check that targets which stand still have no velocity over ground.

    Args:
        radars: channel -> its pose and readings.
        trajectory: `global_SE3_ego`.
    """
    problems = []
    for name, (ego_SE3_radar, readings) in sorted(radars.items()):
        stamps_ns = np.array([stamp_ns for stamp_ns, _ in readings], dtype=np.int64)
        radar_mps = sensor_velocities(trajectory, ego_SE3_radar, stamps_ns)[:, None, :2]
        # Over ground, what stands still would have the velocity of a radar that moves the other way.
        for sign, text in (
            (1, "be relative to the radar: write velocities: relative"),
            (-1, "have been over ground before they were compensated: write velocities: over_ground"),
        ):
            told = [(targets, sign * own) for (_, targets), own in zip(readings, radar_mps, strict=True)]
            if what_velocities_are(told, _NOISE_SHARE) == "relative":
                problems.append(f"{name}: {_STILL_MOVES} {text}")
    return Finding(problems, {name: len(readings) for name, (_, readings) in sorted(radars.items())})
