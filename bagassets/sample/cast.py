"""Casting rays into the world: the one way that cameras and lidars of the sample see."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.se3 import Floats
from bagassets.sample.world import Thing

__all__ = ["Hits", "cast"]


@dataclass(frozen=True)
class Hits:
    """Where rays end.

    Attributes:
        distance_m: (M,) along the ray; infinite for the sky.
        thing: (M,) track id of the object, 0 for the ground, -1 for the sky.
        face: (M,) axis of the face that was hit: 0 front or back, 1 a side, 2 the top.
    """

    distance_m: Floats
    thing: NDArray[np.int32]
    face: NDArray[np.int8]


def cast(things: Sequence[Thing], origins: Floats, directions: Floats, times_s: Floats) -> Hits:
    """Follow rays to the nearest surface; each sees the world at its own time.

    Args:
        things: the boxes; the ground is the plane z = 0.
        origins: (M, 3) in `odom`.
        directions: (M, 3) unit vectors.
        times_s: (M,) when each ray is cast.
    """
    dz = directions[:, 2]
    distance = np.where(dz < -1e-6, -origins[:, 2] / np.where(dz < -1e-6, dz, -1.0), np.inf)
    thing = np.where(np.isfinite(distance), 0, -1).astype(np.int32)
    face = np.full(len(distance), 2, np.int8)
    for box in things:
        chosen = _near(box, origins, directions, times_s)
        if not len(chosen):
            continue
        hit, axis = _slabs(box, origins[chosen], directions[chosen], times_s[chosen])
        nearer = hit < distance[chosen]
        won = chosen[nearer]
        distance[won] = hit[nearer]
        thing[won] = box.track_id
        face[won] = axis[nearer]
    return Hits(distance, thing, face)


def _near(box: Thing, origins: Floats, directions: Floats, times_s: Floats) -> NDArray[Any]:
    """Return the rays that may hit a box: those within the cone around it as seen from the origins.

    Only a first choice, so the rounding of the product does not matter; how far box and origins
    move between the first and the last ray widens the cone.
    """
    ends, _ = box.pose(times_s[[0, -1]])
    first, last = ends - origins[[0, -1]]
    move, distance = last - first, math.sqrt((first * first).sum())
    reach = math.sqrt(sum(side * side for side in box.size_m)) / 2 + math.sqrt((move * move).sum()) + 0.1
    if distance <= reach:
        return np.arange(len(directions))
    return np.flatnonzero(directions @ (first / distance) > math.sqrt(1 - (reach / distance) ** 2))


def _slabs(
    box: Thing, origins: Floats, directions: Floats, times_s: Floats
) -> tuple[Floats, NDArray[np.int8]]:
    """Intersect rays with a box by the slab method (Kay and Kajiya, 1986)."""
    centres, yaw = box.pose(times_s)
    cos, sin = np.cos(yaw), np.sin(yaw)
    start, way = origins - centres, directions
    local_start = np.stack(
        [cos * start[:, 0] + sin * start[:, 1], cos * start[:, 1] - sin * start[:, 0], start[:, 2]], 1
    )
    local_way = np.stack([cos * way[:, 0] + sin * way[:, 1], cos * way[:, 1] - sin * way[:, 0], way[:, 2]], 1)
    half = np.array([box.size_m[1], box.size_m[0], box.size_m[2]]) / 2
    safe = np.where(np.abs(local_way) < 1e-9, 1e-9, local_way)
    one, other = (-half - local_start) / safe, (half - local_start) / safe
    enter, leave = np.minimum(one, other), np.maximum(one, other)
    # Column by column: reductions over an axis of three are ten times slower.
    first = np.maximum(np.maximum(enter[:, 0], enter[:, 1]), enter[:, 2])
    last = np.minimum(np.minimum(leave[:, 0], leave[:, 1]), leave[:, 2])
    axis = np.where(first == enter[:, 0], 0, np.where(first == enter[:, 1], 1, 2)).astype(np.int8)
    return np.where((first < last) & (first > 0.05), first, np.inf), axis
