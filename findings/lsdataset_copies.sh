#!/usr/bin/env bash
# A LeRobot-style dataset of lsdataset has four episodes of 25 steps at 25 Hz. The first is deleted, as the operator's hand was in the picture; then the next is copied to another dataset, which has two of its
# own; and a longer episode is labelled: "reach" up to the time of a step in it, "grasp" from there on, at steps 15, 29 and 57 (0.6, 1.16 and 2.28 s). Guess: rows are numbered as files and lists are, and
# labels change at these steps.
# Seen with lsdataset 0.3.4 on 2026-11-30, without a word:
# - deleted: `episode_index` is numbered anew, and `index`, the row's number in the dataset, is not: it begins with 25 and ends with 99, of 75 rows
# - copied: the file is that of episode 2, its rows are of episode 0 and begin with 25, as in the dataset that it is from; so two episodes of the new one are 0, which is by what episodes are told apart
# - labelled at steps 15, 28 and 56: 1.16 * 25 is 28.999..., and is rounded down
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check lsdataset==0.3.4 2>/dev/null
cat > edit.py <<'PYTHON'
from pathlib import Path

import numpy as np
import pandas as pd
from lsdataset.core.dataset import LsRobotDataset

RATE_HZ = 25
FEATURES = {"state": {"dtype": "float32", "shape": (2,), "names": ["episode", "step"]}}


def dataset(name, episodes, length):
    """Write a dataset whose state says which episode a row is of."""
    made = LsRobotDataset.create(name, fps=RATE_HZ, features=FEATURES, root="data")
    for number in range(episodes):
        for step in range(length):
            made.add_frame({"state": np.array([number, step], np.float32)}, task="pick", timestamp=step / RATE_HZ)
        made.save_episode()
    return made


def rows(of, number):
    """Return of an episode's file: the episode that its state says, its number, and the numbers of its first and last row."""
    (path,) = Path(of.root).glob(f"**/episode_{number:06d}.parquet")
    table = pd.read_parquet(path)
    return int(table["state"].iloc[0][0]), int(table["episode_index"].iloc[0]), int(table["index"].iloc[0]), int(table["index"].iloc[-1])


cups, doors = dataset("cups", 4, 25), dataset("doors", 2, 25)
cups.delete_episodes([0])
deleted = [rows(cups, number) for number in range(3)]
print(f"deleted: of {cups.total_frames} rows: state, episode_index, first and last index: {deleted}")
assert cups.total_frames == 75 and deleted == [(1, 0, 25, 49), (2, 1, 50, 74), (3, 2, 75, 99)]
cups.copy_episodes_to_dataset([0], "doors", "data")
doors = LsRobotDataset("doors", root="data")
copied = [rows(doors, number) for number in range(3)]
print(f"copied: {copied}, listed {[episode['episode_index'] for episode in doors.episodes]}")
assert copied == [(0, 0, 0, 24), (1, 1, 25, 49), (1, 0, 25, 49)] and [episode["episode_index"] for episode in doors.episodes] == [0, 1, 2]
long = dataset("long", 1, 60)
(path,) = Path(long.root).glob("**/episode_000000.parquet")
changes = {}
for step in (15, 29, 57):
    long.annotate_episode(0, [step / RATE_HZ], ["reach", "grasp"])
    labels = pd.read_parquet(path)["task_index"].to_numpy()
    changes[step] = int(np.argmax(labels != labels[0]))
print("labelled at a step, and the label changes at:", changes)
assert changes == {15: 15, 29: 28, 57: 56}
PYTHON
venv/bin/python edit.py > said.txt 2>&1 || { tail -8 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
grep '^deleted:\|^copied:\|^labelled' said.txt
