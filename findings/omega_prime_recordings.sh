#!/usr/bin/env bash
# Traffic, a car at 10 m/s and a pedestrian of 0.5 x 0.6 x 1.8 m, is kept by omega-prime (OSI in MCAP, or Parquet): written and read, placed on an OpenDRIVE map
# with another frame (turned left by 90 degrees), brought to another rate (`interpolate`), and converted from highD.
# Guess: the same boxes; positions, headings, velocities and boxes turned alike; 21 instants of a second at 20 Hz, 11 at the rate as it is; and boxes where
# highD has them, by their upper left corner in an image.
# Seen with omega-prime 0.3.7 and betterosi 0.8.5 on 2026-11-30, without a word:
# - through MCAP all heights are widths: the pedestrian is 0.6 m high. Through Parquet they are right
# - positions are turned, as soon as a file with a frame is opened with a map, and nothing else: the car goes north with its heading, its velocity and its box to the east
# - `interpolate()` makes 10 instants of 11 (111 ms apart, not 100), `interpolate(hz=20)` steps of 49.999872 ms: 9 ms in an hour, as times of today are numbers of
#   float64 that are 256 ns apart. Either drops the states of all traffic lights, and the frame
# - boxes of highD are half of their length and width too far up and left: a car 5 m behind a truck of 15 m touches it
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check omega-prime==0.3.7 betterosi==0.8.5 betterproto2==0.10.0 lxd_io==0.4.10 polars==1.44.2 numpy==2.4.6 2>/dev/null
cat > traffic.py <<'PYTHON'
from math import pi
from pathlib import Path

import numpy as np
import polars as pl
from omega_prime import Recording
from omega_prime.converters import LxdConverter
from omega_prime.map import ProjectionOffset
from omega_prime.schemas import polars_schema

START_NS, UTM = 1_700_000_000 * 10**9, "+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs"
NOT_MOVING = dict.fromkeys(("z", "vel_x", "vel_y", "vel_z", "acc_x", "acc_y", "acc_z", "roll", "pitch", "yaw"), 0.0)


def traffic(**more):
    """Return a second of a car to the east and a pedestrian to the south, at 10 Hz."""
    car = NOT_MOVING | {"idx": 0, "vel_x": 10.0, "length": 4.5, "width": 2.0, "height": 1.5, "type": 2, "role": 2, "subtype": 4}
    walker = NOT_MOVING | {"idx": 1, "vel_y": -1.0, "yaw": -pi / 2, "length": 0.5, "width": 0.6, "height": 1.8, "type": 3, "role": -1, "subtype": -1}
    rows = []
    for tenth in range(11):
        time = {"total_nanos": START_NS + tenth * 10**8}
        rows += [car | time | {"x": float(tenth), "y": 0.0}, walker | time | {"x": 20.0, "y": 5 - tenth / 10}]
    return Recording(pl.DataFrame(rows, schema_overrides=polars_schema), validate=True, **more)


for name, heights in (("kept.parquet", [1.5, 1.8]), ("kept.mcap", [2.0, 0.6])):
    traffic().to_file(name)
    found = Recording.from_file(name).df.sort("total_nanos", "idx").head(2)
    print(name, found.select("idx", "length", "width", "height").to_dicts())
    assert found["width"].to_list() == [2.0, 0.6] and found["height"].to_list() == heights

Path("map.xodr").write_text(f"""<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="6">
<geoReference><![CDATA[{UTM}]]></geoReference><offset x="690000" y="5330000" z="0" hdg="0"/></header>
<road name="road" length="100" id="1" junction="-1"><link/><planView><geometry s="0" x="0" y="0" hdg="0" length="100"><line/></geometry></planView>
<lanes><laneSection s="0"><center><lane id="0" type="none"><link/></lane></center><right><lane id="-1" type="driving"><link/>
<width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></right></laneSection></lanes></road></OpenDRIVE>""")
traffic(projections={"proj_string": UTM, None: ProjectionOffset(x=690050.0, y=5330020.0, yaw=pi / 2)}).to_file("turned.mcap")
car = Recording.from_file("turned.mcap", map_path="map.xodr").df.filter(idx=0).sort("total_nanos")
place_m, box_m = car.select("x", "y").to_numpy(), np.ptp(np.array(car["polygon"][0].exterior.coords), axis=0)
print("turned:", place_m[[0, -1]].round(3).tolist(), car.select("yaw", "vel_x", "vel_y").row(0), "box", box_m)
assert np.allclose(place_m[[0, -1]], [[50, 20], [50, 30]], atol=1e-3)
assert car.select("yaw", "vel_x", "vel_y").row(0) == (0, 10, 0) and np.allclose(box_m, [4.5, 2])

for hertz, number, step_ns in ((None, 10, 111_111_111), (20, 21, 49_999_872)):
    recording = traffic(traffic_light_states={START_NS: ["red"]}, projections={"proj_string": UTM})
    recording.interpolate(hz=hertz)
    instants = np.unique(recording.df["total_nanos"].to_numpy())
    print(f"interpolated to {hertz} Hz: {len(instants)} instants, {set(np.diff(instants).tolist())} ns apart", recording.traffic_light_states, recording.projections)
    assert len(instants) == number and np.allclose(np.diff(instants), step_ns, atol=257 if hertz is None else 0)
    assert recording.traffic_light_states == recording.projections == {}

data = Path("highD-dataset-v1.0/data")
data.mkdir(parents=True)
(data / "01_recordingMeta.csv").write_text("id,frameRate,locationId,duration\n1,25,1,0.08\n")
(data / "01_tracksMeta.csv").write_text("id,width,height,initialFrame,finalFrame,numFrames,class,drivingDirection\n1,5,2,1,2,2,Car,2\n2,15,2.5,1,2,2,Truck,2\n")
columns = "frame,id,x,y,width,height,xVelocity,yVelocity,xAcceleration,yAcceleration\n"
(data / "01_tracks.csv").write_text(columns + "".join(f"{at},1,{at - 1}.0,20.0,5,2,25,0,0,0\n{at},2,{at + 9}.0,20.0,15,2.5,25,0,0,0\n" for at in (1, 2)))
(data / "01_highway.png").write_bytes(b"")
converter = LxdConverter(str(data.parent), "out")
(one,) = (converter.to_omega_prime_recording(one) for one in converter.get_source_recordings())
boxes = {row["idx"]: row["polygon"].bounds for row in one.df.filter(frame=0).to_dicts()}
print("highD has 0 to 5 and 10 to 25 m, 20 to 22 and 20 to 22.5 m; made of it:", boxes)
assert boxes == {1: (-2.5, 19, 2.5, 21), 2: (2.5, 18.75, 17.5, 21.25)}
PYTHON
venv/bin/python -W ignore traffic.py 2> said.txt || { tail -5 said.txt; exit 1; }
