"""Time-ordered poses of a moving frame and their interpolation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.portable import arctan_unit, sinc
from bagassets.geometry.se3 import SE3, Floats, quaternion_multiply


@dataclass(frozen=True, eq=False)
class Trajectory:
    """`global_SE3_ego` over time.

    Attributes:
        stamps_ns: (N,) int64, strictly increasing.
        positions_m: (N, 3) ego origin in the global frame.
        rotations: (N, 4) unit quaternions w, x, y, z.
        max_gap_ns: poses farther apart than this are not interpolated.
        extrapolate_ns: the motion is extrapolated for this long before the first and after the last
            pose, at the velocity over a stretch of the same length at that end.
        fixed: True for a single pose that holds at all times.
        holes_ns: there is no pose between the stamps of each pair, exclusive, however close they are.
    """

    stamps_ns: NDArray[np.int64]
    positions_m: Floats
    rotations: Floats
    max_gap_ns: int
    extrapolate_ns: int
    fixed: bool = False
    holes_ns: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        """Check shapes and order.

        Raises:
            ValueError: the arrays do not belong together, or stamps do not increase.
        """
        number = len(self.stamps_ns)
        if self.positions_m.shape != (number, 3) or self.rotations.shape != (number, 4):
            raise ValueError(
                f"{number} stamps need positions ({number}, 3) and rotations ({number}, 4), "
                f"got {self.positions_m.shape} and {self.rotations.shape}"
            )
        if self.fixed and number != 1:
            raise ValueError(f"a fixed trajectory has one pose, got {number}")
        if not (self.stamps_ns[1:] > self.stamps_ns[:-1]).all():
            raise ValueError("stamps of a trajectory must strictly increase")

    def at(self, stamps_ns: NDArray[np.int64]) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Interpolate (linear in position, slerp in rotation) at (M,) stamps; extrapolate at the ends.

        A recorded pose holds at its own stamp even if both its neighbours are far away.

        Returns:
            positions (M, 3), rotations (M, 4), and a mask (M,) that is False where there is no pose;
            there the numbers are NaN.
        """
        stamps = np.asarray(stamps_ns, dtype=np.int64)
        if self.fixed:
            everywhere = np.zeros(len(stamps), dtype=np.intp)
            return self.positions_m[everywhere], self.rotations[everywhere], np.ones(len(stamps), np.bool_)
        if not len(self.stamps_ns):
            nowhere = np.full((len(stamps), 7), np.nan)
            return nowhere[:, :3], nowhere[:, 3:], np.zeros(len(stamps), np.bool_)

        last = len(self.stamps_ns) - 1
        after = np.searchsorted(self.stamps_ns, stamps, side="right")
        left = np.clip(after - 1, 0, last)
        right = np.clip(after, 0, last)
        gap_ns = self.stamps_ns[right] - self.stamps_ns[left]
        since_ns = stamps - self.stamps_ns[left]  # negative before the first, unbounded after the last
        inside = gap_ns > 0
        valid = np.where(
            inside,
            (gap_ns <= self.max_gap_ns) | (since_ns == 0),
            np.abs(since_ns) <= self.extrapolate_ns,
        )
        for first_ns, last_ns in self.holes_ns:
            valid &= (stamps <= first_ns) | (stamps >= last_ns)
        fraction = np.where(inside, since_ns, 0) / np.where(inside, gap_ns, 1)

        start, end = self.positions_m[left], self.positions_m[right]
        positions = start + (end - start) * fraction[:, None]
        rotations = slerp(self.rotations[left], self.rotations[right], fraction)
        self._extrapolate(stamps, positions, rotations)
        positions[~valid] = np.nan
        rotations[~valid] = np.nan
        return positions, rotations, valid

    def _extrapolate(self, stamps: NDArray[np.int64], positions: Floats, rotations: Floats) -> None:
        """Replace the poses before the first and after the last recorded one by extrapolated ones.

        The velocity is measured from a pose that lies as far inside as extrapolation reaches
        outside, so that noise is at most doubled. If there is a gap, the pose at the end holds.
        """
        last = len(self.stamps_ns) - 1
        first_ns, last_ns, reach_ns = self.stamps_ns[0], self.stamps_ns[last], self.extrapolate_ns
        before, after = stamps < first_ns, stamps > last_ns
        if not (before.any() or after.any()):
            return
        after_first = int(np.searchsorted(self.stamps_ns, first_ns + reach_ns))
        before_last = int(np.searchsorted(self.stamps_ns, last_ns - reach_ns, side="right")) - 1
        for beyond, end, inner in (
            (before, 0, max(after_first, 1)),
            (after, last, min(before_last, last - 1)),
        ):
            if not (beyond.any() and 0 <= inner <= last):
                continue
            stretch_ns = abs(int(self.stamps_ns[inner] - self.stamps_ns[end]))
            if stretch_ns > max(self.max_gap_ns, reach_ns):
                continue
            ratio = np.minimum(np.abs(stamps[beyond] - self.stamps_ns[end]) / stretch_ns, 1.0)
            positions[beyond] += (self.positions_m[end] - self.positions_m[inner]) * ratio[:, None]
            at_end, at_inner = self.rotations[end], self.rotations[inner]
            turn = quaternion_multiply(at_inner * np.array([1.0, -1.0, -1.0, -1.0]), at_end)
            onward = quaternion_multiply(at_end, turn)
            ends, onwards = (np.tile(q, (len(ratio), 1)) for q in (at_end, onward))
            rotations[beyond] = slerp(ends, onwards, ratio)

    def pose_at(self, stamp_ns: int) -> SE3 | None:
        """Return `global_SE3_ego` at one time, or None where there is no pose."""
        positions, rotations, valid = self.at(np.array([stamp_ns], dtype=np.int64))
        return SE3.create(rotations[0], positions[0]) if valid[0] else None


def slerp(start: Floats, end: Floats, fraction: Floats) -> Floats:
    """Interpolate between unit quaternions at constant angular speed along the shorter arc.

    K. Shoemake, "Animating rotation with quaternion curves", 1985, with the weights written as
    t sinc(t θ) / sinc(θ), which has no singularity at θ = 0.

    Args:
        start: (M, 4) quaternions w, x, y, z at fraction 0.
        end: (M, 4) quaternions at fraction 1.
        fraction: (M,) between 0 and 1.

    Returns:
        (M, 4) unit quaternions; at fraction 0 exactly `start`.
    """
    near = np.where(_dot(start, end)[:, None] < 0, -end, end)
    difference, total = near - start, near + start
    # θ, the angle between the quaternions, is at most 90 degrees on the shorter arc.
    theta = 2.0 * arctan_unit(np.minimum(np.sqrt(_dot(difference, difference) / _dot(total, total)), 1.0))
    whole = sinc(theta)
    rest = 1.0 - fraction
    from_start = rest * sinc(rest * theta) / whole
    from_end = fraction * sinc(fraction * theta) / whole
    mixed = start * from_start[:, None] + near * from_end[:, None]
    mixed = mixed / np.sqrt(_dot(mixed, mixed))[:, None]
    return np.where(fraction[:, None] == 0, start, mixed)


def _dot(a: Floats, b: Floats) -> Floats:
    """Dot product of (M, 4) rows, in a fixed order of additions."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2] + a[:, 3] * b[:, 3]
