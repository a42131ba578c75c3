#!/usr/bin/env bash
# A robot drives at 10 m/s. Its reference is a total station that measures every 2 s; its SLAM writes keyframes, every 1.8 s, all exactly where the robot was. Both are files of TUM,
# with times in seconds. The error of the keyframes is asked of epica, the way evo's tools ask (`epa_ape`, `epa_rpe`), poses being matched within 0.01 s. One in ten fits.
# Guess: the few that fit, with an error of 0; or too few matches, if the keyframes are half a second late. Seen with epica 0.1.17 and evo 1.38.1 on 2026-11-30:
# - evo matches 11 pairs, with an error of 0, and refuses the late ones
# - epica: ALL poses match, in both cases; 99 pairs, the error is 5.2 m (RMS), and no word is said. A step of more than one second between poses is taken for milliseconds (of more than 1000 for
#   microseconds), so times are divided by 1000, and 0.01 s are 10 s. With a reference of 20 poses a second, whose times stay seconds, it says "0 matches"
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check epica==0.1.17 evo==1.38.1 numpy==2.4.6 scipy==1.17.1 2>/dev/null
cat > drive.py <<'PYTHON'
import json
import subprocess
from pathlib import Path

import numpy as np
from evo.core import metrics, sync
from evo.tools import file_interface

START_S = 1_700_000_000


def save(name, times_s):
    """Save true poses: 10 m/s on a winding road."""
    x_m = 10 * times_s
    rows = [f"{START_S + time:.3f} {x:.6f} {20 * np.sin(x / 300):.6f} 0 0 0 0 1" for time, x in zip(times_s, x_m, strict=True)]
    Path(name).write_text("\n".join(rows) + "\n")


save("station.txt", np.arange(0, 200, 2.0))
save("gnss.txt", np.arange(0, 200, 0.05))
save("ninth.txt", np.arange(0, 198, 1.8))
save("late.txt", 0.5 + np.arange(0, 198, 1.8))


def by_evo(reference, estimate):
    try:
        pair = sync.associate_trajectories(*map(file_interface.read_tum_trajectory_file, (reference, estimate)))
    except sync.SyncException:
        return None
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data(pair)
    return pair[0].num_poses, round(float(error.get_statistic(metrics.StatisticsType.rmse)), 2)


def by_epica(tool, reference, estimate):
    done = subprocess.run([f"venv/bin/{tool}", "tum", reference, estimate, "--out_dir", "out"], capture_output=True, text=True)
    if done.returncode:
        return done.stderr.strip().splitlines()[-1]
    words = (done.stdout + done.stderr).replace("=", " ").replace(":", " ").split()
    assert not {"warning", "Warning", "WARNING"} & set(words), words
    return int(words[words.index("pairs") + 1]) if "pairs" in words and tool == "epa_ape" else None, float(words[words.index("rmse") + 1])


evo = {name: by_evo("station.txt", name) for name in ("ninth.txt", "late.txt")}
epica = {name: by_epica("epa_ape", "station.txt", name) for name in ("ninth.txt", "late.txt")}
relative = by_epica("epa_rpe", "station.txt", "late.txt")[1]
fast = by_epica("epa_ape", "gnss.txt", "late.txt"), by_evo("gnss.txt", "late.txt")
print("pairs, and absolute error (RMS, m): evo", evo, "epica", epica, "relative", relative)
print("of 20 poses a second: epica", fast[0], "evo", fast[1])
assert evo["ninth.txt"] == (11, 0.0) and evo["late.txt"] is None, evo
assert all(pairs == 99 and 5 < error < 6 for pairs, error in epica.values())
assert relative > 5
assert "0 matches" in fast[0] and fast[1] == (110, 0.0)
PYTHON
MPLBACKEND=Agg venv/bin/python drive.py
