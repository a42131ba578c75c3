#!/usr/bin/env bash
# Two episodes of an arm, a LeRobot dataset of version 2.1, are sampled for reinforcement learning with robotdataset, as a replay buffer of TorchRL. State and
# action of step i are i, and 100 + i in the second episode. Guess: "next" holds the state of step i + 1, as in any replay buffer, and an action at 0, 50 and
# 100 ms that reaches past the end is marked. Seen with robotdataset 0.2.4, torchrl 0.14.1 on 2026-11-30, without a word:
# - by default, `next/observation/state` is `observation/state`, the same step. What is stored, `dataset[:]`, has the next one: `sample()` puts the mirror image
#   of the offsets in its place, and that of 0 is 0
# - with `delta_timestamps={"action": [0.0, 0.05, 0.1]}`, `next/action` are the two actions BEFORE that step, and itself
# - at the last step, the last action thrice, and no mask
# - a column of seconds since 1970 is float32: steps of 128 s
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check robotdataset==0.2.4 torch==2.13.0 torchrl==0.14.1 tensordict==0.14.3 pandas==3.1.1 pyarrow==26.0.1 numpy==2.4.6 2>/dev/null
cd "$folder"
cat > sample.py <<'PYTHON'
import json
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from robotdataset.lerobot_video_dataset import LeRobotVideoDataset

RATE, LENGTHS, BEGIN_S = 20, (50, 60), 1_700_000_000.0
for part in ("meta", "data/chunk-000"):
    Path("arm", part).mkdir(parents=True)
episodes = []
for number, length in enumerate(LENGTHS):
    at = sum(LENGTHS[:number])
    rows = [
        {"action": [100.0 * number + step], "observation.state": [100.0 * number + step], "observation.stamp": BEGIN_S + step / RATE}
        | {"timestamp": np.float32(step / RATE), "frame_index": step, "episode_index": number, "index": at + step, "task_index": 0}
        for step in range(length)
    ]
    pd.DataFrame(rows).to_parquet(f"arm/data/chunk-000/episode_{number:06d}.parquet")
    episodes.append(json.dumps({"episode_index": number, "tasks": ["pick"], "length": length}))
Path("arm/meta/episodes.jsonl").write_text("\n".join(episodes))
Path("arm/meta/tasks.jsonl").write_text(json.dumps({"task_index": 0, "task": "pick"}))
paths = {"data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet", "video_path": ""}
info = {"codebase_version": "v2.1", "fps": RATE, "chunks_size": 1000, "total_episodes": len(LENGTHS), "features": {}, **paths}
Path("arm/meta/info.json").write_text(json.dumps(info))

torch.manual_seed(0)
dataset = LeRobotVideoDataset(local_path="arm", root="cache", batch_size=2000)
stored, batch = dataset[:], dataset.sample()
assert torch.equal(stored["next", "observation", "state"][:49, 0], torch.arange(1.0, 50))
state, following = batch["observation/state"].flatten(), batch["next/observation/state"].flatten()
print("state", state[:4].tolist(), "next", following[:4].tolist())
assert torch.equal(state, following)
stamps = sorted(set(batch["observation/stamp"].flatten().tolist()))
print(f"{len(LENGTHS)} episodes of {LENGTHS} steps have {len(stamps)} stamps: {stamps}")
assert len(stamps) == 1 and stamps[0] % 128 == 0

dataset = LeRobotVideoDataset(local_path="arm", root="cache", batch_size=2000, delta_timestamps={"action": [0.0, 0.05, 0.1]})
batch = dataset.sample()
state = batch["observation/state"].flatten()
for step in (20, 49):
    place = int((state == step).nonzero()[0])
    print(f"step {step}: action {batch['action'][place].flatten().tolist()}, next/action {batch['next/action'][place].flatten().tolist()}")
    assert batch["action"][place].flatten().tolist() == [step, min(step + 1, 49), min(step + 2, 49)]
    assert batch["next/action"][place].flatten().tolist() == [step - 2, step - 1, step]
assert not [key for key in batch.keys() if "pad" in key or "mask" in key]
PYTHON
venv/bin/python -W ignore sample.py 2>/dev/null
