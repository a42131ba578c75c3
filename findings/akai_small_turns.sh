#!/usr/bin/env bash
# An arm turns by 30 degrees within a second, recorded 30 times a second; the actions of an episode are the turns from each frame to the next, as axis and angle, by
# akai-transform (`quat2rvec` of `quat.relative_rotation`). Guess: thirty turns of a degree, that add up to 30 degrees.
# Seen with akai-transform 1.0.0 on 2026-11-30, without a word:
# - thirty times NO turn: up to 3.6 degrees (w > 0.9995) the angle is 0. At 5 Hz, 6 degrees apart, all are right; by way of matrices (`rmat2rvec`) also at 30 Hz
# - of quaternions of both signs, as localisation nodes publish them, turns of 10 degrees are 350
# - a half turn about the diagonal of x and y has the axis 0, 0, 0 in `rmat2rvec`; about x, y or z it is right
# - `quat.slerp` half-way between two quaternions of the same pose, 2 degrees apart, one of them with its sign flipped: 180 degrees away from both
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check akai-transform==1.0.0 numpy==2.4.6 2>/dev/null
venv/bin/python - <<'PYTHON'
import numpy as np
from akai_transform import quat, tf3d

AXIS = np.array([1.0, 2.0, 2.0]) / 3


def turns_deg(hz, sign=1, of=lambda turn: tf3d.quat2rvec(turn)[1]):
    """Return the turns from frame to frame within a second."""
    poses = [sign**frame * tf3d.rvec2quat(AXIS, np.radians(30) * frame / hz) for frame in range(hz + 1)]
    return np.degrees([of(quat.relative_rotation(*pair)) for pair in zip(poses, poses[1:])])


slow, fast, flipped = turns_deg(5), turns_deg(30), turns_deg(3, sign=-1)
by_matrices = turns_deg(30, of=lambda turn: tf3d.rmat2rvec(tf3d.quat2rmat(turn))[1])
print(f"30 degrees: at 5 Hz {slow.sum():.3f}, at 30 Hz {fast.sum():.3f}, by matrices {by_matrices.sum():.3f}; signs flipped {flipped.round(3).tolist()}")
assert np.allclose([slow.sum(), by_matrices.sum()], 30, atol=1e-6) and not fast.any() and np.allclose(flipped, 350)

diagonal, length = tf3d.rmat2rvec(tf3d.rvec2rmat(np.array([1, 1, 0]) / np.sqrt(2), np.pi))
print(f"half a turn about the diagonal: {diagonal.tolist()}, {np.degrees(length):.0f} degrees")
assert not diagonal.any() and np.isclose(length, np.pi)
assert tf3d.rmat2rvec(tf3d.rx(np.pi))[0].tolist() == [1, 0, 0]

first, last = tf3d.rvec2quat(AXIS, 0.5), -tf3d.rvec2quat(AXIS, 0.5 + np.radians(2))
away_deg = [2 * np.degrees(np.arccos(abs(quat.dot(quat.slerp(first, last, 0.5), end)))) for end in (first, last)]
print(f"half-way between two poses 2 degrees apart: {np.round(away_deg, 2).tolist()} degrees away from them")
assert np.allclose(away_deg, 179, atol=1e-6)
PYTHON
