#!/usr/bin/env bash
# A handheld camera's poses, 120 of them, shake by 2 degrees about its axis as it moves ahead; it is held with its right side 10 degrees low. deltacamera smooths them
# (`smooth_cameras`), and finds one between two (`interpolate_cameras`). Its world has y down, as with OpenCV, which is what it takes by itself, or z up, `world_up=(0, 0, 1)`, as in robotics.
# Guess: the poses without the shaking, held as before; between two, at the begin (0) the first and at the end (1) the second.
# Seen with deltacamera 0.9.0 on 2026-11-30, without a word: the LEFT side is 10 degrees low, 20 off: the roll that was there is put on with the other sign. With z up a level camera
# lies on its side, 90 degrees off, as roll is measured against the world's y, whatever is up. Between two, cameras are level, 10 degrees off even at 0 and 1; `slerp_cameras` is right
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check deltacamera==0.9.0 opencv-python==5.0.0.93 scipy==1.17.1 numpy==2.4.6
venv/bin/python - <<'PYTHON'
import numpy as np
from deltacamera import Camera
from deltacamera.trajectory import interpolate_cameras, slerp_cameras, smooth_cameras
from scipy.spatial.transform import Rotation

INTRINSICS = np.array([[500, 0, 320], [0, 500, 240], [0, 0, 1]], np.float32)
WORLDS = {  # what is up, and the rotation of a level camera that looks ahead: rows are its right, down and ahead
    "y down": ((0, -1, 0), np.eye(3)),
    "z up": ((0, 0, 1), np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])),
}


def camera(world, low_deg, metres):
    """Return a camera that has gone so far ahead, with its right side low by so many degrees: turned about its axis, clockwise as it looks."""
    up, level = WORLDS[world]
    held = Rotation.from_euler("z", -low_deg, degrees=True).as_matrix() @ level
    place = (metres * level[2]).astype(np.float32)
    return Camera(rot_world_to_cam=held.astype(np.float32), optical_center=place, intrinsic_matrix=INTRINSICS, image_shape=(480, 640), world_up=up)


def low_deg(found, world):
    """Return by how many degrees the right side is low, of a camera that looks ahead."""
    right = WORLDS[world][1] @ found.R[0]
    assert np.allclose(WORLDS[world][1] @ found.R[2], [0, 0, 1], atol=1e-3)
    return np.degrees(np.arctan2(right[1], right[0]))


for world, held_deg, expected_deg in (("y down", 0, 0), ("y down", 10, -10), ("y down", -10, 10), ("z up", 0, 90), ("z up", 10, 80)):
    shaken = [camera(world, held_deg + (2 if number % 2 else -2), number * 0.05) for number in range(120)]
    smoothed = low_deg(smooth_cameras(shaken)[60], world)
    first, second = camera(world, held_deg, 0), camera(world, held_deg, 1)
    between = [low_deg(interpolate(first, second, share), world) for interpolate in (interpolate_cameras, slerp_cameras) for share in (0.0, 1.0)]
    print(f"{world}, right side low by {held_deg} degrees: smoothed {smoothed:.1f}, interpolate_cameras {between[0]:.1f}, {between[1]:.1f}, slerp_cameras {between[2]:.1f}")
    assert np.allclose([smoothed, *between], [expected_deg, 0, 0, held_deg, held_deg], atol=0.2)
PYTHON
