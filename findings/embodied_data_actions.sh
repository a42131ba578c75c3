#!/usr/bin/env bash
# An episode of AgiBot World Beta (proprio_stats.h5: what the joints of two arms were commanded, and what they did a tenth of a second later) becomes a LeRobot dataset with
# embodied-data; and a LeRobot dataset of a teleoperated robot becomes one of AgiBot. Guess: `action` is what was commanded, as in either format, and what was measured is
# `state`. Seen with embodied-data 0.3.1 on 2026-11-30:
# - to LeRobot, after "done: 90 frames (20-dim state + first-diff action)": commands are not read. `action` is the way from this reading to the next, in radians per frame,
#   the last one twice, under the names of the joints. That a gripper was told to close (0.8, where the object stops it at 0.3) is nowhere; `validate` finds nothing amiss
# - to AgiBot, after "done: 90 frames": `action` is the READINGS of the same frame, so that a policy learns to stay where it is
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.12 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check embodied-data==0.3.1 h5py==3.16.0 av==19.0.2 pyarrow==26.0.1 numpy==2.5.5 2>/dev/null
cat > write.py <<'PYTHON'
import json
from pathlib import Path

import av
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

FRAMES, LAG = 90, 3
told = np.linspace(0, 1, FRAMES + LAG)[:, None] * np.ones((1, 14))
episode = Path("beta/327/648642")
episode.mkdir(parents=True)
with h5py.File(episode / "proprio_stats.h5", "w") as file:
    file["timestamp"] = (np.arange(FRAMES) * 1e9 / 30).astype(np.int64)
    file["state/joint/position"], file["action/joint/position"] = told[:FRAMES], told[LAG:]
    file["state/effector/position"] = np.minimum(np.linspace(0, 0.8, FRAMES), 0.3)[:, None] * np.ones((1, 2))
    file["action/effector/position"] = np.linspace(0, 0.8, FRAMES)[:, None] * np.ones((1, 2))
Path("beta/task_info_327.json").write_text(json.dumps([{"episode_id": 648642, "task_name": "pick up the cup"}]))

video = Path("arm/videos/observation.images.top_head/chunk-000/file-000.mp4")
for folder in (video.parent, Path("arm/data/chunk-000"), Path("arm/meta")):
    folder.mkdir(parents=True)
with av.open(str(video), "w") as container:
    stream = container.add_stream("libx264", 30)
    stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
    for _ in range(FRAMES):
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8))))
    container.mux(stream.encode())
joints = told @ np.ones((14, 22)) / 14
table = {"observation.state": joints[:FRAMES].astype(np.float32).tolist(), "action": joints[LAG:].astype(np.float32).tolist()}
pq.write_table(pa.table(table), "arm/data/chunk-000/file-000.parquet")
pq.write_table(pa.table({"task_index": [0], "task": ["pick up the cup"]}), "arm/meta/tasks.parquet")
Path("arm/meta/info.json").write_text(json.dumps({"codebase_version": "v3.0", "fps": 30, "total_episodes": 1, "total_frames": FRAMES}))
PYTHON
venv/bin/python write.py
venv/bin/embodied-data convert beta/327/648642 from_beta --from agibot --to lerobot-v3 > said.txt 2>&1 || { cat said.txt; exit 1; }
venv/bin/embodied-data convert arm from_lerobot --from lerobot-v3 --to agibot >> said.txt 2>&1 || { cat said.txt; exit 1; }
venv/bin/embodied-data validate from_beta >> said.txt 2>&1 || { cat said.txt; exit 1; }
cat said.txt
venv/bin/python - <<'PYTHON'
from pathlib import Path

import h5py
import numpy as np
import pyarrow.parquet as pq

table = pq.read_table(next(Path("from_beta/data").rglob("*.parquet")))
state, action = (np.array(table[name].to_pylist()) for name in ("observation.state", "action"))
with h5py.File("beta/327/648642/proprio_stats.h5") as file:
    told, closed = file["action/joint/position"][:], file["action/effector/position"][:]
print(f"to LeRobot: first joint in frame 60 at {state[60, 0]:.3f}, action {action[60, 0]:.4f}, told {told[60, 0]:.3f} rad")
print(f"  gripper in the last frame at {state[-1, 14]:.2f}, action {action[-1, 14]:.2f}, told {closed[-1, 0]:.2f}")
assert state[-1, 14] < 0.31 and action[-1, 14] == 0 and closed[-1, 0] == 0.8
assert np.allclose(action[:-1], np.diff(state, axis=0), atol=1e-6) and np.array_equal(action[-1], action[-2])
with h5py.File(next(Path("from_lerobot").rglob("*.h5"))) as file:
    state, action = file["state/joint/position"][:], file["action/joint/position"][:]
given = pq.read_table("arm/data/chunk-000/file-000.parquet")["action"][60].as_py()[0]
print(f"to AgiBot: frame 60 at {state[60, 2]:.3f}, action {action[60, 2]:.3f}, told {given:.3f}")
assert np.array_equal(state, action) and given > action[60].max() + 0.03
PYTHON
if grep -i 'warn' said.txt; then exit 1; fi
