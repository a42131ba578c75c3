#!/usr/bin/env bash
# A lorry of 12 m drives east at a constant 20 m/s through a simulation of traffic (SUMO), from x = 100 m on at 0 s, in steps of a second. Its trajectory becomes labels:
# boxes with a centre and a yaw. It is read step by step (`getPosition`, at `getTime`), and from the file that SUMO writes (`--fcd-output`).
# Guess: x is the centre, the angle counts from east to the left, and both ways have one time for one position.
# Seen with libsumo 1.28.0 on 2026-11-29, without a word:
# - x is the FRONT bumper: a lorry that departs with its rear end at the start of the road is at 12.1 m; the centre is half a length behind
# - the angle is 90: clockwise, from north, in degrees
# - after a step `getTime` is one step further than the file: at 120 m it is 1 s in the file and 2 s by `getTime`, so labels of the latter are 20 m behind
# - the file has two decimals, unless `--precision` says otherwise
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check libsumo==1.28.0
cd "$folder"
cat >road.net.xml <<'XML'
<net version="1.16"><location netOffset="0,0" convBoundary="0,0,900,0" origBoundary="0,0,900,0" projParameter="!"/>
  <edge id="road" from="a" to="b" priority="-1"><lane id="road_0" index="0" speed="20" length="900" width="3" shape="0,0 900,0"/></edge>
  <junction id="a" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0 0,-3"/>
  <junction id="b" type="dead_end" x="900" y="0" incLanes="road_0" intLanes="" shape="900,-3 900,0"/></net>
XML
cat >lorries.rou.xml <<'XML'
<routes><vType id="lorry" length="12" sigma="0" speedFactor="1" speedDev="0"/><route id="east" edges="road"/>
  <vehicle id="fast" type="lorry" route="east" depart="0" departPos="100" departSpeed="20"/>
  <vehicle id="new" type="lorry" route="east" depart="0" departPos="base" departSpeed="0"/></routes>
XML
venv/bin/python - <<'PYTHON'
from xml.etree import ElementTree

import libsumo

libsumo.start(["sumo", "--net-file", "road.net.xml", "--route-files", "lorries.rou.xml", "--no-step-log", "--fcd-output", "fcd.xml"])
stepped = {}
for step in range(4):
    libsumo.simulationStep()
    stepped[libsumo.simulation.getTime()] = libsumo.vehicle.getPosition("fast")[0]
    if not step:
        rear_at_start_m, angle_deg = libsumo.vehicle.getPosition("new")[0], libsumo.vehicle.getAngle("fast")
libsumo.close()
written = {float(step.get("time")): float(step.find("vehicle[@id='fast']").get("x")) for step in ElementTree.parse("fcd.xml").getroot() if len(step)}
print("step by step:", stepped)
print("in the file: ", written)
print("with its rear end at 0:", rear_at_start_m, "m; angle:", angle_deg)
assert stepped == {1: 100, 2: 120, 3: 140, 4: 160} and written == {0: 100, 1: 120, 2: 140, 3: 160}
assert abs(rear_at_start_m - 12.1) < 1e-9 and angle_deg == 90
PYTHON
