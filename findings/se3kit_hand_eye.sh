#!/usr/bin/env bash
# A camera on an arm's hand is calibrated with se3kit (`EyeInHandCalibration`) from twelve poses of the hand and what the camera sees of a board, without noise. It is
# mounted 8 cm from the flange, and turned about its axis by nothing, by a quarter, or upside down, as cameras on wrists are.
# Guess: where it is, each time. Seen with se3kit 1.0.6 on 2026-11-30, without a word: right if it is not turned; 25 cm and 180 degrees off after a quarter turn, 18 cm
# and 180 degrees upside down: of AX = XB the quaternions of both sides are compared whatever their signs, and the translation is found from X (b - a), where Xb - a
# belongs. SciPy, by the textbook, is right to 1e-9 from the same poses.
# Angles about moving axes come back with the roll's sign turned: `from_rpy([0.3, 0.2, 0.1], extrinsic=False).as_rpy(extrinsic=False)`; about fixed axes they are right
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check se3kit==1.0.6 numpy-quaternion==2024.0.13 scipy==1.17.1 numpy==2.4.6 2>/dev/null
venv/bin/python - <<'PYTHON'
import numpy as np
from scipy.spatial.transform import Rotation as Turn
from se3kit.calibration.eye_in_hand_calibration import EyeInHandCalibration
from se3kit.rotation import Rotation
from se3kit.transformation import Transformation
from se3kit.translation import Translation


def pose(turn, place_m):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn.as_matrix(), place_m
    return matrix


def theirs(matrix):
    return Transformation(Translation(matrix[:3, 3].copy()), Rotation(matrix[:3, :3].copy()))


def right_answer(hands, boards):
    """Return hand_SE3_camera by the textbook: axes of motions are aligned, then AX = XB is solved for the translation."""
    pairs = [(np.linalg.inv(hands[i]) @ hands[j], boards[i] @ np.linalg.inv(boards[j])) for i in range(12) for j in range(i + 1, 12)]
    axes = [[Turn.from_matrix(motion[:3, :3]).as_rotvec() for motion in pair] for pair in pairs]
    turn = Turn.align_vectors(*np.swapaxes(axes, 0, 1))[0]
    left = np.vstack([a[:3, :3] - np.eye(3) for a, _ in pairs])
    right = np.hstack([turn.apply(b[:3, 3]) - a[:3, 3] for a, b in pairs])
    return pose(turn, np.linalg.lstsq(left, right)[0])


random = np.random.default_rng(1)
downwards = Turn.from_euler("x", 180, degrees=True)
base_SE3_hand = [pose(downwards * Turn.from_euler("xyz", random.uniform(-0.5, 0.5, 3)), [0.5, 0, 0.5] + random.uniform(-0.15, 0.15, 3)) for _ in range(12)]
base_SE3_board = pose(Turn.from_euler("xyz", [0.1, 0.2, 0.3]), [0.6, 0.1, 0.0])
found = {}
for turned_deg in (0, 90, 180):
    hand_SE3_camera = pose(Turn.from_euler("z", turned_deg, degrees=True), [0.05, 0.02, 0.08])
    camera_SE3_board = [np.linalg.inv(hand @ hand_SE3_camera) @ base_SE3_board for hand in base_SE3_hand]
    assert np.allclose(right_answer(base_SE3_hand, camera_SE3_board), hand_SE3_camera, atol=1e-9)
    result = EyeInHandCalibration([theirs(each) for each in base_SE3_hand], [theirs(each) for each in camera_SE3_board]).run_calibration()
    off_m = np.linalg.norm(result.translation.m.ravel() - hand_SE3_camera[:3, 3])
    off_deg = np.degrees(Turn.from_matrix(hand_SE3_camera[:3, :3].T @ result.rotation.m).magnitude())
    found[turned_deg] = off_m, off_deg
    print(f"turned by {turned_deg} degrees: at {result.translation.m.ravel().round(3)} m, {off_m:.3f} m and {off_deg:.0f} degrees off")
assert np.allclose(found[0], 0, atol=1e-6)
assert np.allclose([found[90], found[180]], [[0.250, 180], [0.178, 180]], atol=1e-3)

angles = Rotation.from_rpy([0.3, 0.2, 0.1], extrinsic=False).as_rpy(extrinsic=False)
print("0.3, 0.2, 0.1 comes back as", angles.round(6).tolist())
assert np.allclose(angles, [-0.3, 0.2, 0.1])
assert np.allclose(Rotation.from_rpy([0.3, 0.2, 0.1]).as_rpy(), [0.3, 0.2, 0.1])
PYTHON
