#!/usr/bin/env bash
# A LeRobot dataset of version 3.0 has so many episodes that its tables fill two files, as they do from 100 MB on. A policy is trained on it with traceplane,
# which reads it itself: `LeRobotReader` and `WindowedDataset`, for actions of 16 steps. Guess: all four episodes; a short one is padded to 16, as its code has.
# Seen with traceplane 0.5.11 on 2026-11-30, without a word:
# - episodes of the second file have no step at all: rows are looked up at `dataset_from_index`, which counts through all files, in the file that the episode is
#   in. They are as long as ever in `metadata`, and no window is of them. Where a file has more rows than that number, they are other episodes' rows
# - `traceplane check` opens each of the four, and says PASS, without an error
# - an episode of 12 steps in the first file has no window, since none is whole; the last 15 steps of each begin none
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check traceplane==0.5.11 pandas==3.1.1 pyarrow==26.0.1 numpy==2.4.6 2>/dev/null
cd "$folder"
cat > episodes.py <<'PYTHON'
import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
from traceplane.lerobot_reader import LeRobotReader
from traceplane.windowing import WindowedDataset

RATE, HORIZON = 20, 16


def dataset(root, lengths_of_files):
    """Write a dataset whose episodes have the given lengths, file by file; its actions are (episode, step)."""
    root = Path(root)
    for part in ("meta/episodes/chunk-000", "data/chunk-000"):
        (root / part).mkdir(parents=True)
    episodes, row = [], 0
    for file, lengths in enumerate(lengths_of_files):
        rows = []
        for length in lengths:
            number = len(episodes)
            episodes.append({"episode_index": number, "tasks": ["pick"], "length": length, "data/chunk_index": 0, "data/file_index": file})
            episodes[-1] |= {"dataset_from_index": row, "dataset_to_index": row + length}
            for step in range(length):
                values = {"action": [float(number), float(step)], "observation.state": [float(number), float(step)]}
                rows.append({**values, "timestamp": np.float32(step / RATE), "frame_index": step, "episode_index": number, "index": row + step, "task_index": 0})
            row += length
        pd.DataFrame(rows).to_parquet(root / f"data/chunk-000/file-{file:03d}.parquet")
    pd.DataFrame(episodes).to_parquet(root / "meta/episodes/chunk-000/file-000.parquet")
    pd.DataFrame({"task_index": [0]}, index=["pick"]).to_parquet(root / "meta/tasks.parquet")
    features = {name: {"dtype": "float32", "shape": [2], "names": ["episode", "step"]} for name in ("action", "observation.state")}
    info = {"codebase_version": "v3.0", "fps": RATE, "total_episodes": len(episodes), "total_frames": row, "robot_type": "arm", "features": features}
    (root / "meta/info.json").write_text(json.dumps(info))
    stats = {name: {"min": [0, 0], "max": [9, 99], "mean": [1, 1], "std": [1, 1], "count": [row]} for name in features}
    (root / "meta/stats.json").write_text(json.dumps(stats))
    return LeRobotReader(root)


def has(episode):
    """Return how many steps an episode has, and the numbers of the episodes that they are of."""
    return len(episode.actions), sorted({int(action[0]) for action in episode.actions})


two = dataset("two", [[50, 60, 12], [40, 30]])
windows = WindowedDataset(two, obs_horizon=2, action_horizon=HORIZON)
found = [windows[place] for place in range(len(windows))]
for number in range(len(two)):
    steps, _ = has(two[number])
    begun = [window.timestep for window in found if window.episode_id == two[number].episode_id]
    print(f"episode {number}: {two[number].metadata['length']} steps, read {steps}, windows {len(begun)}, the last begins at {max(begun, default=None)}")
    assert max(begun, default=None) == {0: 34, 1: 44}.get(number)
assert [has(two[number]) for number in range(5)] == [(50, [0]), (60, [1]), (12, [2]), (0, []), (0, [])]
assert [two[number].metadata["length"] for number in range(5)] == [50, 60, 12, 40, 30]

longer = dataset("longer", [[20], [30, 40]])
print("where the second file is longer:", [has(longer[number]) for number in range(3)])
assert [has(longer[number]) for number in range(3)] == [(20, [0]), (30, [1, 2]), (20, [2])]
PYTHON
venv/bin/python episodes.py > episodes.txt 2> said.txt
cat episodes.txt
if [ -s said.txt ]; then exit 1; fi
venv/bin/traceplane check two > check.txt
grep -E 'Episodes|Result|Errors|Warnings' check.txt
grep -q 'Result: *PASS' check.txt
grep -q '5 declared, 5 checked' check.txt
grep -q 'Errors: *0' check.txt
