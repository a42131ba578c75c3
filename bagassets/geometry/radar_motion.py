"""The motion of a radar, and what its targets show of it: what stands still comes nearer as fast as the radar moves."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.se3 import SE3, Floats, quaternion_multiply, rotate
from bagassets.geometry.trajectory import Trajectory

Velocities = Literal["relative", "over_ground"]

# Shorter, and the noise of poses would show (2 cm are 0.14 m/s); longer, and braking would.
HALF_WINDOW_NS = 100_000_000
SLOWEST_MPS, NOISE_MPS = 1.5, 0.3
FEWEST_READINGS, FEWEST_TARGETS = 10, 4
MOST, HARDLY_ANY = 0.5, 0.2


def sensor_velocities(trajectory: Trajectory, ego_SE3_sensor: SE3, stamps_ns: NDArray[np.int64]) -> Floats:
    """Return the velocity of a sensor over ground at (M,) stamps, in its own frame: (M, 3) in m/s, NaN without a pose.

    It includes what turning adds at the mount, and is the mean over 0.2 s around each stamp, or over what has poses of
    that. On a circle driven at 0.7 rad/s it is 0.08 % too small.
    """
    first_ns, last_ns = (
        np.where(trajectory.at(stamps_ns + shift)[2], stamps_ns + shift, stamps_ns)
        for shift in (-HALF_WINDOW_NS, HALF_WINDOW_NS)
    )
    mount_m = np.array(ego_SE3_sensor.translation)
    (from_m, from_turned, _), (to_m, to_turned, _) = trajectory.at(first_ns), trajectory.at(last_ns)
    moved_m = to_m + rotate(to_turned, mount_m) - from_m - rotate(from_turned, mount_m)
    seconds = np.where(last_ns > first_ns, (last_ns - first_ns) / 1e9, np.nan)
    # Halfway, the sensor looks along the mean direction of its motion, wherever the window lies.
    halfway = trajectory.at(first_ns + (last_ns - first_ns) // 2)[1]
    global_Q_sensor = quaternion_multiply(halfway, np.array(ego_SE3_sensor.rotation))
    return rotate(global_Q_sensor * [1.0, -1.0, -1.0, -1.0], moved_m / seconds[:, None])


def what_velocities_are(readings: Sequence[tuple[Floats, Floats]], noise_share: float) -> Velocities | None:
    """Return what the velocities of a radar are, if things that stand still show it while it moves; else None.

    If they are relative, most targets come nearer as fast as the radar moves; if they are over ground, most have no velocity.
    Traffic alone looks like either, so one must explain most targets of all readings, and the other hardly any.

    Args:
        readings: x, y, z (m), vx, vy (m/s) of the targets of each, (5, N), and the horizontal velocity (m/s) that the
            radar had, (M, 2) in its frame: M guesses in directions of which one holds for all readings.
        noise_share: the velocities of the radar are off by this share of themselves.
    """
    moving = [one for one in readings if np.sqrt((one[1] * one[1]).sum(axis=1))[0] >= SLOWEST_MPS]
    if len(moving) < FEWEST_READINGS:
        return None
    ground, relative = np.mean([_standing(*one, noise_share) for one in moving], axis=0)
    best = int(np.argmax(relative))
    if relative[best] >= MOST and ground[best] <= HARDLY_ANY:
        return "relative"
    return "over_ground" if ground.max() >= MOST and relative[best] <= HARDLY_ANY else None


def _standing(targets: Floats, radar_mps: Floats, noise_share: float) -> Floats:
    """Return which shares of targets stand still, (2, M): with velocities over ground, and with relative ones.

    Only radial speeds count, which every radar measures best, and only those of targets within 60 degrees of the direction
    of travel: elsewhere, radial speeds are alike whatever moves. Of what is high up, x and y hold a part of them only.
    """
    x, y, z, vx, vy = targets
    # Plug-ins may give targets at the radar itself.
    distance = np.maximum(np.sqrt(x * x + y * y + z * z), 1e-3)
    radial = (x * vx + y * vy) / distance
    approach = (radar_mps[:, :1] * x + radar_mps[:, 1:] * y) / distance
    speeds = np.sqrt((radar_mps * radar_mps).sum(axis=1))[:, None]
    noise = NOISE_MPS + noise_share * speeds
    telling = (np.abs(approach) > np.maximum(2 * noise, 0.5 * speeds)) & (np.abs(z) < 0.2 * distance)
    explained = (np.abs(radial) <= NOISE_MPS, np.abs(radial + approach) <= noise)
    number = telling.sum(axis=1)
    shares: Floats = np.array([(telling & one).sum(axis=1) / np.maximum(number, 1) for one in explained])
    return np.where(number >= FEWEST_TARGETS, shares, 0.0)
