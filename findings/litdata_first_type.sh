#!/usr/bin/env bash
# Steps of an arm are written for streaming with litdata: the positions of its joints, as an array. The first step comes from the file that says
# where home is, with other types than the recording's: whole numbers, or float32 in place of float64. Guess: each array has its own type, or an error.
# Seen with litdata 0.2.76 on 2026-11-30, without a word:
# Arrays and tensors of one dimension have the type of the FIRST that was written. After whole numbers, 0.1 rad is 4591870180066957722; after float32, each
# float64 is two numbers, so two joints are four. As an array of two dimensions, each has its own
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check litdata==0.2.76 torch==2.13.0 numpy==2.4.6 2>/dev/null
cd "$folder"
cat > stream.py <<'PYTHON'
import litdata
import numpy as np

STEPS = 6
JOINTS_RAD = np.array([[0.1 * step, -0.2 * step] for step in range(STEPS)])


def after_integers(step):
    return {"joints": np.array([0, 0]) if step == 0 else JOINTS_RAD[step]}


def after_float32(step):
    return {"joints": JOINTS_RAD[step].astype(np.float32) if step == 0 else JOINTS_RAD[step]}


def in_rows_after_float32(step):
    return {"joints": after_float32(step)["joints"][None]}


def read(steps):
    """Write the steps, and return their joints as a stream has them."""
    folder = steps.__name__
    litdata.optimize(fn=steps, inputs=list(range(STEPS)), output_dir=folder, chunk_bytes="1MB", num_workers=1)
    stream = litdata.StreamingDataset(folder)
    return [np.asarray(stream[place]["joints"]) for place in range(STEPS)]


if __name__ == "__main__":
    streams = {steps: read(steps) for steps in (after_integers, after_float32, in_rows_after_float32)}
    for steps, joints in streams.items():
        print(f"{steps.__name__}: {JOINTS_RAD[1].tolist()} read as {joints[1].tolist()}")
    assert all(joints.dtype == np.int64 and np.array_equal(joints.view(np.float64), JOINTS_RAD[step]) for step, joints in enumerate(streams[after_integers]))
    for step, joints in enumerate(streams[after_float32][1:], start=1):
        assert joints.shape == (4,) and joints.dtype == np.float32 and np.array_equal(joints.view(np.float64), JOINTS_RAD[step])
    assert np.allclose(np.concatenate(streams[in_rows_after_float32]), JOINTS_RAD, atol=1e-6)
PYTHON
venv/bin/python stream.py 2>said.txt | grep -E 'read as' || { tail -5 said.txt; exit 1; }
