#!/usr/bin/env bash
# Markers of a hand, an elbow and a head, as text of motion capture with tabs (the TSV of Qualisys Track Manager): in one frame of 100 the hand is hidden, and its three fields are
# empty. What do two readers make of it? Guess: NaN for the hand in that frame, and all else as it is. Seen on 2026-12-01, without a word:
#   mopipe 0.2.0         so it is
#   micromotion 1.15.0   the head is gone, in all frames, and its name with it; in that frame the hand is where the elbow is, and the elbow where the head is. The fields of a line move
#                        up into the empty ones, and all lines are cut to the shortest
# Where a gap is written as zeros, both are right about the other markers.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check micromotion==1.15.0 mopipe==0.2.0 numpy==2.4.6 pandas==3.1.1 scipy==1.17.1 2>/dev/null
cd "$folder"
venv/bin/python - <<'PYTHON'
from pathlib import Path

import numpy as np
from micromotion.mocap import read_qtm_tsv
from mopipe.core.data.reader import MocapReader

NAMES, FRAMES, HIDDEN = ["Hand", "Elbow", "Head"], 100, 40
HEADER = ["NO_OF_FRAMES\t100", "NO_OF_CAMERAS\t8", "NO_OF_MARKERS\t3", "FREQUENCY\t100", "DATA_INCLUDED\t3D", "\t".join(["MARKER_NAMES", *NAMES])]
positions_mm = np.array([100.0, 200.0, 300.0])[:, None] + [1, 2, 3] + np.zeros((FRAMES, 1, 1))


def read(name, gap):
    lines = []
    for frame in range(FRAMES):
        fields = [f"{value:.3f}" for value in positions_mm[frame].ravel()]
        if frame == HIDDEN:
            fields[:3] = [gap] * 3
        lines.append("\t".join([str(frame + 1), f"{frame / 100:.5f}", *fields]))
    Path(name).write_text("\n".join([*HEADER, *lines]) + "\n")
    table = MocapReader(source=Path(name), name="take").read().data
    names, data, rate_hz = read_qtm_tsv(name)
    assert rate_hz == 100
    return names, data, table.iloc[:, 1:].to_numpy(float).reshape(FRAMES, 3, 3)


names, data, pipe = read("empty.tsv", "")
print("empty fields: mopipe", pipe[HIDDEN, :, 0].tolist(), "micromotion", names, data[HIDDEN - 1, :, 0].tolist(), "and in the frame", data[HIDDEN, :, 0].tolist())
assert np.isnan(pipe[HIDDEN, 0]).all() and np.array_equal(pipe[HIDDEN, 1:], positions_mm[HIDDEN, 1:])
assert names == ["Hand", "Elbow"] and data.shape == (FRAMES, 2, 3)
assert np.array_equal(data[HIDDEN], positions_mm[HIDDEN, 1:])
assert np.array_equal(np.delete(data, HIDDEN, axis=0), np.delete(positions_mm[:, :2], HIDDEN, axis=0))

names, data, pipe = read("zeros.tsv", "0.000")
assert names == NAMES and np.isnan(data[HIDDEN, 0]).all() and np.array_equal(data[:, 1:], positions_mm[:, 1:])
assert np.array_equal(pipe[:, 1:], positions_mm[:, 1:])
PYTHON
