#!/usr/bin/env bash
# An IMU is turned by 90 degrees about its vertical axis, logged at one of the rates that such chips have, in seconds with six decimals (CSV). imuops takes it in
# (`ingest tabular`), and replays it with Madgwick's filter (`replay`). Guess: the rate, and a turn by 90 degrees, at any rate.
# Seen with imuops 0.4.1 on 2026-11-30, without a word: times are kept as whole milliseconds, and the rate is the median of their steps. So 104 Hz are 100 and
# 208 Hz are 200, and the turn is one by 93.6 degrees; 416 Hz are 500, and 833 Hz are 1000, and it is one by 75 degrees. At 100 Hz it is right
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check imuops==0.4.1 AHRS==0.4.0 numpy==2.4.6 pandas==3.1.1 pyarrow==26.0.1 h5py==3.16.0 typer==0.29.2 pydantic==2.14.4 2>/dev/null
cat > turn.yaml <<'YAML'
imu:
  timestamp_col: t
  timestamp_unit: s
  accel_cols: [ax, ay, az]
  accel_unit: m/s^2
  gyro_cols: [gx, gy, gz]
  gyro_unit: rad/s
YAML
cat > turn.py <<'PYTHON'
import json
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd

for rate_hz, kept_hz, turned_deg in ((100, 100, 90.0), (104, 100, 93.6), (208, 200, 93.6), (416, 500, 74.9), (833, 1000, 75.0)):
    times_s = np.arange(6 * rate_hz) / rate_hz
    turning = np.where((times_s >= 2) & (times_s < 4), np.pi / 4, 0.0)
    still = dict.fromkeys(("ax", "ay", "gx", "gy"), 0.0)
    pd.DataFrame({"t": times_s, "az": 9.80665, **still, "gz": turning}).to_csv("turn.csv", index=False, float_format="%.6f")
    said = ""
    for command in (["ingest", "tabular", "turn.csv", "--config", "turn.yaml", "--out"], ["replay", "--baseline", "madgwick"]):
        said += subprocess.run(["venv/bin/imuops", *command, f"at_{rate_hz}"], check=True, capture_output=True, text=True).stdout
    rate = json.loads(Path(f"at_{rate_hz}/session.json").read_text())["nominal_hz"]
    yaw_deg = np.degrees(pd.read_parquet(f"at_{rate_hz}/replay_madgwick.parquet")["yaw"].iloc[-1])
    print(f"{rate_hz} Hz are {rate:g} Hz, 90 degrees are {yaw_deg:.1f}")
    assert rate == kept_hz and abs(yaw_deg - turned_deg) < 0.1
    assert "warn" not in said.lower()
PYTHON
venv/bin/python turn.py 2> said.txt || { tail -5 said.txt; exit 1; }
