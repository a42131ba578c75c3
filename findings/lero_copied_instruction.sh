#!/usr/bin/env bash
# A LeRobot dataset (v2.1) has three episodes of two frames: "reach" (joints at 0 rad), "push" (1 rad), "pull" (2 rad), each with a video. With lero (lero-core) an
# episode is copied with another instruction, which makes of "reach" an episode "wave"; or the first episode is deleted. Training takes the instruction of a
# frame by its `task_index`, and its picture from the video of its `episode_index`: which are these? Guess: those of the new instruction, of the new number.
# Seen with lero-core 0.3.0 on 2026-11-30, each with "Successfully …": after the copy, all frames of the new episode have the task_index of "reach", so that
# nothing in training ever says "wave", which meta/tasks.jsonl has. After deletion, files are renumbered and the numbers in them are not: frames of "push", now
# episode 0, say that they belong to episode 1, whose video is that of "pull"; the frames of "pull" belong to episode 2, which is no more. `index`, the number of
# a frame in the dataset, begins at 2 after deletion, and begins at 0 again in the copy
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check lero-core==0.3.0 pandas==3.1.1 pyarrow==26.0.1
cat > dataset.py <<'PYTHON'
import json
import sys
from pathlib import Path

import pandas as pd

TASKS, CAMERA, FRAMES = ("reach", "push", "pull"), "observation.images.wrist", 2
DATA, VIDEO = "data/chunk-{:03d}/episode_{:06d}.parquet", "videos/chunk-{:03d}/{}/episode_{:06d}.mp4"


def write(root):
    for episode, task in enumerate(TASKS):
        table, video = root / DATA.format(0, episode), root / VIDEO.format(0, CAMERA, episode)
        for file in (table, video):
            file.parent.mkdir(parents=True, exist_ok=True)
        frames = range(FRAMES)
        rows = {
            "observation.state": [[float(episode)] for _ in frames],
            "timestamp": [frame / 10 for frame in frames],
            "frame_index": list(frames),
            "episode_index": [episode] * FRAMES,
            "index": [episode * FRAMES + frame for frame in frames],
            "task_index": [episode] * FRAMES,
        }
        pd.DataFrame(rows).to_parquet(table, index=False)
        video.write_text(f"film of {task}")  # as it is moved and copied, never opened
    feature = {"dtype": "video", "shape": [48, 64, 3], "names": ["height", "width", "channels"]}
    info = {
        "codebase_version": "v2.1",
        "robot_type": "arm",
        "fps": 10,
        "total_episodes": len(TASKS),
        "total_frames": len(TASKS) * FRAMES,
        "total_tasks": len(TASKS),
        "chunks_size": 1000,
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
        "features": {"observation.state": {"dtype": "float32", "shape": [1], "names": ["joint"]}, CAMERA: feature},
    }
    (root / "meta").mkdir()
    (root / "meta/info.json").write_text(json.dumps(info))
    tables = {
        "tasks": [{"task_index": number, "task": task} for number, task in enumerate(TASKS)],
        "episodes": [{"episode_index": number, "tasks": [task], "length": FRAMES} for number, task in enumerate(TASKS)],
    }
    for name, lines in tables.items():
        (root / f"meta/{name}.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))


def read(root):
    """Return for each file of an episode: what was recorded in it, the tasks and the film that its rows lead to, and `index`."""
    tasks = {line["task_index"]: line["task"] for line in map(json.loads, (root / "meta/tasks.jsonl").read_text().splitlines())}
    found = {}
    for path in sorted(root.glob("data/*/*.parquet")):
        rows = pd.read_parquet(path)
        films = [root / VIDEO.format(0, CAMERA, number) for number in rows["episode_index"].unique()]
        found[path.stem] = (
            [TASKS[int(state[0])] for state in rows["observation.state"]][0],
            [tasks[number] for number in rows["task_index"].unique()],
            [film.read_text() if film.exists() else None for film in films],
            rows["index"].tolist(),
        )
    return found


root = Path(sys.argv[2])
if sys.argv[1] == "write":
    write(root)
else:
    found = read(root)
    for name, row in found.items():
        print(f"{root}: {name} was recorded as {row[0]}; its rows: tasks {row[1]}, {row[2]}, index {row[3]}")
    if root.name == "copied":
        assert "wave" in (root / "meta/tasks.jsonl").read_text()
        assert found["episode_000003"] == ("reach", ["reach"], ["film of reach"], [0, 1]), found
    else:
        assert found == {
            "episode_000000": ("push", ["push"], ["film of pull"], [2, 3]),
            "episode_000001": ("pull", ["pull"], [None], [4, 5]),
        }, found
PYTHON
for name in copied deleted; do
  venv/bin/python dataset.py write $name
done
venv/bin/lero copied --copy 0 --instruction wave >log.txt
grep -q "Successfully" log.txt
venv/bin/lero deleted --delete 0 >log.txt
grep -q "Successfully" log.txt
for name in copied deleted; do
  venv/bin/python dataset.py read $name
done
