#!/usr/bin/env bash
# A ground station logs two drones that hover 1.1 km apart (.tlog of MAVLink): each sends its position ten times a second, and its autopilot and the
# controller of its gimbal (another component of the same drone) send an attitude, of which the camera looks 90 degrees to the right. mavpose makes tables of
# it. Guess: a table for each drone, or a column that says whose a row is. Seen with mavpose 0.4.0 (pymavlink 2.4.50) on 2026-11-30, without a word: one table
# for both, without a column of system or component. Row by row the drone is at the one place and at the other, 1.1 km away within a millisecond, and
# attitudes of drones and cameras are mixed; the numbers of rows are the sums, and nothing in the table tells which is which
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mavpose==0.4.0 pymavlink==2.4.50 pyulog==1.3.0 numpy==2.4.6 pandas==3.1.1
cat > tables.py <<'PYTHON'
import io
import math
import struct

import numpy as np
from mavpose.log_extractor import LogExtractor
from pymavlink.dialects.v20 import ardupilotmega as dialect

BEGIN_US, AUTOPILOT, GIMBAL = 1_700_000_000_000_000, 1, 154
senders = {(drone, part): dialect.MAVLink(io.BytesIO(), srcSystem=drone, srcComponent=part) for drone in (1, 2) for part in (AUTOPILOT, GIMBAL)}
with open("flight.tlog", "wb") as file:
    for tick in range(10):
        for order, ((drone, part), sender) in enumerate(senders.items()):
            yaw = math.pi / 2 if part == GIMBAL else 0.0
            messages = [sender.attitude_encode(tick * 100, 0.0, 0.0, yaw, 0.0, 0.0, 0.0)]
            if part == AUTOPILOT:
                latitude = round((48 + drone * 0.01) * 1e7)
                messages.append(sender.global_position_int_encode(tick * 100, latitude, 115_000_000, 600_000, 50_000, 0, 0, 0, 0))
            for message in messages:
                file.write(struct.pack(">Q", BEGIN_US + tick * 100_000 + order * 500) + message.pack(sender))

log = LogExtractor("flight.tlog")
tables = log.extract_all()
places, attitudes = tables["GLOBAL_POSITION_INT"], tables["ATTITUDE"]
step_m = np.abs(np.diff(places["lat"])) * 111_200
print(f"{len(places)} places, {step_m.min():.0f} to {step_m.max():.0f} m from one to the next; yaws {attitudes['yaw'].head(4).round(2).tolist()}; columns {places.columns.tolist()}")
assert (len(places), len(attitudes)) == (20, 40)
assert np.allclose(step_m, 1112, atol=1)
assert attitudes["yaw"].head(4).round(2).tolist() == [0, 1.57, 0, 1.57]
assert places.columns.tolist() == ["time_s", "msg_type", "time_boot_ms", "lat", "lon", "alt", "relative_alt", "vx", "vy", "vz", "hdg"]
assert (log.stats["bad_data"], log.stats["errors"]) == (0, 0)
PYTHON
venv/bin/python tables.py > tables.txt 2> said.txt
cat tables.txt
if grep -iE 'warn|system|component|vehicle' said.txt; then exit 1; fi
