#!/usr/bin/env bash
# A take of motion capture (C3D, 119.88 Hz) lasts 100 s, from frame 101 of the recording on. It has a marker and two analog channels, a force of 700 N and an EMG of 0.001 V, at ten times that rate; a foot
# strikes 70 s after the start, at 1 min 10.834 s of the recording, as C3D counts events: minutes and seconds. It becomes a table with biomechzoo. Guess: 700 N, 0.001 V, 119.88 Hz, a strike in row 8392.
# And acceleration of a trunk in m/s2, which is in three channels, is corrected for tilt: new channels, the old ones as before.
# Seen with biomechzoo 0.8.25 beside ezc3d 1.7.2 on 2026-11-30, without a word:
# - the force is 700 N in the first half, 0.001 in the second, and so is the EMG: channels one after another are cut into rows as if they stood side by side. Of a channel that changes, each of two has every
#   second sample, at half the rate, and then the other one's
# - 119 Hz: 0.7 % slow, 0.74 s at the end; and with it the strike is in row 1288, 10.7 s in: minutes are left out, and the first frame too
# - tilt: the OLD channels are changed as well, to g, or turned around where they point down
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-deps biomechzoo==0.8.25 ezc3d==1.7.2 numpy==2.2.6 pandas==2.3.3 scipy==1.17.1 python-dateutil==2.9.0.post0 pytz==2026.6 six==1.17.0 2>/dev/null
cat > take.py <<'PYTHON'
import importlib.abc
import importlib.machinery
import sys
from unittest.mock import MagicMock

import ezc3d
import numpy as np
import pandas as pd

UNUSED = {"plotly", "dash", "statsmodels", "nbformat", "kaleido", "EntropyHub", "kielmat", "pycompare", "pyarrow", "matplotlib", "openpyxl"}


class Unused(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Stand in for packages that draw or analyse, which the package loads at once."""

    def find_spec(self, name, path, target=None):
        return importlib.machinery.ModuleSpec(name, self, is_package=True) if name.split(".")[0] in UNUSED else None

    def create_module(self, spec):
        module = MagicMock()
        module.__spec__, module.__path__ = spec, []
        return module

    def exec_module(self, module):
        pass


sys.meta_path.insert(0, Unused())
from biomechzoo.conversion.c3d2zoo_data import c3d2zoo_data
from biomechzoo.imu.tilt_algorithm import tilt_algorithm_data

RATE_HZ, RATIO, FIRST, STRIKE_S = 119.88, 10, 100, 70.0
FRAMES = round(100 * RATE_HZ)

take = ezc3d.c3d()
take["header"]["points"]["first_frame"] = FIRST
take["parameters"]["POINT"]["RATE"]["value"] = [RATE_HZ]
take["parameters"]["POINT"]["LABELS"]["value"] = ["SACR"]
take["parameters"]["ANALOG"]["RATE"]["value"] = [RATIO * RATE_HZ]
take["parameters"]["ANALOG"]["LABELS"]["value"] = ["FZ", "EMG"]
points = np.ones((4, 1, FRAMES))
points[0, 0] = np.arange(FRAMES)
take["data"]["points"] = points
analogs = np.ones((1, 2, RATIO * FRAMES))
analogs[0, 0], analogs[0, 1] = 700, 0.001
take["data"]["analogs"] = analogs
strike_s = FIRST / RATE_HZ + STRIKE_S
take.add_event([strike_s // 60, strike_s % 60], label="Foot Strike", context="Right", subject="A")
take.write("take.c3d")
data = c3d2zoo_data(ezc3d.c3d("take.c3d"))
rates_hz = data["zoosystem"]["Video"]["Freq"], data["zoosystem"]["Analog"]["Freq"]
halves = {name: [np.unique(half.round(6)).tolist() for half in np.split(data[name]["line"][:, 0], 2)] for name in ("FZ", "EMG")}
((row, *_),) = data["SACR"]["event"].values()
print(f"rates {rates_hz} Hz, halves of the channels {halves}; strike at {strike_s:.3f} s of the recording: row {row} of {FRAMES}, and {round(STRIKE_S * RATE_HZ)} is right")
assert rates_hz == (119, 1198) and halves == {"FZ": [[700], [0.001]], "EMG": [[700], [0.001]]} and row == 1288
ramp = np.arange(RATIO * FRAMES, dtype=float)
take["data"]["analogs"] = np.stack([ramp, -ramp])[None]
take.write("ramps.c3d")
force = c3d2zoo_data(ezc3d.c3d("ramps.c3d"))["FZ"]["line"][:, 0]
print("of 0, 1, 2, ... and 0, -1, -2, ... the first has", force[:4], "... and ends with", force[-3:])
assert force[:4].tolist() == [0, 2, 4, 6] and force[-1] == -(len(ramp) - 2)

for unit, numbers, after in (("m/s2", (9.7, 0.5, 1.2), np.array([9.7, 0.5, 1.2]) / 9.81), ("g", (-0.97, 0.05, 0.12), (0.97, -0.05, 0.12))):
    names = "up", "side", "ahead"
    trunk = {"zoosystem": data["zoosystem"]} | {name: {"line": np.full(100, number), "event": {}} for name, number in zip(names, numbers)}
    tilt_algorithm_data(trunk, *names)
    old = [float(trunk[name]["line"][0]) for name in names]
    print(f"tilt, in {unit}: {numbers} have become {np.round(old, 3).tolist()}")
    assert np.allclose(old, after)
PYTHON
venv/bin/python take.py > said.txt 2>&1 || { tail -8 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
