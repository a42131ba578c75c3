"""Points of a sensor and boxes: how many points are in each box, and how many rays end in front of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.se3 import SE3, Floats, rotate

# Largest error of a point due to float32 and two transformations.
ROUNDING_M = 1e-3
# A return farther in front of a box is another object; a nearer one may be a mirror, a coupling, or a tight box.
BEFORE_M = 0.3
# Only rays through the core of a box count, not those along its faces or over the ground that it stands on.
CORE = 0.9
# Of larger clouds, every n-th ray counts; n is prime, because the points of most clouds come in columns of 2^k.
_RAYS, _STEPS = 32_768, (1, 2, 3, 5, 7, 11, 13, 17, 23, 31, 47, 61, 97, 127, 251, 509, 1021)

# Up to so many pairs of a box and a point, as radars have, all are examined.
_ALL_PAIRS = 2048
_SECTORS = 4096  # per turn
_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Hits:
    """The points and rays of one sensor at (B,) boxes.

    Attributes:
        inside: number of points in each box, its surface included.
        rays: number of rays, from a sample of the points, that pass through the core of each box or point at it.
        blocked: number of these rays that end in front of the box.
    """

    inside: NDArray[np.int64]
    rays: NDArray[np.int64]
    blocked: NDArray[np.int64]


def hits_of(
    points: NDArray[np.float32],
    global_SE3_sensor: SE3,
    centers_m: Floats,
    rotations: Floats,
    sizes_m: Floats,
    moves_m: Floats,
) -> Hits:
    """Count points in boxes and rays to boxes.

    Args:
        points: (N, 3) in the sensor frame, at whose origin the rays begin; NaN points are ignored.
        global_SE3_sensor: pose of the sensor.
        centers_m: (B, 3) box centres in the global frame.
        rotations: (B, 4) `global <- box` quaternions.
        sizes_m: (B, 3) width, length, height.
        moves_m: (B,) how far each object moves during one revolution: points so far in front of its box may be its own.
    """
    centers = global_SE3_sensor.inverse().transform_points(centers_m)
    radii: Floats = np.sqrt((sizes_m * sizes_m).sum(axis=1)) / 2 + ROUNDING_M
    pairs = _pairs_near(points, centers, radii)
    # In the frames of the boxes: the origins of rays (B, 3), and the ends of the rays in pairs (M, 3).
    half, box_Q_global = sizes_m[:, [1, 0, 2]] / 2, rotations * _CONJUGATE
    origins = rotate(box_Q_global, np.array(global_SE3_sensor.translation) - centers_m)
    offsets = global_SE3_sensor.transform_points(pairs.points) - centers_m[pairs.box]
    ends = rotate(box_Q_global[pairs.box], offsets)
    inside = _all_three(np.abs(ends) <= half[pairs.box])
    # If the sensor is inside a box, nothing is in front of it.
    rays = np.flatnonzero(pairs.is_ray & ~_all_three(np.abs(origins) <= half)[pairs.box])
    box = pairs.box[rays]
    ways = ends[rays] - origins[box]
    # Positions along the ray: 0 is the sensor, 1 the point. Slab method (Kay and Kajiya, 1986).
    per_m = 1.0 / np.where(np.abs(ways) < 1e-9, 1e-9, ways)
    middle, reach = -origins[box] * per_m, np.abs(half[box] * per_m)
    into_core, out_of_core = _greatest(middle - reach * CORE), -_greatest(reach * -CORE - middle)
    through = (into_core <= out_of_core) & (out_of_core > 0)
    with np.errstate(divide="ignore"):  # plug-ins may give targets at the radar itself
        slack = (BEFORE_M + moves_m[box]) / np.sqrt((ways * ways).sum(axis=1))
    blocked = through & (_greatest(middle - reach) > 1.0 + slack) & ~inside[rays]
    return Hits(
        *(
            np.bincount(boxes, minlength=len(centers_m)).astype(np.int64)
            for boxes in (pairs.box[inside], box[through], box[blocked])
        )
    )


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of a box and a point in or near it, or whose ray may pass it.

    Attributes:
        box: (M,) indices.
        points: (M, 3) in the sensor frame.
        is_ray: (M,) whether the ray of the point counts.
    """

    box: NDArray[np.intp]
    points: Floats
    is_ray: NDArray[np.bool_]


def _pairs_near(points: NDArray[np.float32], centers: Floats, radii: Floats) -> _Pairs:
    """Find the few points, among 10^5, in the ball around each box, and those of a sample whose rays pass the ball.

    Points are sorted by azimuth, or rather by a quotient that grows with it: sums and quotients are exact on every machine.

    Args:
        points: (N, 3) in the sensor frame.
        centers: (B, 3) in the sensor frame.
        radii: (B,) radii of the balls.
    """
    px, py, pz = (np.ascontiguousarray(points[:, axis]) for axis in range(3))
    finite = np.isfinite(px + py + pz)
    if not finite.all():
        px, py, pz = px[finite], py[finite], pz[finite]
    if len(px) * len(centers) <= _ALL_PAIRS:
        box, row = (part.reshape(-1) for part in np.indices((len(centers), len(px))))
        return _Pairs(
            box, np.stack([px, py, pz], axis=1)[row].astype(np.float64), np.ones(len(box), np.bool_)
        )
    step = next(step for step in (*_STEPS, len(px)) if len(px) <= step * _RAYS)
    sampled = np.zeros(len(px), dtype=np.bool_)
    sampled[::step] = True
    sectors = _sectors(px, py)
    # A stable sort of 16-bit numbers is a radix sort: the same order on every machine, in linear time.
    order = np.argsort(sectors, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(sectors, minlength=_SECTORS))])
    x, y, z = centers.T
    flat, square = x * x + y * y, radii * radii
    # Tangents from the sensor to the ball, seen from above.
    all_around = flat <= square * 1.01
    sine = radii / np.sqrt(np.where(all_around, 2 * square, flat))
    cosine = np.sqrt(1.0 - sine * sine)
    first = np.where(all_around, 0, _sectors(cosine * x + sine * y, cosine * y - sine * x) - 1)
    last = np.where(all_around, _SECTORS - 1, _sectors(cosine * x - sine * y, cosine * y + sine * x) + 1)
    # Sectors form a ring: a range across its seam has two parts.
    first, last = np.where(first < 0, first + _SECTORS, first), np.where(last >= _SECTORS, 0, last)
    over = first > last
    lows = np.concatenate([starts[first], np.zeros(np.count_nonzero(over), np.intp)])
    highs = np.concatenate([np.where(over, len(px), starts[last + 1]), starts[last[over] + 1]])
    numbers = highs - lows
    box = np.repeat(np.concatenate([np.arange(len(centers)), np.flatnonzero(over)]), numbers)
    row = order[np.arange(len(box)) + np.repeat(lows - np.cumsum(numbers) + numbers, numbers)]
    if step > 1:
        in_slab = np.abs(px[row] - x.astype(np.float32)[box]) <= radii.astype(np.float32)[box]
        possible = np.flatnonzero(sampled[row] | in_slab)
        box, row = box[possible], row[possible]
    qx, qy, qz = px[row], py[row], pz[row]
    cx, cy, cz = (axis.astype(np.float32)[box] for axis in (x, y, z))
    dx, dy, dz = qx - cx, qy - cy, qz - cz
    in_ball = dx * dx + dy * dy + dz * dz <= square.astype(np.float32)[box]
    # A cone slightly wider than the ball; there is none if the ball contains the sensor.
    apart = flat + z * z - square
    least = np.where(apart > 0.01 * square, apart * 0.995, 0.0).astype(np.float32)[box]
    along = qx * cx + qy * cy + qz * cz
    in_cone = (along * along >= (qx * qx + qy * qy + qz * qz) * least) & ((along > 0) | (least == 0))
    is_ray = in_cone & sampled[row]
    kept = np.flatnonzero(is_ray | in_ball)
    near = np.stack([qx[kept], qy[kept], qz[kept]], axis=1).astype(np.float64)
    return _Pairs(box[kept], near, is_ray[kept])


def _sectors(x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.int16]:
    """Return the sector of each direction, counter-clockwise from x."""
    length = np.abs(x) + np.abs(y)
    part = np.divide(y, length, out=np.zeros_like(y), where=length > 0)  # from -1 to 1 in each quarter
    turn = np.where(x < 0, 2 - part, np.where(part < 0, 4 + part, part))
    # Just below a whole turn may round up to it.
    sectors: NDArray[np.int16] = (turn * (_SECTORS // 4)).astype(np.int16) & np.int16(_SECTORS - 1)
    return sectors


def _all_three(truths: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (M,) whether all three of (M, 3) are true; numpy is ten times slower along an axis of three."""
    every: NDArray[np.bool_] = truths[:, 0] & truths[:, 1] & truths[:, 2]
    return every


def _greatest(values: Floats) -> Floats:
    """Return the (M,) greatest of (M, 3)."""
    greatest: Floats = np.maximum(np.maximum(values[:, 0], values[:, 1]), values[:, 2])
    return greatest
