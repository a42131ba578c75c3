#!/usr/bin/env bash
# Two LeRobot datasets are trained on together through robocandywrapper, one twice as often as its size; its `WeightedSampler` is set up as in the example that its help gives, with seed 42, for ten
# epochs. Both robots are arms, one of six joints and one of seven. Which frames are seen, and by which statistics is the seventh joint normalised, whose positions go from 2.0 to 2.4 rad?
# Guess: other frames in each epoch, so that ten epochs leave next to none out; and those of the arm that has a seventh joint.
# Seen with robocandywrapper 0.2.18 on 2026-11-30, without a word:
# - each epoch is the first one again, frame by frame, as the generator begins anew with its seed, and frames are drawn with replacement: of the 1000 frames of the one
#   dataset 470 are seen, in whichever number of epochs, one of them six times in each. Without a seed ten epochs see all but a few
# - the six-jointed arm counts with a seventh joint at 0, which varies by 1: the mean is 1.1 rad in place of 2.2, the standard deviation 1.31 in place of 0.1, the minimum 0;
#   normalised, the positions of the joint lie between 0.69 and 0.99
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check torch==2.13.0 numpy==2.4.6
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps robocandywrapper==0.2.18
cd "$folder"
venv/bin/python -W ignore - 2>errors.txt <<'PYTHON' || { tail -5 errors.txt; exit 1; }
import ast
import importlib.util
import sys
from collections import Counter
from pathlib import Path

import numpy as np


def found(path):
    return next(Path(folder) / path for folder in sys.path if (Path(folder) / path).exists())


spec = importlib.util.spec_from_file_location("weighted", found("robocandywrapper/samplers/weighted.py"))
weighted = importlib.util.module_from_spec(spec)  # without the others of its package, which import lerobot
spec.loader.exec_module(weighted)
source = ast.parse(found("robocandywrapper/metadata_view.py").read_text())
namespace = {"np": np}
exec(compile(ast.Module([each for each in source.body if getattr(each, "name", "") == "aggregate_stats_weighted"], []), "stats", "exec"), namespace)

six, seven = "me/six-joints", "me/seven-joints"


def epochs(seed):
    sampler = weighted.WeightedSampler([(0, 1000), (1000, 2000)], [six, seven], {seven: 2.0}, seed=seed)
    return [list(sampler) for _ in range(10)]


for seed in (42, None):
    each = epochs(seed)
    seen = Counter(frame for epoch in each for frame in epoch if frame < 1000)
    print("seed", seed, "- epochs alike:", each[0] == each[9], "- frames of 1000 seen in ten epochs:", len(seen), "- most often:", max(seen.values()))
    assert (each[0] == each[9]) == (seed == 42)
    assert len(seen) == 470 and max(seen.values()) == 60 if seed == 42 else len(seen) > 990

positions = np.random.default_rng(0).uniform(2.0, 2.4, (1000, 7))


def stats(array):
    return {"action": {"min": array.min(0), "max": array.max(0), "mean": array.mean(0), "std": array.std(0), "count": np.array([len(array)])}}


together = namespace["aggregate_stats_weighted"]([stats(positions[:, :6]), stats(positions)], [1.0, 1.0])["action"]
seventh = {name: round(float(together[name][6]), 2) for name in ("min", "max", "mean", "std")}
normalised = [round((edge - seventh["mean"]) / seventh["std"], 2) for edge in (2.0, 2.4)]
print("seventh joint:", seventh, "normalised:", normalised)
assert seventh == {"min": 0.0, "max": 2.4, "mean": 1.1, "std": 1.31} and normalised == [0.69, 0.99]
PYTHON
