#!/usr/bin/env bash
# A take of motion capture (BVH), in centimetres as usual, of hips, arm and hand, becomes positions in metres for retargeting: with bvhtoolbox, `bvh2csv --position --scale 0.01`, whose help
# says "In case you have to switch from centimeters to meters"; and as shares of the height of the person, with bvhTools, `getFKAtFrameNormalized(0, "height")`. In another take the arm
# has position channels, too, as with software that lets bones stretch: they are its place in the hips, in place of OFFSET.
# Guess: positions divided by 100, and by the height. Seen with bvhtoolbox 0.1.3, bvhTools 1.6.0, bvhio 1.5.4 and pybvh 0.9.0 on 2026-11-30; in centimetres all four agree:
# - bvhtoolbox, without a word: right for the hips alone. Each joint is scaled once more than the one that it hangs on: the arm is 1.3 m, the hand 1.4 m from its place;
#   what is a metre apart in the first bone is a centimetre in the next. And `bvh2csv` ends with the code 1 if all went well, 0 if it did not
# - bvhTools, without a word: they are divided by the WIDTH, and "width" divides by the height
# - the bone that stretches: right in bvhio; pybvh refuses; bvhTools warns and leaves it as in OFFSET; bvhtoolbox does so without a word
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check bvhtoolbox==0.1.3 bvhTools==1.6.0 bvhio==1.5.4 pybvh==0.9.0 \
  numpy==2.4.6 scipy==1.17.1 transforms3d==0.4.2
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import subprocess

import bvhio
import numpy as np
import pybvh
from bvhTools.bvhIO import readBvh
from scipy.spatial.transform import Rotation

HIPS, OFFSET, STRETCHED, BONE = np.array([100.0, 90, 5]), [0, 30, 0], [0, 35, 0], [40, 0, 0]
TURN, BEND = [30, 0, 0], [10, 20, 30]  # degrees, in the orders of channels: ZXY of the hips, ZYX of the arm
POSITIONS = "Xposition Yposition Zposition"


def write(path, stretches):
    """Write a take of two equal frames; return where hips, arm and hand are, centimetres."""
    arm = f"6 {POSITIONS}" if stretches else "3"
    offsets = [" ".join(map(str, each)) for each in (OFFSET, BONE)]
    values = [*HIPS, *TURN, *(STRETCHED if stretches else []), *BEND, 0, 0, 0]
    with open(path, "w") as file:
        file.write(f"HIERARCHY\nROOT Hips\n{{\nOFFSET 0 0 0\nCHANNELS 6 {POSITIONS} Zrotation Xrotation Yrotation\n")
        file.write(f"JOINT Arm\n{{\nOFFSET {offsets[0]}\nCHANNELS {arm} Zrotation Yrotation Xrotation\n")
        file.write(f"JOINT Hand\n{{\nOFFSET {offsets[1]}\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{{\nOFFSET 10 0 0\n}}\n}}\n}}\n}}\n")
        file.write("MOTION\nFrames: 2\nFrame Time: 0.01\n" + 2 * (" ".join(f"{each:.4f}" for each in values) + "\n"))
    hips = Rotation.from_euler("ZXY", TURN, degrees=True)
    at = HIPS + hips.apply(STRETCHED if stretches else OFFSET)
    return np.array([HIPS, at, at + (hips * Rotation.from_euler("ZYX", BEND, degrees=True)).apply(BONE)])


def by_bvhtoolbox(path, *options):
    ended = subprocess.run(["venv/bin/bvh2csv", "--position", *options, path], capture_output=True, check=False)
    assert ended.returncode == 1 and not ended.stderr
    return np.genfromtxt(path.replace(".bvh", "_pos.csv"), delimiter=",", skip_header=1)[0, 1:].reshape(-1, 3)


def by_bvhtools(path, **normalised):
    take = readBvh(path)
    found = take.getFKAtFrameNormalized(0, **normalised) if normalised else take.getFKAtFrame(0)
    return np.array([found[name][1] for name in ("Hips", "Arm", "Hand")])


def by_bvhio(path):
    return np.array([list(joint.PositionWorld) for joint, _, _ in bvhio.readAsHierarchy(path).loadPose(0).layout()])


right = write("take.bvh", False)
for found in (by_bvhtoolbox("take.bvh"), by_bvhtools("take.bvh"), by_bvhio("take.bvh"), pybvh.read_bvh_file("take.bvh").joint_positions(0)):
    assert np.allclose(found, right, atol=0.001)
metres = by_bvhtoolbox("take.bvh", "--scale", "0.01")
off = np.linalg.norm(metres - right / 100, axis=1)
print("bvhtoolbox, metres:", metres.round(3).tolist(), "off by", off.round(2), "m")
assert np.allclose(metres[0], right[0] / 100) and off.round(1).tolist() == [0, 1.3, 1.4]
take = readBvh("take.bvh")
everything = np.array([position for _, position in take.getFKAtFrame(0).values()])
width, height, _ = np.ptp(everything, axis=0)
shares = by_bvhtools("take.bvh", skeletonDim="height")
print(f"bvhTools: {height:.1f} cm high, {width:.1f} wide; the hips, at {HIPS[1]} cm, are at {shares[0, 1]:.2f} heights")
assert np.allclose(shares, right / width) and np.allclose(by_bvhtools("take.bvh", skeletonDim="width"), right / height)

stretched = write("stretched.bvh", True)
fixed = stretched - [0 * HIPS, *2 * [stretched[1] - right[1]]]
assert np.allclose(by_bvhio("stretched.bvh"), stretched, atol=0.001)
for found in (by_bvhtoolbox("stretched.bvh"), by_bvhtools("stretched.bvh")):
    assert np.allclose(found, fixed, atol=0.001) and not np.allclose(found, stretched, atol=0.1)
try:
    pybvh.read_bvh_file("stretched.bvh")
except ValueError as error:
    assert "position channels" in str(error)
else:
    raise AssertionError("not refused")
PYTHON
