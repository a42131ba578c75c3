"""Time-ordered poses of the ego frame and their interpolation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.se3 import SE3, Floats

__all__ = ["Trajectory"]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """`global_SE3_ego` over time.

    Attributes:
        stamps_ns: (N,) int64, strictly increasing.
        positions_m: (N, 3) ego origin in the global frame.
        rotations: (N, 4) unit quaternions w, x, y, z.
        max_gap_ns: between two poses farther apart there is no pose.
        extrapolate_ns: the first and last pose hold this much beyond the ends.
        fixed: one pose that holds at all times.
    """

    stamps_ns: NDArray[np.int64]
    positions_m: Floats
    rotations: Floats
    max_gap_ns: int
    extrapolate_ns: int
    fixed: bool = False

    def at(self, stamps_ns: NDArray[np.int64]) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Interpolate (linear in position, slerp in rotation) at (M,) stamps.

        Returns:
            positions (M, 3), rotations (M, 4), and a mask (M,) that is False where there is no pose.
        """
        raise NotImplementedError

    def pose_at(self, stamp_ns: int) -> SE3 | None:
        """Return `global_SE3_ego` at one time, or None where there is no pose."""
        positions, rotations, valid = self.at(np.array([stamp_ns], dtype=np.int64))
        return SE3.create(rotations[0], positions[0]) if valid[0] else None
