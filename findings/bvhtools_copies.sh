#!/usr/bin/env bash
# A take of motion capture (BVH, 120 Hz, one second) becomes training data with bvhTools: quaternions of the take; then of copies of it, turned by 90 degrees about the vertical, mirrored, and resampled
# to 30 Hz. Guess: quaternions of what is in each copy, as many as it has frames; at 30 Hz the pose of 0.5 s at 0.5 s.
# Seen with bvhTools 1.6.0 on 2026-11-30, without a word:
# - the turned and the mirrored copy have the quaternions of the ORIGINAL, number by number, and the resampled one has 120 of them for its 30 frames: what was once asked for is kept, and copied with the
#   take. Not asked for before, all are right; whoever looks at the original first augments nothing
# - resampled: 30 frames at 1/30 s last 0.967 s, and hold 0.992 s of motion: first and last frames are the take's, so it is 2.6 % faster, and the last pose 25 ms too early. To 10 Hz it is 10 %
# - `getFootContactsSpeedMethod` has a number per axis, with its sign: a foot that slides backwards at 1 m/s is "in contact" along that axis in every frame
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check bvhTools==1.6.0 numpy==2.4.6 scipy==1.17.1 2>/dev/null
cat > augment.py <<'PYTHON'
from pathlib import Path

import numpy as np
from bvhTools.bvhIO import readBvh
from bvhTools.bvhManipulation import mirrorSkeleton, rotateSkeletonWorld
from bvhTools.bvhMetrics import getFootContactsSpeedMethod
from bvhTools.bvhMotionEditor import resampleFPS

RATE_HZ = 120
SKELETON = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT LeftFoot
  {
    OFFSET 0.1 -0.9 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 0 0.2
    }
  }
}
"""
# The hips go backwards at 1 m/s, and turn by 60 degrees a second about the vertical and 20 sideways.
times_s = np.arange(RATE_HZ) / RATE_HZ
rows = [f"0 0.9 {-time_s:.6f} {20 * time_s:.6f} 0 {60 * time_s:.6f} {30 * time_s:.6f} 0 0" for time_s in times_s]
Path("take.bvh").write_text(SKELETON + f"MOTION\nFrames: {RATE_HZ}\nFrame Time: {1 / RATE_HZ:.8f}\n" + "\n".join(rows) + "\n")

copies = {
    "turned": lambda take: rotateSkeletonWorld(take, [0, 90, 0]),
    "mirrored": lambda take: mirrorSkeleton(take, "X", []),
    "at 30 Hz": lambda take: resampleFPS(take, 30),
}
for name, make in copies.items():
    fresh = np.array(make(readBvh("take.bvh")).motion.getRepresentation("quaternion"))
    take = readBvh("take.bvh")
    before = np.array(take.motion.getRepresentation("quaternion"))
    copy = make(take)
    after = np.array(copy.motion.getRepresentation("quaternion"))
    print(f"{name}: {copy.motion.numFrames} frames, {len(after)} rows; as the original: {np.array_equal(after, before)}; not asked before: {fresh.shape}, differs by {abs(fresh[9] - after[9]).max():.2f}")
    assert np.array_equal(after, before) and len(fresh) == copy.motion.numFrames and abs(fresh[9] - after[9]).max() > 0.01

for rate_hz, percent in ((30, 2.6), (10, 10.2)):
    copy = resampleFPS(readBvh("take.bvh"), rate_hz)
    travelled_m = -np.array(copy.motion.frames)[:, 2]
    took_s = copy.motion.frameTime * (copy.motion.numFrames - 1)
    print(f"to {rate_hz} Hz: {copy.motion.numFrames} frames in {took_s:.3f} s, and {travelled_m[-1]:.3f} m at 1 m/s: {100 * (travelled_m[-1] / took_s - 1):.1f} % faster")
    assert np.isclose(travelled_m[-1], 119 / 120, atol=1e-5) and np.isclose(100 * (travelled_m[-1] / took_s - 1), percent, atol=0.06)

contacts = getFootContactsSpeedMethod(readBvh("take.bvh"), ["LeftFoot"])
print("contacts of a foot that slides back:", contacts.shape, f"- along z {contacts[0, :, 2].mean():.0%} of them true")
assert contacts.shape == (1, RATE_HZ, 3) and contacts[0, :, 2].all()
PYTHON
venv/bin/python -W error augment.py
