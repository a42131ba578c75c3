#!/usr/bin/env bash
# "We retrained and it got worse: what changed in the data?" is what robot-data-diff answers for two revisions of a LeRobot dataset (v3.0). From one to the next, the states of all
# four episodes went from degrees to radians, and the actions of episode 2 came five frames later than before, a whole round of a motion in both.
# Guess: four episodes have changed, since their data and the statistics in the metadata have. Seen with robot-data-diff 0.1.0 on 2026-12-01, without a word:
# "~0 changed, =4 unchanged". An episode is its length, its tasks, the least, greatest and mean action, and how many frames are idle or jump: states are read and compared nowhere,
# and the order of actions does not count.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check robot-data-diff==0.1.0 numpy==2.4.6 pandas==3.1.1 pyarrow==24.0.0 2>/dev/null
cd "$folder"
cat > diff.py <<'PYTHON'
import json
import subprocess
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

FPS, EPISODES, LENGTH = 10, 4, 50


def statistics(values):
    return {name: getattr(np, name)(values, axis=0).tolist() for name in ("min", "max", "mean", "std")}


def write(root, states, actions):
    for part in ("meta/episodes/chunk-000", "data/chunk-000"):
        (root / part).mkdir(parents=True)
    frames = {
        "observation.state": [row.tolist() for row in np.concatenate(states)],
        "action": [row.tolist() for row in np.concatenate(actions)],
        "timestamp": (np.tile(np.arange(LENGTH), EPISODES) / FPS).astype(np.float32),
        "frame_index": np.tile(np.arange(LENGTH), EPISODES),
        "episode_index": np.repeat(np.arange(EPISODES), LENGTH),
        "index": np.arange(EPISODES * LENGTH),
        "task_index": np.zeros(EPISODES * LENGTH, np.int64),
    }
    pq.write_table(pa.table(frames), root / "data/chunk-000/file-000.parquet")
    rows = []
    for number, (state, action) in enumerate(zip(states, actions)):
        row = {"episode_index": number, "tasks": ["put the red cube into the box"], "length": LENGTH}
        row |= {f"stats/observation.state/{key}": value for key, value in statistics(state).items()}
        rows.append(row | {f"stats/action/{key}": value for key, value in statistics(action).items()})
    pq.write_table(pa.Table.from_pylist(rows), root / "meta/episodes/chunk-000/file-000.parquet")
    features = {name: {"dtype": "float32", "shape": [2], "names": ["shoulder", "elbow"]} for name in ("observation.state", "action")}
    (root / "meta/info.json").write_text(json.dumps({"codebase_version": "v3.0", "fps": FPS, "features": features}))


def diff(first, second):
    ran = subprocess.run(["venv/bin/robot-data-diff", "diff", first, second], capture_output=True, text=True, check=True)
    line = next(line for line in ran.stdout.splitlines() if line.startswith("Episodes:"))
    print(f"{first}, {second}: {line}")
    return line


phase = 2 * np.pi * np.arange(LENGTH) / LENGTH
states_deg = [np.stack([40 * np.sin(phase) + 5 * number, 30 * np.cos(phase)], axis=1).astype(np.float32) for number in range(EPISODES)]
actions = [np.roll(state, -1, axis=0) for state in states_deg]
write(Path("last"), states_deg, actions)
shifted = [np.roll(action, 5, axis=0) if number == 2 else action for number, action in enumerate(actions)]
write(Path("now"), [np.radians(state) for state in states_deg], shifted)
assert "~0 changed, =4 unchanged" in diff("last", "now")
PYTHON
venv/bin/python diff.py
