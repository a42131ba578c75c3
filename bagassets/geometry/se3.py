"""Rigid transforms, named `dst_SE3_src`: they map coordinates in `src` to coordinates in `dst`.

All arithmetic is elementwise. What is computed here is written into datasets, and BLAS
kernels differ between processors in the last bits.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isfinite, sqrt
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Number = TypeVar("Number", float, Floats)

IDENTITY_QUATERNION = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class SE3:
    """A rigid transform: rotation by a unit quaternion (w, x, y, z), then translation in metres.

    Both are tuples of floats, so transforms can be compared, hashed and written as JSON.
    """

    rotation: tuple[float, float, float, float] = IDENTITY_QUATERNION
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def create(cls, rotation: Floats | Sequence[float], translation: Floats | Sequence[float]) -> Self:
        """Return the transform with `rotation` (w, x, y, z; normalised here) and `translation` (3,).

        Raises:
            ValueError: a shape is wrong, a number is not finite, or the quaternion is zero.
        """
        q = [float(v) for v in rotation]
        t = [float(v) for v in translation]
        if len(q) != 4 or len(t) != 3:
            raise ValueError(f"a pose needs 4 + 3 numbers, got {len(q)} + {len(t)}")
        norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        if not (all(map(isfinite, t)) and isfinite(norm)) or norm < 1e-6:
            raise ValueError(f"a pose needs finite numbers and a rotation, got rotation {q}, translation {t}")
        w, x, y, z = (v / norm for v in q)
        return cls((w, x, y, z), (t[0], t[1], t[2]))

    def normalised(self) -> "SE3":
        """Return it with a quaternion of unit length; rounding leaves one that is a little off."""
        return SE3.create(self.rotation, self.translation)

    @property
    def rotation_matrix(self) -> Floats:
        """Rotation as (3, 3) matrix."""
        w, x, y, z = self.rotation
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )

    @property
    def matrix(self) -> Floats:
        """The transform as (4, 4) homogeneous matrix."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation_matrix
        matrix[:3, 3] = self.translation
        return matrix

    def __matmul__(self, other: "SE3") -> "SE3":
        """Compose: `a_SE3_b @ b_SE3_c` is `a_SE3_c`."""
        # In plain floats: for one transform that is many times faster than in arrays.
        x, y, z = _rotated(self.rotation, other.translation)
        tx, ty, tz = self.translation
        return SE3.create(_product(self.rotation, other.rotation), (x + tx, y + ty, z + tz))

    def inverse(self) -> "SE3":
        """Return `src_SE3_dst`."""
        w, x, y, z = self.rotation
        conjugate = (w, -x, -y, -z)
        tx, ty, tz = _rotated(conjugate, self.translation)
        return SE3.create(conjugate, (-tx, -ty, -tz))

    def transform_points(self, points_src: Floats) -> Floats:
        """Map (N, 3) points in `src` to (N, 3) points in `dst`, metres."""
        points_dst: Floats = rotate(np.array(self.rotation), points_src) + np.array(self.translation)
        return points_dst


def quaternion_multiply(a: Floats, b: Floats) -> Floats:
    """Hamilton product of (..., 4) quaternions w, x, y, z."""
    return np.stack(_product(np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)), axis=-1)


def rotate(quaternion: Floats, vectors: Floats) -> Floats:
    """Rotate (..., 3) vectors by (..., 4) unit quaternions w, x, y, z; shapes broadcast."""
    return np.stack(_rotated(np.moveaxis(quaternion, -1, 0), np.moveaxis(vectors, -1, 0)), axis=-1)


def _product(a: Iterable[Number], b: Iterable[Number]) -> tuple[Number, Number, Number, Number]:
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def _rotated(quaternion: Iterable[Number], vector: Iterable[Number]) -> tuple[Number, Number, Number]:
    w, x, y, z = quaternion
    vx, vy, vz = vector
    tx = 2 * (y * vz - z * vy)
    ty = 2 * (z * vx - x * vz)
    tz = 2 * (x * vy - y * vx)
    return vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx


def quaternion_from_rotation(rotation: Floats) -> tuple[float, float, float, float]:
    """Unit quaternion (w, x, y, z), w >= 0, of a (3, 3) rotation matrix.

    Shepperd's method: S. W. Shepperd, "Quaternion from rotation matrix", 1978.
    """
    m = [[float(v) for v in row] for row in rotation]
    trace = m[0][0] + m[1][1] + m[2][2]
    candidates = (trace, m[0][0], m[1][1], m[2][2])
    best = candidates.index(max(candidates))
    if best == 0:
        q = [1 + trace, m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]]
    else:
        i = best - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q = [0.0] * 4
        q[0] = m[k][j] - m[j][k]
        q[1 + i] = 1 + m[i][i] - m[j][j] - m[k][k]
        q[1 + j] = m[j][i] + m[i][j]
        q[1 + k] = m[k][i] + m[i][k]
    norm = sqrt(sum(v * v for v in q)) * (-1 if q[0] < 0 else 1)
    return (q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm)
