#!/usr/bin/env bash
# A drive of 10 s as a BLF of CAN: speed 50 times a second, the steering angle 100 times, and an outside temperature once a second. The DBC has a name for one
# value of speed, 65535, `SNA` ("signal not available"), as DBCs of vehicles have it; the sensor sends it once. canml makes a table of it, for training, as
# its documentation shows: with `force_uniform_timing` of 0.02 s, and `dtype_map`. Guess: a column of speeds, without a number where it is SNA; a row each
# 0.02 s. Seen with canml 0.1.14 (cantools 39.4.4) on 2026-11-30, without a word:
# - a column whose signal has a name for ANY value is made of names alone: of 500 speeds none is left, the one "SNA" is. The temperature, which has no names,
#   is there
# - "uniform timing" numbers the ROWS, one for each frame of whichever identifier, and each has 0.02 s: the drive of 10 s takes 30.2 s, and frames of a time
#   are apart in order of their arrival; nothing is resampled or filled
# - with `expected_signals` of the speed alone, the same drive takes 10 s
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check canml==0.1.14 cantools==39.4.4 python-can==4.4.0 numpy==1.26.4 pandas==2.2.2
cat > vehicle.dbc <<'DBC'
VERSION ""
BU_: ECU
BO_ 256 Motion: 2 ECU
 SG_ Speed : 0|16@1+ (0.01,0) [0|655.34] "km/h" ECU
BO_ 257 Steering: 2 ECU
 SG_ Angle : 0|16@1- (0.1,0) [-800|800] "deg" ECU
BO_ 258 Climate: 1 ECU
 SG_ Outside : 0|8@1- (0.5,0) [-40|60] "degC" ECU
VAL_ 256 Speed 65535 "SNA" ;
DBC
cat > table.py <<'PYTHON'
import can
import cantools
import numpy as np
from canml.canmlio import CanmlConfig, load_blf, load_dbc_files

database = cantools.database.load_file("vehicle.dbc")
frames = [(tick / 50, "Motion", {"Speed": 65535 if tick == 250 else 36.0 + tick * 0.1}) for tick in range(500)]
frames += [(tick / 100, "Steering", {"Angle": 1.5}) for tick in range(1000)]
frames += [(float(tick), "Climate", {"Outside": 20.5}) for tick in range(10)]
with can.BLFWriter("drive.blf") as writer:
    for at_s, name, values in sorted(frames, key=lambda frame: frame[0]):
        message = database.get_message_by_name(name)
        scaling = "Speed" not in values or values["Speed"] != 65535
        data = message.encode(values, scaling=scaling, strict=False)
        writer.on_message_received(can.Message(timestamp=1_700_000_000 + at_s, arbitration_id=message.frame_id, data=data, is_extended_id=False))

config = CanmlConfig(progress_bar=False, sort_timestamps=True, force_uniform_timing=True, interval_seconds=0.02)
table = load_blf("drive.blf", load_dbc_files("vehicle.dbc"), config)
raw_s = table["raw_timestamp"] - table["raw_timestamp"].iloc[0]
print(table[["Speed", "Angle", "Outside"]].count().to_dict(), table["Speed"].dropna().tolist())
print(f"{raw_s.max():.2f} s of the bus take {table['timestamp'].max():.2f} s")
assert table[["Speed", "Angle", "Outside"]].count().to_dict() == {"Speed": 1, "Angle": 1000, "Outside": 10}
assert table["Speed"].dropna().tolist() == ["SNA"]
assert np.isclose(raw_s.max(), 9.99)
assert np.isclose(table["timestamp"].max(), 1509 * 0.02)
alone = load_blf("drive.blf", "vehicle.dbc", config, expected_signals=["Speed"])
assert np.isclose(alone["timestamp"].max(), 499 * 0.02)
PYTHON
venv/bin/python table.py > table.txt 2> said.txt
cat table.txt
if grep -iE "warn|error" said.txt; then exit 1; fi
