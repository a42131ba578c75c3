"""A small world: a circular road with buildings, parked and moving vehicles, pedestrians, and the ego car.

Everything that moves does so in closed form, so the truth is known at any time. Times are
seconds since the start of the drive; lengths are metres in the frame `odom`, z up.
"""

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bagassets.geometry.se3 import SE3, Floats, quaternion_multiply

# Labels surround an object without cutting into it.
LABEL_MARGIN_M = 0.02
# Radius of the ego car's lane; the centre of the circle is (0, RADIUS_M).
RADIUS_M = 90.0


@dataclass(frozen=True)
class Thing:
    """A box in the world.

    Attributes:
        track_id: number of the object, from 1; 0 is the ground.
        category: nuScenes category; empty if it is not annotated.
        size_m: width (y), length (x), height (z); of an annotated thing, those of its label.
        radius_m: distance of its centre from the centre of the road.
        angle_rad: its angle on the circle at time 0.
        speed_mps: speed along the circle, counter-clockwise; 0 at rest.
        yaw_rad: heading relative to the direction of the road.
        colour: red, green, blue.
    """

    track_id: int
    category: str
    size_m: tuple[float, float, float]
    radius_m: float
    angle_rad: float
    speed_mps: float
    yaw_rad: float
    colour: tuple[int, int, int]

    @property
    def body_m(self) -> tuple[float, float, float]:
        """Width, length, height of the visible body; its centre is that of the label."""
        margin = 2 * LABEL_MARGIN_M if self.category else 0.0
        width, length, height = self.size_m
        return width - margin, length - margin, height - margin

    def pose(self, times_s: Floats) -> tuple[Floats, Floats]:
        """Return centres (N, 3) and headings (N,) at times (N,)."""
        angle = self.angle_rad + self.speed_mps / self.radius_m * times_s
        centres = np.stack(
            [
                self.radius_m * np.sin(angle),
                self.radius_m * (1 - np.cos(angle)) + (RADIUS_M - self.radius_m),
                np.full_like(angle, self.size_m[2] / 2),
            ],
            axis=-1,
        )
        return centres, angle + self.yaw_rad


@dataclass(frozen=True)
class Ego:
    """The ego car: along the circle at constant speed, swaying slightly."""

    speed_mps: float
    start_rad: float

    def pose(self, times_s: Floats) -> tuple[Floats, Floats]:
        """Return `odom_SE3_ego` as positions (N, 3) and quaternions w, x, y, z (N, 4)."""
        angle = self.start_rad + self.speed_mps / RADIUS_M * times_s
        positions = np.stack(
            [RADIUS_M * np.sin(angle), RADIUS_M * (1 - np.cos(angle)), 0.01 * np.sin(1.7 * times_s)], axis=-1
        )
        roll, pitch = 0.012 * np.sin(1.3 * times_s), 0.008 * np.sin(2.1 * times_s)
        about = [_about(axis, value) for axis, value in ((2, angle), (1, pitch), (0, roll))]
        return positions, quaternion_multiply(quaternion_multiply(about[0], about[1]), about[2])

    def at(self, time_s: float) -> SE3:
        """Return `odom_SE3_ego` at one time."""
        positions, rotations = self.pose(np.array([time_s]))
        return SE3.create(rotations[0], positions[0])


def _about(axis: int, angle: Floats) -> Floats:
    quaternion = np.zeros((*angle.shape, 4))
    quaternion[..., 0] = np.cos(angle / 2)
    quaternion[..., 1 + axis] = np.sin(angle / 2)
    return quaternion


class World:
    """The world of one seed."""

    def __init__(self, seed: int) -> None:
        dice = random.Random(seed)
        self.ego = Ego(dice.uniform(6.5, 9.0), dice.uniform(-0.1, 0.1))
        self.things: Sequence[Thing] = tuple(self._draw(dice))

    def _draw(self, dice: random.Random) -> list[Thing]:
        things: list[Thing] = []
        ahead_rad = self.ego.start_rad

        def add(category: str, size: tuple[float, float, float], lateral_m: float, along_m: float,
                speed: float = 0.0, yaw: float = 0.0) -> None:  # fmt: skip
            radius = RADIUS_M - lateral_m  # left of the lane is nearer to the centre
            colour = (dice.randint(60, 230), dice.randint(60, 230), dice.randint(60, 230))
            angle = ahead_rad + along_m / RADIUS_M
            things.append(Thing(len(things) + 1, category, size, radius, angle, speed, yaw, colour))

        for i in range(7):
            for sign, lateral, along in ((1.0, 22.0, -20.0), (-1.0, 24.0, -14.0)):
                size = (12.0, dice.uniform(10, 18), dice.uniform(6, 15))
                add("", size, sign * (lateral + dice.uniform(0, 6)), 24.0 * i + along)
        for i in range(5):
            add("vehicle.car", (1.9, dice.uniform(4.1, 4.9), 1.5), -4.6, 12.0 + 14 * i + dice.uniform(0, 5))
        # Beyond the pavement, where it occludes nobody, and within 50 m of the first seconds of every drive.
        add("vehicle.truck", (2.5, 8.0, 3.2), 12.5, 26.0 + dice.uniform(0, 5))
        add("vehicle.car", (1.9, 4.5, 1.5), 0.0, dice.uniform(16, 20), speed=self.ego.speed_mps * 0.98)
        for along in (62.0, 97.0):
            add("vehicle.car", (1.9, 4.4, 1.5), 3.6, along + dice.uniform(0, 8), speed=-7.5, yaw=math.pi)
        for i in range(4):
            side = 8.5 if i % 2 else -7.5
            direction = dice.choice((-1.0, 1.0))
            yaw = 0.0 if direction > 0 else math.pi
            add("human.pedestrian.adult", (0.6, 0.6, 1.75), side, 25.0 + 9 * i + dice.uniform(0, 4),
                speed=1.3 * direction, yaw=yaw)  # fmt: skip
        return things
