#!/usr/bin/env bash
# Two LeRobot datasets of version 2.1, each episode of which first picks up a cup (60 frames) and then puts it on a shelf (40), as `task_index` has it frame by
# frame, are put together for training with any4robot; then the frames of picking alone are taken out of them. Guess: each frame keeps its task, and
# `stats.json` is of all frames. Seen with any4robot 0.1.8 on 2026-11-30, without a word:
# - merged: each frame of an episode has the task of its FIRST one, so the cup is put on the shelf to the words "pick up the cup". `tasks` of the episode has both
# - of two datasets at 30 and 15 frames a second, `fps` is 30: the second's timestamps lie 0.067 s apart
# - statistics: of a joint at 0 rad in the one dataset and 1 rad in the other, each with a standard deviation of 0.1, the merged one is 0.1, and not 0.5
# - `extract_lerobot_tasks_subset` for picking: 200 frames of 200, the 80 of the shelf among them, all as picking. Its `stats.json` has no statistics
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check any4robot==0.1.8 pandas==3.1.1 pyarrow==26.0.1 numpy==2.4.6 2>/dev/null
cd "$folder"
cat > merge.py <<'PYTHON'
import json
from pathlib import Path

import numpy as np
import pandas as pd
from any4robot.combine import extract_lerobot_tasks_subset, merge_lerobot_datasets

TASKS, STEPS = ("pick up the cup", "put it on the shelf"), (60, 40)
rng = np.random.default_rng(0)


def lines(path, rows):
    """Write one JSON object a line."""
    Path(path).write_text("".join(json.dumps(row) + "\n" for row in rows))


def write(name, fps, position):
    """Write a dataset of one episode, in which a joint is about that position in rad; return its positions."""
    for part in ("meta", "data/chunk-000"):
        Path(name, part).mkdir(parents=True)
    count = sum(STEPS)
    positions = (position + 0.1 * rng.standard_normal(count)).astype(np.float32)
    rows = {"observation.state": [[value] for value in positions], "timestamp": (np.arange(count) / fps).astype(np.float32)}
    rows |= {"frame_index": range(count), "episode_index": 0, "index": range(count), "task_index": np.repeat((0, 1), STEPS)}
    pd.DataFrame(rows).to_parquet(f"{name}/data/chunk-000/episode_000000.parquet")
    of_state = {"min": [float(positions.min())], "max": [float(positions.max())], "mean": [float(positions.mean())], "std": [float(positions.std())], "count": [count]}
    info = {"codebase_version": "v2.1", "fps": fps, "chunks_size": 1000, "total_episodes": 1, "total_frames": count, "total_videos": 0}
    info |= {"features": {"observation.state": {"dtype": "float32", "shape": [1]}}, "video_path": "", "data_path": ""}
    Path(name, "meta/info.json").write_text(json.dumps(info))
    Path(name, "meta/stats.json").write_text(json.dumps({"observation.state": of_state}))
    lines(f"{name}/meta/episodes.jsonl", [{"episode_index": 0, "tasks": list(TASKS), "length": count}])
    lines(f"{name}/meta/episodes_stats.jsonl", [{"episode_index": 0, "stats": {"observation.state": of_state}}])
    lines(f"{name}/meta/tasks.jsonl", [{"task_index": number, "task": task} for number, task in enumerate(TASKS)])
    return positions


def seen(name):
    """Return the rows of all episodes of a dataset, with the words of their tasks."""
    tasks = {row["task_index"]: row["task"] for row in map(json.loads, Path(name, "meta/tasks.jsonl").read_text().splitlines())}
    rows = pd.concat(map(pd.read_parquet, sorted(Path(name, "data").rglob("*.parquet"))))
    return rows.assign(task=rows["task_index"].map(tasks))


both = np.concatenate((write("all/one", 30, 0.0), write("all/two", 15, 1.0)))
assert merge_lerobot_datasets(["all/one", "all/two"], "merged")
rows, info = seen("merged"), json.loads(Path("merged/meta/info.json").read_text())
episode = json.loads(Path("merged/meta/episodes.jsonl").read_text().splitlines()[0])
print("merged:", rows["task"].value_counts().to_dict(), "tasks of an episode:", episode["tasks"])
assert set(rows["task"]) == {TASKS[0]} and episode["tasks"] == list(TASKS)

apart = rows[rows["episode_index"] == 1]["timestamp"].diff().iloc[1]
print(f"fps {info['fps']}, frames of the second {apart:.3f} s apart")
assert info["fps"] == 30 and np.isclose(apart, 1 / 15, atol=1e-4)

std = json.loads(Path("merged/meta/stats.json").read_text())["observation.state"]["std"][0]
print(f"standard deviation: {std:.2f} rad, of all frames {both.std():.2f}")
assert std < 0.12 and both.std() > 0.49

result = extract_lerobot_tasks_subset("all", [TASKS[0]], "picking")
rows, stats = seen("picking"), json.loads(Path("picking/meta/stats.json").read_text())
print(f"picking: {len(rows)} frames of {2 * sum(STEPS)}, {set(rows['task'])}; statistics {stats}")
assert len(rows) == 2 * sum(STEPS) and set(rows["task"]) == {TASKS[0]} and stats == {"stats": {}}
PYTHON
venv/bin/python merge.py
