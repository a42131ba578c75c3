#!/usr/bin/env bash
# A LeRobot dataset (v3.0) of an arm: four episodes, actions of three numbers, and the statistics by which a policy normalizes them, right to the last digit. Do the tools
# that check datasets before training find nothing? And something, once the action's statistics are in degrees and its values in radians?
# Guess: twice yes. Seen on 2026-12-01:
#   robovet 0.2.2, rdq 0.3.4   so it is
#   trajlens 0.4.0             FAIL, "unsafe to train on", a trust score of 65 of 100: of both. It takes the three numbers of an action for one quantity, and compares the mean of
#                              each with that of all, so that only a vector of equals would pass. `trajlens fix --apply` then says of both that there is nothing to fix,
#                              and copies them as they are: there, lists are not compared at all
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check trajlens==0.4.0 robovet==0.2.2 rdq==0.3.4 numpy==2.4.6 pandas==3.1.1 pyarrow==24.0.0
cd "$folder"
cat > check.py <<'PYTHON'
import json
import math
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

FPS, LENGTHS = 10, [40, 50, 60, 70]
NAMES = ["shoulder", "elbow", "gripper"]


def statistics(values):
    values = np.asarray(values, np.float64).reshape(len(values), -1)
    made = {name: getattr(np, name)(values, axis=0).tolist() for name in ("min", "max", "mean", "std")}
    return {**made, "count": [len(values)]}


def write(root, degrees_in_statistics):
    episode = np.repeat(np.arange(len(LENGTHS)), LENGTHS)
    frame = np.concatenate([np.arange(length) for length in LENGTHS])
    angle = frame / FPS
    action = np.stack([np.sin(angle) + 0.1 * episode, 1 + np.cos(angle), 0.5 + (frame % 2) / 4], axis=1).astype(np.float32)
    columns = {
        "action": action,
        "timestamp": (frame / FPS).astype(np.float32),
        "frame_index": frame,
        "episode_index": episode,
        "index": np.arange(len(frame)),
        "task_index": np.zeros(len(frame), np.int64),
    }
    for part in ("meta/episodes/chunk-000", "data/chunk-000"):
        (root / part).mkdir(parents=True)
    vectors = pa.FixedSizeListArray.from_arrays(pa.array(action.ravel()), 3)
    table = pa.table({name: vectors if name == "action" else pa.array(column) for name, column in columns.items()})
    pq.write_table(table, root / "data/chunk-000/file-000.parquet")
    pd.DataFrame({"task_index": [0]}, index=["put the red cube into the box"]).to_parquet(root / "meta/tasks.parquet")
    rows = []
    for number, length in enumerate(LENGTHS):
        inside = episode == number
        start = int(np.flatnonzero(inside)[0])
        row = {"episode_index": number, "tasks": ["put the red cube into the box"], "length": length, "data/chunk_index": 0, "data/file_index": 0}
        row |= {"dataset_from_index": start, "dataset_to_index": start + length, "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
        for name, column in columns.items():
            row |= {f"stats/{name}/{key}": value for key, value in statistics(column[inside]).items()}
        rows.append(row)
    pq.write_table(pa.Table.from_pylist(rows), root / "meta/episodes/chunk-000/file-000.parquet")
    features = {name: {"dtype": str(column.dtype), "shape": [3 if name == "action" else 1], "names": NAMES if name == "action" else None} for name, column in columns.items()}
    info = {"codebase_version": "v3.0", "robot_type": "arm", "total_episodes": len(LENGTHS), "total_frames": len(frame), "total_tasks": 1, "chunks_size": 1000}
    info |= {"fps": FPS, "splits": {"train": "0:4"}, "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet", "video_path": None, "features": features}
    (root / "meta/info.json").write_text(json.dumps(info, indent=4))
    stats = {name: statistics(column) for name, column in columns.items()}
    if degrees_in_statistics:
        for key in ("min", "max", "mean", "std"):
            stats["action"][key] = [math.degrees(value) for value in stats["action"][key]]
    (root / "meta/stats.json").write_text(json.dumps(stats, indent=4))


def run(*command):
    return subprocess.run(command, capture_output=True, text=True, env={"PATH": "venv/bin:/usr/bin:/bin", "COLUMNS": "200", "HF_HUB_OFFLINE": "1"})


seen = {}
for name, degrees in (("right", False), ("wrong", True)):
    write(Path(name), degrees)
    lint = {check["check_id"]: check for check in json.loads(run("trajlens", "lint", name, "--json").stdout)["results"]}
    report = run("trajlens", "lint", name).stdout
    fix = run("trajlens", "fix", name, "--apply", "--out", f"{name}-fixed")
    seen[name] = {
        "robovet": run("robovet", "doctor", name).returncode,
        "rdq": "stats.json for 'action' does not match" in run("rdq", "check", name).stdout,
        "trajlens": lint["STATISTICAL.STATS_MATCH_DATA"]["severity"],
        "score": "Trust score : 65/100" in report and "unsafe to train on" in report,
        "fix": (fix.returncode, "Nothing to fix" in fix.stdout, Path(f"{name}-fixed/meta/stats.json").read_bytes() == Path(f"{name}/meta/stats.json").read_bytes()),
    }
    print(name, seen[name], lint["STATISTICAL.STATS_MATCH_DATA"]["message"], sep="\n  ")
assert seen["right"] == {"robovet": 0, "rdq": False, "trajlens": "FAIL", "score": True, "fix": (0, True, True)}, seen
assert seen["wrong"] == {"robovet": 1, "rdq": True, "trajlens": "FAIL", "score": True, "fix": (0, True, True)}, seen
PYTHON
venv/bin/python check.py
