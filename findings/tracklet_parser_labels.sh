#!/usr/bin/env bash
# A parked car, 20 m ahead of the lidar of a KITTI drive and 3 m to the left, facing left, is labelled in CVAT as a track of 20 frames, and exported as "Kitti Raw
# Format 1.0". tracklet-parser makes "KITTI format label files" of it. Guess: 20 files, each with the car in the frame of the camera, as in KITTI's labels.
# Seen with tracklet-parser 1.1.0 on 2026-11-30, without a word:
# - one file. Of a track, only the first pose is read; in 19 frames the car has no label, and is trained as background
# - numbers of the lidar's frame in the fields of the camera's: read as KITTI's, the car is 20 m to the RIGHT and a metre behind the camera, 3 m below it, and
#   faces the wrong way; its box in the image is 0, 0, 0, 0
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.12 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps tracklet-parser==1.1.0 pandas==3.1.1 numpy==2.4.6 python-dateutil==2.9.0.post0 six==1.17.0 2>/dev/null
cd "$folder"
venv/bin/python - <<'PYTHON'
from pathlib import Path

import numpy as np
from tracklet_parser.tracklet_parser import TrackletParser

FRAMES, PLACE, HEADING = 20, (20.0, 3.0, -0.9), np.pi / 2  # in the frame of the lidar: ahead, left, up
pose = "<item><tx>{}</tx><ty>{}</ty><tz>{}</tz><rx>0</rx><ry>0</ry><rz>{}</rz><state>2</state><occlusion>0</occlusion><occlusion_kf>0</occlusion_kf>"
pose = pose.format(*PLACE, HEADING) + "<truncation>0</truncation><amt_occlusion>-1</amt_occlusion></item>"
track = f"<item><objectType>Car</objectType><h>1.5</h><w>1.8</w><l>4.2</l><first_frame>0</first_frame><poses><count>{FRAMES}</count>{pose * FRAMES}</poses></item>"
Path("tracklet_labels.xml").write_text(f"<boost_serialization><tracklets><count>1</count>{track}</tracklets></boost_serialization>")
Path("frame_list.txt").write_text("".join(f"{number} {number:010d}\n" for number in range(FRAMES)))

tracklets = TrackletParser.parse_tracklet_xml("tracklet_labels.xml")
TrackletParser.convert_tracklets_to_kitti(tracklets, "frame_list.txt", "labels")
files = sorted(Path("labels").iterdir())
print(f"{FRAMES} frames of a track: {len(files)} file(s), {files[0].read_text().strip()}")
assert len(files) == 1

fields = files[0].read_text().split()
right, down, ahead = map(float, fields[11:14])
rotation_y = float(fields[14])
forward = np.cos(rotation_y), -np.sin(rotation_y)  # to the right, and ahead, as KITTI defines it
print(f"read as KITTI's: {right} m to the right, {down} m down, {ahead} m ahead; faces {forward[0]:.0f} to the right and {forward[1]:.0f} ahead")
assert (right, down, ahead) == PLACE and np.allclose(forward, (0, -1)) and fields[4:8] == ["0.0"] * 4
PYTHON
