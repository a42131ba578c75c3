"""The motion of a radar, and what its targets say of it: things that stand still show how fast it moves."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.se3 import SE3, Floats, quaternion_multiply, rotate
from bagassets.geometry.trajectory import Trajectory

__all__ = ["FEWEST_TARGETS", "SLOWEST_MPS", "explained", "sensor_velocities"]

# Shorter, and the noise of poses would show (2 cm are 0.14 m/s); longer, and braking would.
HALF_WINDOW_NS = 100_000_000

SLOWEST_MPS = 1.5
"""Slower, and a radar that moves cannot be told from one that stands."""
FEWEST_TARGETS = 4
# Measured speeds are off by so much.
NOISE_MPS = 0.3
# Targets farther above or below the radar show less of its horizontal motion.
STEEPEST = 0.2


def sensor_velocities(trajectory: Trajectory, ego_SE3_sensor: SE3, stamps_ns: NDArray[np.int64]) -> Floats:
    """Return the velocity of a sensor over ground at (M,) stamps, in its own frame: (M, 3) in m/s, NaN without a pose.

    That of the mount, with the part that the turning of the vehicle adds: the mean over 0.2 s around each stamp, or of
    what has poses of that. On a circle driven at 0.7 rad/s it is 0.08 % too small.
    """
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    valid = trajectory.at(stamps)[2]
    first, last = (
        np.where(trajectory.at(stamps + shift)[2], stamps + shift, stamps)
        for shift in (-HALF_WINDOW_NS, HALF_WINDOW_NS)
    )
    mount_m = np.array(ego_SE3_sensor.translation)[None, :]
    places_m = []
    for times in (first, last):
        positions_m, rotations, _ = trajectory.at(times)
        places_m.append(positions_m + rotate(rotations, mount_m))
    # Halfway, the sensor looks along the mean direction of its motion, wherever the window lies.
    _, rotations, _ = trajectory.at(first + (last - first) // 2)
    global_SE3_sensor = quaternion_multiply(rotations, np.array(ego_SE3_sensor.rotation)[None, :])
    seconds = np.where(valid & (last > first), (last - first) / 1e9, np.nan)
    back = global_SE3_sensor * np.array([1.0, -1.0, -1.0, -1.0])
    return rotate(back, (places_m[1] - places_m[0]) / seconds[:, None])


def explained(
    targets: Mapping[str, Floats], velocities_mps: Floats, noise_share: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return which shares of a radar's targets stand still, for several velocities that the radar may have.

    Only radial speeds count, which every radar measures best, and of these only those of targets in whose direction
    the radar moves: others would look alike with any velocity.

    Args:
        targets: `x`, `y`, `z`, and `vx`, `vy` in m/s, each (N,).
        velocities_mps: (M, 2) horizontal velocities of the radar in its own frame.
        noise_share: these are off by this share of themselves.

    Returns:
        (M,) the share that stands still if velocities are over ground, and (M,) the share that does if they are
        relative to the radar; NaN where fewer than `FEWEST_TARGETS` count.
    """
    x, y, z, vx, vy = (np.asarray(targets[name], dtype=np.float64) for name in ("x", "y", "z", "vx", "vy"))
    distance = np.sqrt(x * x + y * y)
    level = (distance > 0) & (np.abs(z) <= STEEPEST * distance) & np.isfinite(vx) & np.isfinite(vy)
    ray_x, ray_y = x[level] / distance[level], y[level] / distance[level]
    radial = ray_x * vx[level] + ray_y * vy[level]
    speeds = np.sqrt((velocities_mps * velocities_mps).sum(axis=1))[:, None]
    approach = velocities_mps[:, :1] * ray_x + velocities_mps[:, 1:] * ray_y
    noise = NOISE_MPS + noise_share * speeds
    telling = np.abs(approach) > 2 * noise
    number = telling.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        number = np.where(number >= FEWEST_TARGETS, number, np.nan)
        ground = (telling & (np.abs(radial) <= NOISE_MPS)).sum(axis=1) / number
        relative = (telling & (np.abs(radial + approach) <= noise)).sum(axis=1) / number
    return ground, relative
