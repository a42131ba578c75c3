#!/usr/bin/env bash
# A road in OpenDRIVE leads 500 m north and then, in a bend, 300 m on. It rises by 1 % from 500 m above the sea; in town, for 500 m, 50 km/h are allowed, then
# 100. Its coordinates are of a transverse Mercator around its begin, at 48.1 degrees north, 11.5 east, as converters of maps and simulators choose it. It
# becomes a map of Apollo with imap_box_up, with heights (`-z 1`). Guess: the same road on the Earth, by the projection that the map names; heights as they
# are; 13.9 and 27.8 m/s. Seen with imap-box-up 0.0.6 on 2026-11-30, without a word:
# - Apollo's map is in UTM, and the begin is put there; but all else is only added, while north of UTM is 1.9 degrees off the road's: after 500 m it is 16 m
#   to the east
# - the straight road is at height 0; the bend begins at 500 m, not at 505, as its own length is taken for that from the begin of the road. So lanes of 500
#   and 300 m have lengths of 708 and 802 m, with the step between
# - 50 km/h throughout: only the first <type> of a road counts
# - where lanes are divided, at 500 m, both have a point more: each is a metre longer than it is
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check imap-box-up==0.0.6 protobuf==3.19.4 record-msg==0.1.1 concave-hull==0.0.7 scipy==1.13.0 pyproj==3.7.2 numpy==2.2.6 matplotlib==3.11.2
cat > write.py <<'PYTHON'
LANE = '<lane id="-1" type="driving" level="false"><link>{link}</link><width sOffset="0" a="3.5" b="0" c="0" d="0"/><roadMark sOffset="0" type="broken" color="white"/></lane>'
CENTRE = '<center><lane id="0" type="none" level="false"><roadMark sOffset="0" type="solid" color="white"/></lane></center>'
sections = "".join(
    f'<laneSection s="{begin}">{CENTRE}<right>{LANE.format(link=link)}</right></laneSection>'
    for begin, link in ((0, '<successor id="-1"/>'), (500, '<predecessor id="-1"/>'))
)
with open("road.xodr", "w") as file:
    file.write(f"""<?xml version="1.0"?>
<OpenDRIVE>
<header revMajor="1" revMinor="6" name="" version="1" date="2026-01-15" north="800" south="0" east="0" west="-200">
<geoReference><![CDATA[+proj=tmerc +lat_0=48.1 +lon_0=11.5 +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs]]></geoReference>
</header>
<road name="" length="800" id="1" junction="-1">
<type s="0" type="town"><speed max="50" unit="km/h"/></type><type s="500" type="rural"><speed max="100" unit="km/h"/></type>
<planView>
<geometry s="0" x="0" y="0" hdg="1.5707963267948966" length="500"><line/></geometry>
<geometry s="500" x="0" y="500" hdg="1.5707963267948966" length="300"><arc curvature="0.002"/></geometry>
</planView>
<elevationProfile><elevation s="0" a="500" b="0.01" c="0" d="0"/></elevationProfile><lateralProfile/>
<lanes>{sections}</lanes>
</road>
</OpenDRIVE>
""")
PYTHON
venv/bin/python write.py
MPLBACKEND=agg venv/bin/imap_box_up -f -z 1 -i road.xodr -o road.txt > said.txt 2>&1
if grep -iE 'warn|error|elev|conver|proj' said.txt; then exit 1; fi
cat > read.py <<'PYTHON'
import numpy as np
import pyproj
from modules.map.proto import map_pb2

apollo = map_pb2.Map()
with open("road.bin", "rb") as file:
    apollo.ParseFromString(file.read())
utm = pyproj.Proj(apollo.header.projection.proj)
road = pyproj.Proj("+proj=tmerc +lat_0=48.1 +lon_0=11.5 +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m")
town, rural = apollo.lane
edges = []
for lane in (town, rural):
    points = lane.left_boundary.curve.segment[0].line_segment.point
    east, north = road(*utm([point.x for point in points], [point.y for point in points], inverse=True))
    edges.append(np.column_stack([east, north, [point.z for point in points]]))
    print(f"{lane.id.id}: from {edges[-1][0].round(2).tolist()} to {edges[-1][-1].round(2).tolist()}, {lane.left_boundary.length:.1f} m long, {lane.speed_limit:.1f} m/s")
at_500_m = edges[0][np.argmin(np.abs(edges[0][:, 1] - 500))]
assert np.allclose(edges[0][0], 0, atol=0.01)
assert np.isclose(at_500_m[0], 16.2, atol=0.1)
assert (edges[0][:500, 2] == 0).all()
in_bend = edges[1][edges[1][:, 2] > 0]
assert np.isclose(in_bend[0, 2], 500)
assert np.isclose(in_bend[-1, 2], 503)
assert [round(lane.speed_limit, 1) for lane in (town, rural)] == [13.9, 13.9]
along_m = [np.linalg.norm(np.diff(edge[:, :2], axis=0), axis=1).sum() for edge in edges]
print([round(float(each), 2) for each in along_m])
assert np.allclose(along_m, [501, 301], atol=0.1)
assert np.allclose([lane.left_boundary.length for lane in (town, rural)], [707.8, 802.1], atol=0.1)
PYTHON
venv/bin/python read.py
