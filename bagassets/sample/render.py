"""Rendering the sensors of the sample car: images, lidar revolutions, radar targets."""

from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.camera import CameraModel
from bagassets.geometry.se3 import SE3, Floats, quaternion_multiply, rotate
from bagassets.sample.cast import Hits, cast
from bagassets.sample.rig import EGO_SE3_LIDAR, EGO_SE3_RADAR, LIDAR, RADAR, Camera
from bagassets.sample.world import RADIUS_M, World

SKY = np.array([205, 220, 235], np.float32)
# Brightness of the faces of a box: front and back, sides, top.
_FACE_LIGHT = np.array([0.72, 0.86, 1.0])
# Dark and light grains of road, grass, walk and markings.
_GROUND = np.array(
    [
        [[92, 94, 98], [98, 100, 104]],
        [[88, 128, 74], [94, 140, 80]],
        [[150, 148, 142], [156, 154, 148]],
        [[235, 235, 235]] * 2,
    ],
    np.float32,
)


def rays_of(model: CameraModel) -> Floats:
    """Return the unit ray of each pixel centre, (H, W, 3), in the optical frame."""
    columns, rows = np.meshgrid(np.arange(model.width), np.arange(model.height))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    xy: NDArray[Any]
    d = np.array(model.distortion)
    if not model.distorts:
        xy = (pixels - [model.cx, model.cy]) / [model.fx, model.fy]
    elif model.model == "equidistant":
        xy = cv2.fisheye.undistortPoints(pixels, model.matrix, d)
    else:
        criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 60, 1e-10)
        xy = cv2.undistortPointsIter(pixels, model.matrix, d, np.eye(3), np.eye(3), criteria)
    rays = np.concatenate([xy.reshape(-1, 2), np.ones((len(pixels), 1))], axis=1)
    unit: Floats = rays / np.sqrt((rays * rays).sum(axis=1))[:, None]
    return unit.reshape(model.height, model.width, 3)


class CameraView:
    """Renders one camera; the rays of its pixels are computed once."""

    def __init__(self, world: World, camera: Camera) -> None:
        self._world = world
        self._camera = camera

    @cached_property
    def _rays(self) -> Floats:
        return rays_of(self._camera.model).reshape(-1, 3)

    def hits(self, time_s: float) -> Hits:
        """Return what each pixel sees, row by row."""
        return self._cast(time_s)[0]

    def image(self, time_s: float) -> NDArray[np.uint8]:
        """Return the image as (H, W, 3) BGR."""
        hits, directions, place = self._cast(time_s)
        sky, ground = np.flatnonzero(hits.thing < 0), np.flatnonzero(hits.thing == 0)
        paint = np.zeros((len(self._world.things) + 2, 3))  # the last row is the sky's, at index -1
        for thing in self._world.things:
            paint[thing.track_id] = thing.colour
        lit = (paint[:, None, :] * _FACE_LIGHT[:, None]).reshape(-1, 3).astype(np.float32)
        colours = lit[3 * hits.thing + hits.face]
        colours[sky] = SKY - 60.0 * np.clip(directions[sky, 2:3], 0.0, 1.0)
        spots = place + directions[ground] * hits.distance_m[ground, None]
        colours[ground] = _ground_colour(spots)
        haze = np.minimum(hits.distance_m.astype(np.float32) / 220, np.float32(0.8))
        haze[sky] = 0
        colours += (SKY - colours) * haze[:, None]
        shape = (self._camera.model.height, self._camera.model.width, 3)
        image: NDArray[np.uint8] = np.clip(colours, 0, 255).astype(np.uint8).reshape(shape)[:, :, ::-1]
        return np.ascontiguousarray(image)

    def _cast(self, time_s: float) -> tuple[Hits, Floats, Floats]:
        """Return hits and directions of the rays, and the place of the camera."""
        odom_SE3_cam = self._world.ego.at(time_s) @ self._camera.ego_SE3_cam
        place = np.array(odom_SE3_cam.translation)
        directions: Floats = rotate(np.array(odom_SE3_cam.rotation), self._rays)
        return cast(self._world.things, place[None], directions, np.array([time_s])), directions, place


def _ground_colour(spots: Floats) -> NDArray[np.float32]:
    """Asphalt with lane markings along the circle, grass beyond."""
    x, y = spots[:, 0], spots[:, 1] - RADIUS_M
    lateral = RADIUS_M - np.sqrt(x * x + y * y)
    along = np.arctan2(x, -y) * RADIUS_M
    grain = np.mod(np.floor(x * 4) + np.floor(y * 4), 2).astype(np.intp)
    surface = np.where((lateral > -6.2) & (lateral < 6.6), 0, 1)
    surface[(np.abs(lateral - 8.4) < 1.6) | (np.abs(lateral + 7.6) < 1.3)] = 2
    dashes = (np.abs(lateral - 1.8) < 0.09) & (np.mod(along, 6.0) < 3.0)
    surface[dashes | (np.abs(lateral - 5.5) < 0.08) | (np.abs(lateral + 3.3) < 0.08)] = 3
    colours: NDArray[np.float32] = _GROUND[surface, grain]
    return colours


def cast_from(world: World, azimuths: Floats, elevations: Floats, times_s: Floats) -> tuple[Floats, Hits]:
    """Cast rays (M,) of the lidar, each at its own time; return them, in the frame of the lidar, and what they hit."""
    rays = np.stack(
        [np.cos(elevations) * np.cos(azimuths), np.cos(elevations) * np.sin(azimuths), np.sin(elevations)],
        axis=-1,
    )
    positions, rotations = world.ego.pose(times_s)
    origins = positions + rotate(rotations, np.array(EGO_SE3_LIDAR.translation))
    directions = rotate(quaternion_multiply(rotations, np.array(EGO_SE3_LIDAR.rotation)), rays)
    return rays, cast(world.things, origins, directions, times_s)


def lidar_points(world: World, start_s: float) -> NDArray[np.void]:
    """Return one revolution that begins at a time, as a structured array in the sensor's frame.

    Fields: x, y, z, intensity (float32), ring (uint16), t (uint32, nanoseconds since the start). A
    few returns are NaN, as real drivers send them.
    """
    azimuth = -2 * np.pi * np.arange(LIDAR.columns) / LIDAR.columns  # clockwise, from straight ahead
    elevation = np.deg2rad(np.linspace(LIDAR.lowest_deg, LIDAR.highest_deg, LIDAR.rings))
    azimuths, elevations = (one.ravel() for one in np.meshgrid(azimuth, elevation, indexing="ij"))
    times = np.repeat(
        start_s + np.arange(LIDAR.columns) / LIDAR.columns * LIDAR.period_ns * 1e-9, LIDAR.rings
    )
    rays, hits = cast_from(world, azimuths, elevations, times)
    seen = (hits.distance_m < LIDAR.range_m) & (hits.thing >= 0)
    kind = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("t", "<u4")]
    points = np.zeros(int(seen.sum()), kind)
    xyz = rays[seen] * hits.distance_m[seen, None]
    for i, name in enumerate(("x", "y", "z")):
        points[name] = xyz[:, i]
    points["intensity"] = 20 + (hits.thing[seen] * 37) % 200
    points["ring"] = np.tile(np.arange(LIDAR.rings), LIDAR.columns)[seen]
    points["t"] = np.round((times - start_s)[seen] * 1e9)
    points["x"][::997] = np.nan
    return points


def radar_targets(
    world: World, time_s: float, ego_SE3_radar: SE3 = EGO_SE3_RADAR, *, buildings: bool = False
) -> list[dict[str, float]]:
    """Return a radar's targets at a time: one for each vehicle, pedestrian or, if so wished, building that it sees.

    Position and velocity in the sensor's frame: `vx`, `vy`, `vz` relative to it, `vx_comp`, `vy_comp` over ground.
    """
    odom_SE3_radar = world.ego.at(time_s) @ ego_SE3_radar
    radar_SE3_odom = odom_SE3_radar.inverse()
    step_s = 1e-3
    later = np.array((world.ego.at(time_s + step_s) @ ego_SE3_radar).translation)
    radar_velocity = (later - np.array(odom_SE3_radar.translation)) / step_s
    targets = []
    for thing in world.things:
        if not (thing.category or buildings):
            continue
        centres, _ = thing.pose(np.array([time_s, time_s + step_s]))
        x, y, z = radar_SE3_odom.transform_points(centres[:1])[0]
        if not (1.0 < x < RADAR.range_m and abs(y) < x):
            continue
        velocity = (centres[1] - centres[0]) / step_s
        still = rotate(np.array(radar_SE3_odom.rotation), velocity)
        moving = rotate(np.array(radar_SE3_odom.rotation), velocity - radar_velocity)
        target = {"x": x, "y": y, "z": z, "rcs": 10.0 if "vehicle" in thing.category else -2.0}
        target |= zip(("vx", "vy", "vz"), moving, strict=True)
        targets.append(target | {"vx_comp": still[0], "vy_comp": still[1]})
    return targets
