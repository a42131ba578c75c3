#!/usr/bin/env bash
# Of 100 episodes, half are for training and 20 % for validation, the rest is left for later: {"train": 0.5, "val": 0.2}.
# What does lerobot's `split_dataset` make of it, whose shares "must sum to <= 1.0"? Guess: 50 and 20 episodes.
# Seen with lerobot 0.4.4 on 2026-11-28 (0.6.1 reads the same in its source): 50 and 50; the last split takes all that is left, whatever
# its share, without a word. And shares are cut off after a product of floats: 0.29 of 100 episodes are 28. A list of numbers in place of
# a share is taken as it is.
set -euo pipefail
lock=$(cd "$(dirname "$0")/.." && pwd)/requirements-lerobot.lock
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check torch==2.13.0
grep -v '^torch==' "$lock" >"$folder/others.txt"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps -r "$folder/others.txt"
cd "$folder"
HF_HUB_OFFLINE=1 HF_HOME="$folder/home" venv/bin/python -W ignore - 2>errors.txt <<'PYTHON' || { tail -5 errors.txt; exit 1; }
import logging

import numpy as np
import torch

if torch.version.cuda is None:  # torchvision's wheel lacks an operator then, which lerobot's datasets do not use
    operators = torch.library.Library("torchvision", "DEF")
    operators.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
from lerobot.datasets.dataset_tools import split_dataset
from lerobot.datasets.lerobot_dataset import LeRobotDataset

logging.disable(logging.WARNING)
features = {"action": {"dtype": "float32", "shape": (2,), "names": ["a", "b"]}}
written = LeRobotDataset.create("me/x", fps=10, root="data", features=features, use_videos=False)
for episode in range(100):
    for _ in range(2):
        written.add_frame({"action": np.float32([episode, 0]), "task": "go"})
    written.save_episode()
written.finalize()
dataset = LeRobotDataset("me/x", root="data")


def sizes(name, **splits):
    parts = split_dataset(dataset, splits, output_dir=name)
    return {split: part.num_episodes for split, part in parts.items()}


shares, product = sizes("shares", train=0.5, val=0.2), sizes("product", train=0.29, val=0.71)
print("0.5 and 0.2:", shares, " 0.29 and 0.71:", product)
assert shares == {"train": 50, "val": 50}
assert product == {"train": 28, "val": 72}
assert sizes("named", val=[0, 1], train=[2, 3, 4]) == {"val": 2, "train": 3}
PYTHON
