#!/usr/bin/env bash
# A gripper is followed by motion capture at 120 Hz while an action camera of 60 Hz films it; the gripper moves at 1 m/s and turns. The video begins at timecode 10:00:00:45 (SMPTE: frame 45 of that second, 0.75 s),
# by a clock that is also the motion capture's. Orientations have w >= 0, as what it records. robot-utils gives each picture its pose: `interpolate_mocap_poses`.
# Guess: the pose at 10:00:00.75 for the first picture; quaternions of length 1.
# Seen with robot-utils 0.1.4 on 2026-11-30, without a word:
# - the pose at 10:00:00.000045, 0.75 m behind: the frames of the timecode are taken for microseconds. The difference of clocks, which it measures with another video, has the same error by that video's
#   frames, so that takes of a day are off by up to a second, each by another amount
# - quaternions are interpolated number by number (cubic): between two whose sign differs, which is one orientation, the picture has one of length 0.01. A turn
#   of more than half a revolution has such a place, since what it records has w >= 0
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-deps robot-utils==0.1.4 av==18.1.0 click==8.4.2 scipy==1.17.1 numpy==2.4.6 2>/dev/null
cat > follow.py <<'PYTHON'
import importlib.util
import pickle
import sysconfig
from datetime import datetime
from pathlib import Path

import av
import numpy as np
from click.testing import CliRunner

RATE_HZ, FRAME = 60, 45
DAY = datetime(2026, 11, 30)

with av.open("GX010001.mp4", "w") as container:
    stream = container.add_stream("mpeg4", rate=RATE_HZ)
    stream.width, stream.height = 64, 48
    stream.metadata["timecode"] = container.metadata["timecode"] = f"10:00:00:{FRAME}"
    container.metadata["creation_time"] = "2026-11-30T10:00:00.000000Z"
    for _ in range(2 * RATE_HZ):
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="rgb24")))
    container.mux(stream.encode())
with av.open("GX010001.mp4") as container:
    print("video:", container.streams.video[0].metadata)

start_s = DAY.replace(hour=10).timestamp()  # of the same day in the same zone as the package takes
times_s = start_s - 1 + (np.arange(5 * 120) + 0.5) / 120
half = np.radians(90) * (times_s - start_s) / 2 + np.radians(60)
signs = np.where(np.cos(half) < 0, -1, 1)
zero = np.zeros_like(times_s)
poses = np.stack([times_s - start_s, zero, zero, signs * np.cos(half), zero, zero, signs * np.sin(half)], axis=1)
with open("gripper.pkl", "wb") as file:
    pickle.dump({"gripper": list(zip(poses, times_s))}, file)

package = Path(sysconfig.get_paths()["purelib"], "robot_utils/teleop_utils/mocap/scripts/interpolate_mocap_poses.py")
spec = importlib.util.spec_from_file_location("interpolate_mocap_poses", package)
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
result = CliRunner().invoke(module.main, ["gripper.pkl", "GX010001.mp4", "0.0"])
assert result.exit_code == 0, result.output
with open("gripper_GX010001.pkl", "rb") as file:
    followed = np.array([pose for pose, _ in pickle.load(file)["gripper"]])
length = np.linalg.norm(followed[:, 3:], axis=1)
print(f"first picture: {followed[0, 0]:.6f} m, and {FRAME / RATE_HZ} is right; quaternions {length.min():.2f} to {length.max():.2f} long")
assert np.isclose(followed[0, 0], FRAME * 1e-6, atol=1e-6) and len(followed) == 2 * RATE_HZ
assert length.min() < 0.05
PYTHON
venv/bin/python -W error follow.py
