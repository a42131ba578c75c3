#!/usr/bin/env bash
# A raw drive of KITTI has an OXTS file of 30 values for each frame: position, angles, velocities, then accelerations along the vehicle's x, y, z axes
# and along forward, left, up. The car brakes by 2 m/s² in a bend that pushes it by 1, on a level road, so az is 9.81. torch-kitti reads them with names
# (`IMUData.open`). Guess: under those of KITTI's own description. Seen with torch-kitti 1.0.1 on 2026-11-29, without a word: its list of names has "ay"
# twice, so `ay` is 9.81, gravity, and there is no `az`; all other names are right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps torch-kitti==1.0.1 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import importlib.util
from pathlib import Path

NAMES = (
    "lat lon alt roll pitch yaw vn ve vf vl vu ax ay az af al au wx wy wz wf wl wu pos_accuracy vel_accuracy navstat numsats posmode velmode orimode"
).split()
values = dict.fromkeys(NAMES, 0.0) | {"lat": 49.0, "lon": 8.4, "alt": 110.0, "vf": 15.0, "ax": -2.0, "ay": 1.0, "az": 9.81, "wz": 0.07, "numsats": 8}
Path("0000000000.txt").write_text(" ".join(f"{value:g}" for value in values.values()) + "\n")


def module(path):
    """Import a file of an installed package by itself, without the parts of the package that want PyTorch."""
    (file,) = Path("venv/lib").glob(f"python3*/site-packages/{path}")
    spec = importlib.util.spec_from_file_location(file.stem, file)
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


by_name = vars(module("torch_kitti/raw/inertial_measurement_unit.py").IMUData.open("0000000000.txt"))
print("torch-kitti: ax", by_name["ax"], "ay", by_name["ay"], "az" in by_name and by_name["az"])
print("written:     ax", values["ax"], "ay", values["ay"], "az", values["az"])
assert by_name["ay"] == values["az"] == 9.81 and "az" not in by_name
assert all(by_name[name] == values[name] for name in NAMES if name not in ("ay", "az"))
PYTHON
