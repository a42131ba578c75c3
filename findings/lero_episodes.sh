#!/usr/bin/env bash
# A LeRobot dataset of version 2.1 with four episodes is edited with LERO: the second is deleted, as the operator's hand was in the picture, then the last is
# copied with a new instruction, and the dataset is merged with another one, of another task. Guess: tables, lists and statistics say the same afterwards.
# Seen with lero-core 0.3.0 on 2026-11-30, after "Successfully ..." each time:
# - deleted: files and `episodes.jsonl` are numbered anew, but the rows in them are of the old `episode_index` and `index`, which is by what their pictures and
#   neighbours are looked up. `episodes_stats.jsonl` keeps the deleted one's statistics, and so each later episode has its neighbour's
# - copied: `episodes.jsonl` has the new instruction, and no row: `task_index` is the old one, so the policy is trained on the old words
# - merged: rows of the second dataset have its own numbers of tasks, which are the first's tasks, so a door is opened to the words "pick up the cup". Of two
#   datasets of 15 steps a second, `fps` is 30
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps lero-core==0.3.0 pandas==3.1.1 pyarrow==26.0.1 numpy==2.4.6 python-dateutil==2.9.0.post0 six==1.17.0 2>/dev/null
cd "$folder"
cat > edit.py <<'PYTHON'
import json
import sys
from pathlib import Path
from unittest.mock import MagicMock

for window in ("tkinter", "tkinter.ttk", "tkinter.messagebox", "tkinter.filedialog", "cv2", "PIL", "PIL.Image", "PIL.ImageTk", "matplotlib", "matplotlib.pyplot"):
    sys.modules.setdefault(window, MagicMock())
import pandas as pd
from lero.dataset_editor.operations import DatasetOperations

LENGTH = 10
DATA = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"


def save_lines(path, rows):
    Path(path).write_text("".join(json.dumps(row) + "\n" for row in rows))


def lines(path):
    return [json.loads(line) for line in Path(path).read_text().splitlines()]


def dataset(root, task, episodes, rate):
    """Write a dataset of one task; `state` says which dataset and episode a row is of."""
    for part in ("meta", "data/chunk-000", "videos/chunk-000"):
        Path(root, part).mkdir(parents=True)
    for number in range(episodes):
        rows = [
            {"observation.state": [float(number)], "timestamp": step / rate, "frame_index": step, "episode_index": number, "index": number * LENGTH + step, "task_index": 0}
            for step in range(LENGTH)
        ]
        pd.DataFrame(rows).to_parquet(f"{root}/data/chunk-000/episode_{number:06d}.parquet", index=False)
    save_lines(f"{root}/meta/episodes.jsonl", [{"episode_index": number, "tasks": [task], "length": LENGTH} for number in range(episodes)])
    stats = [{"episode_index": number, "stats": {"observation.state": {"mean": [float(number)], "count": [LENGTH]}}} for number in range(episodes)]
    save_lines(f"{root}/meta/episodes_stats.jsonl", stats)
    save_lines(f"{root}/meta/tasks.jsonl", [{"task_index": 0, "task": task}])
    info = {"codebase_version": "v2.1", "fps": rate, "total_episodes": episodes, "total_frames": episodes * LENGTH, "total_tasks": 1, "chunks_size": 1000}
    info |= {"data_path": DATA, "features": {"observation.state": {"dtype": "float32", "shape": [1], "names": ["episode"]}}}
    Path(root, "meta/info.json").write_text(json.dumps(info))


def rows_of(root, number):
    """Return of an episode's file: the episode that its state says, and the numbers of episode, first row and task in it."""
    table = pd.read_parquet(f"{root}/data/chunk-000/episode_{number:06d}.parquet")
    return [int(table[name].iloc[0][0] if name == "observation.state" else table[name].iloc[0]) for name in ("observation.state", "episode_index", "index", "task_index")]


dataset("cups", "pick up the cup", 4, 30)
dataset("doors", "open the door", 2, 15)
assert DatasetOperations(Path("cups")).delete_episode(1)
print("deleted: file, then state, episode_index, index, task_index")
for number in range(3):
    print(f"  {number}: {rows_of('cups', number)}")
assert [rows_of("cups", number) for number in range(3)] == [[0, 0, 0, 0], [2, 2, 20, 0], [3, 3, 30, 0]]
listed = [episode["episode_index"] for episode in lines("cups/meta/episodes.jsonl")]
stats = {entry["episode_index"]: entry["stats"]["observation.state"]["mean"] for entry in lines("cups/meta/episodes_stats.jsonl")}
print("listed", listed, "means", stats)
assert listed == [0, 1, 2] and stats == {0: [0.0], 1: [1.0], 2: [2.0], 3: [3.0]}

assert DatasetOperations(Path("cups")).copy_episode_with_new_instruction(2, "lift the red cup")
tasks = {task["task_index"]: task["task"] for task in lines("cups/meta/tasks.jsonl")}
copy = lines("cups/meta/episodes.jsonl")[-1]
print(f"copied: {tasks}, listed as {copy.get('task', copy.get('tasks'))!r}, its rows: {tasks[rows_of('cups', 3)[3]]!r}")
assert copy["task_index"] == 1 and tasks == {0: "pick up the cup", 1: "lift the red cup"} and rows_of("cups", 3)[3] == 0

assert DatasetOperations(Path("cups")).merge_datasets([Path("cups"), Path("doors")], Path("both"))
tasks = {task["task_index"]: task["task"] for task in lines("both/meta/tasks.jsonl")}
door = rows_of("both", 4)
print(f"merged: tasks {tasks}; an episode of the door is numbered {door[1]}, and says {tasks[door[3]]!r}")
assert door[1] == 4 and tasks[door[3]] == "pick up the cup"
assert lines("both/meta/episodes.jsonl")[4]["episode_index"] == 4
dataset("drawers", "open the drawer", 2, 15)
assert DatasetOperations(Path("doors")).merge_datasets([Path("doors"), Path("drawers")], Path("slow"))
rates = [json.loads(Path(root, "meta/info.json").read_text())["fps"] for root in ("doors", "drawers", "slow")]
print("rates of two datasets, and merged:", rates)
assert rates == [15, 15, 30]
PYTHON
venv/bin/python edit.py > edit.txt 2>&1 || { cat edit.txt; exit 1; }
grep -v '^Deleted:\|^Copied\|^Processing' edit.txt
