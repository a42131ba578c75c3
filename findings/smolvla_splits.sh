#!/usr/bin/env bash
# Two arms' datasets of ten episodes each become the training, validation and test parts of SmolVLADataset, "with deterministic train/val/test splits", 80:10:10, and their
# statistics. Guess: each episode is in one part; a mean and a deviation for each joint.
# Seen with smolvladataset 0.1.1 on 2026-11-30, without a word:
# - single FRAMES are dealt, so that all episodes are in all parts, and each frame of the test part has a neighbour a thirtieth of a second away in training
# - of six joints there is one mean and one deviation, of all angles together, and of a dataset's first 2000 frames: later ones do not count
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export HOME=$folder XDG_CACHE_HOME=$folder/cache
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pandas==2.3.3 pyarrow==26.0.1 numpy==2.4.6 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps smolvladataset==0.1.1 2>/dev/null
venv/bin/python - <<'PYTHON'
import sys
from pathlib import Path
from unittest.mock import MagicMock

for name in ("lerobot", "lerobot.datasets", "datasets", "huggingface_hub"):  # what reads from a hub; the files lie here
    sys.modules[name] = MagicMock()
sys.modules["lerobot.datasets.lerobot_dataset"] = MagicMock(LeRobotDataset=object)
import numpy as np
import pandas as pd
from smolvladataset import SmolVLADataset
from smolvladataset.cache import cache_paths_for_list

EPISODES, LENGTH = 10, 300
Path("arms.csv").write_text("dataset_repo_id\nlab/so100\nlab/so101\n")
cache = cache_paths_for_list(Path("arms.csv"))[0] / "per_dataset"
cache.mkdir(parents=True)
rows = [
    {"episode_index": episode, "frame_index": frame, "action": [0.0, 10.0, 20.0, 30.0, 40.0, 50.0 if episode < 6 else 500.0]}
    for episode in range(EPISODES)
    for frame in range(LENGTH)
]
for arm in ("so100", "so101"):
    pd.DataFrame(rows).to_parquet(cache / f"lab_{arm}.parquet")  # as if downloaded before
parts = dict(zip(("train", "val", "test"), SmolVLADataset(csv_list="arms.csv")))
frames = {name: [(row["dataset"], row["episode_index"], row["frame_index"]) for row in part] for name, part in parts.items()}
episodes = {name: len({frame[:2] for frame in part}) for name, part in frames.items()}
trained = set(frames["train"])
near = np.mean([bool({(arm, episode, frame - 1), (arm, episode, frame + 1)} & trained) for arm, episode, frame in frames["test"]])
print(f"frames {[len(part) for part in frames.values()]}; episodes in each part, of {2 * EPISODES}: {episodes}; test frames with a neighbour in training: {near:.0%}")
assert set(episodes.values()) == {2 * EPISODES} and near > 0.9

stats = parts["train"].stats.iloc[0]
actions = np.array([row["action"] for row in rows])
print({name: round(float(stats[name]), 1) for name in stats.index if name.startswith("action")}, "where means by joint are", actions.mean(axis=0).tolist())
assert {name for name in stats.index if name.startswith("action")} == {"action_mean", "action_std"}
assert np.isclose(stats["action_mean"], actions[:2000].mean()) and not np.isclose(stats["action_mean"], actions.mean())
PYTHON
