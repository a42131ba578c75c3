"""A rule about radar velocities: over ground, what stands still does not move."""

from collections.abc import Mapping, Sequence

import numpy as np

from bagassets.assets.quality.finding import Finding
from bagassets.geometry.radar_motion import sensor_velocities, what_velocities_are
from bagassets.geometry.se3 import SE3, Floats
from bagassets.geometry.trajectory import Trajectory

__all__ = ["RadarReadings", "radar_velocities"]

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
