"""Casting rays into the world: the one way that cameras and lidars of the sample see."""

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
    """Return the rays that pass through the sphere around a box."""
    at_once = times_s[0] == times_s[-1]  # a camera: one pose of the box serves all its rays
    centres, _ = box.pose(times_s[:1] if at_once else times_s)
    to_box = centres - (origins[:1] if at_once else origins)
    along = (
        directions[:, 0] * to_box[:, 0] + directions[:, 1] * to_box[:, 1] + directions[:, 2] * to_box[:, 2]
    )
    off = (to_box * to_box).sum(axis=1) - along * along
    reach = sum(side * side for side in box.size_m) / 4
    return np.flatnonzero((off < reach) & (along > -np.sqrt(reach)))


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
    axis = enter.argmax(axis=1).astype(np.int8)
    first, last = enter.max(axis=1), leave.min(axis=1)
    return np.where((first < last) & (first > 0.05), first, np.inf), axis
