"""A rule about radar velocities: over ground, what stands still does not move.

Where most targets seem to come towards the vehicle as fast as it drives, their velocities were relative to the radar, and are
not compensated. Where most seem to go along with it, they were over ground, and were compensated all the same. Traffic looks
like that, too: therefore hardly anything else may stand still, and nearly all readings have to agree.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.radar_motion import SLOWEST_MPS, explained, sensor_velocities
from bagassets.geometry.se3 import SE3
from bagassets.geometry.trajectory import Trajectory
from bagassets.quality.finding import Finding
from bagassets.recipe.model_checks import RadarVelocitiesCheck

__all__ = ["RadarReadings", "radar_velocities"]

# The work does not grow with the recording: of its readings, so many are looked at, at equal steps.
MOST_READINGS, FEWEST_READINGS = 60, 5
MOST_STILL, AGREEING = 0.1, 0.9
NOISE_SHARE = 0.01
_PROBLEMS = {
    "relative": "they seem to be relative to the radar: write velocities: relative",
    "over_ground": "they seem to be over ground already: write velocities: over_ground",
}


@dataclass(frozen=True, eq=False)
class RadarReadings:
    """The readings of one radar.

    Attributes:
        stamps_ns: (N,) sorted stamps.
        targets: number of a reading -> its targets, with the fields of nuScenes; None if they cannot be read.
        ego_SE3_sensor: pose of the sensor.
    """

    stamps_ns: NDArray[np.int64]
    targets: Callable[[int], NDArray[np.void] | None]
    ego_SE3_sensor: SE3


def radar_velocities(
    radars: Mapping[str, RadarReadings], trajectory: Trajectory, check: RadarVelocitiesCheck
) -> Finding:
    """Check that targets which stand still have no velocity over ground.

    Args:
        radars: channel -> its readings.
        trajectory: `global_SE3_ego`.
        check: thresholds.
    """
    problems, facts = [], {}
    for name, radar in sorted(radars.items()):
        votes = _votes(radar, trajectory, check.min_share)
        facts[name] = {vote: votes.count(vote) for vote in sorted(set(votes))}
        for kind, way_out in _PROBLEMS.items():
            if len(votes) >= FEWEST_READINGS and votes.count(kind) >= AGREEING * len(votes):
                problems.append(
                    f"{name}: while the vehicle drives, what stands still moves over ground as fast as it, in {votes.count(kind)} of "
                    f"{len(votes)} readings; {way_out}"
                )
    return Finding(problems, facts)


def _votes(radar: RadarReadings, trajectory: Trajectory, min_share: float) -> list[str]:
    """Return for each reading that can tell what its velocities over ground were; `unclear` if most targets move otherwise."""
    numbers = np.unique(np.linspace(0, max(0, len(radar.stamps_ns) - 1), MOST_READINGS).astype(np.int64))
    if not len(radar.stamps_ns):
        return []
    own_mps = sensor_velocities(trajectory, radar.ego_SE3_sensor, radar.stamps_ns[numbers])[:, :2]
    votes = []
    for number, velocity in zip(numbers.tolist(), own_mps, strict=True):
        if not np.sqrt((velocity * velocity).sum()) >= SLOWEST_MPS:  # nor without a pose
            continue
        targets = radar.targets(number)
        if targets is None or not len(targets["x"]):
            continue
        over_ground = {"vx": targets["vx_comp"], "vy": targets["vy_comp"]}
        places = {axis: targets[axis] for axis in "xyz"}
        still, moving = explained(places | over_ground, np.stack([velocity, -velocity]), NOISE_SHARE)
        if np.isnan(still[0]):
            continue
        shares = {"right": still[0], "relative": moving[0], "over_ground": moving[1]}
        vote = max(shares, key=lambda kind: shares[kind])
        is_clear = shares[vote] >= min_share and (vote == "right" or still[0] <= MOST_STILL)
        votes.append(vote if is_clear else "unclear")
    return votes
