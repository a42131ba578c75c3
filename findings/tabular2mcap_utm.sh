#!/usr/bin/env bash
# A drive of 1 km due north, as a CSV (time in nanoseconds, latitude, longitude, speed), and the video of its camera, ten pictures a second, become an MCAP
# with tabular2mcap, whose templates offer `latlon_to_utm`. Guess: UTM, to the centimetre, or metres from the first fix; the times of the CSV; a video whose
# messages have the times of their pictures. Seen with tabular2mcap 0.1.12 (av 15.1.0) on 2026-11-30, without a word:
# - `latlon_to_utm` knows no zone: x is the longitude in metres of the row's OWN latitude, so that the drive north at 11.5 degrees east goes 149 m west, and
#   turns by 8.5 degrees. In UTM it goes 32 m west, as the grid has it there; the x is that of no zone (856608 m for 686483 m)
# - times lose their nanoseconds, up to 128, where all columns are numbers (a row is then float64); with one column of text they are exact
# - the video (H.264) has B frames, which foxglove.CompressedVideo rules out: messages are in the order of the decoder, and have the times of the pictures in
#   THEIR order. Whoever decodes message by message has the picture of 0 s at 0.2 s, and so on: two late throughout, and the last two never come
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export XDG_CACHE_HOME=$folder  # it keeps definitions of messages there, which it does not need here
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check 'tabular2mcap[protobuf]==0.1.12' av==15.1.0 pyproj==3.7.2 mcap==1.6.0 opencv-python==5.0.0.93 numpy==2.4.6 pandas==3.1.1
mkdir drive
cat > write.py <<'PYTHON'
import cv2
import numpy as np

for name, more in (("numbers", ""), ("text", ",dry")):
    rows = [f"{1_700_000_000_000_000_123 + tick * 100_000_000},{48 + tick * 0.0009:.7f},11.5,10.0{more}" for tick in range(11)]
    header = "stamp_ns,lat,lon,speed" + (",road" if more else "")
    with open(f"drive/{name}.csv", "w") as file:
        file.write("\n".join([header, *rows, ""]))
writer = cv2.VideoWriter("drive/camera.mp4", cv2.VideoWriter_fourcc(*"mp4v"), 10, (64, 64))
for number in range(30):
    writer.write(np.full((64, 64, 3), number * 8, np.uint8))
writer.release()
PYTHON
venv/bin/python write.py
cat > config.yaml <<'YAML'
writer_format: json
tabular_mappings:
  - {file_pattern: '**/*.csv', converter_functions: [{function_name: place, topic_suffix: place}]}
other_mappings:
  - {type: compressed_video, file_pattern: '**/camera.mp4', topic_suffix: video, frame_id: camera, format: h264}
YAML
cat > functions.yaml <<'YAML'
functions:
  place:
    log_time_template: "{{ stamp_ns | int }}"
    template: '{"position": {{ latlon_to_utm(lat, lon) }}}'
YAML
venv/bin/tabular2mcap -i drive -o drive.mcap -c config.yaml -f functions.yaml > said.txt 2>&1
if grep -iE 'b.frame|precision|zone|approx' said.txt; then exit 1; fi
cat > read.py <<'PYTHON'
import base64
import json

import av
import numpy as np
from mcap.reader import make_reader
from pyproj import Transformer

times_ns, places, pictures, decoder = {}, {}, [], av.CodecContext.create("h264", "r")
with open("drive.mcap", "rb") as stream:
    for _, channel, message in make_reader(stream).iter_messages():
        data = json.loads(message.data)
        if "position" in data:
            times_ns.setdefault(channel.topic, []).append(message.log_time)
            places.setdefault(channel.topic, []).append([data["position"]["x"], data["position"]["y"]])
        else:
            for frame in decoder.decode(av.Packet(base64.b64decode(data["data"]))):  # in the order of the camera, ever brighter
                pictures.append((message.log_time / 1e9, float(frame.to_ndarray(format="gray").mean())))
numbers, text = sorted(times_ns)
x_m, y_m = np.transpose(places[numbers])
utm = np.transpose(Transformer.from_crs(4326, 32632).transform([48.0, 48.009], [11.5, 11.5]))
print(f"from ({x_m[0]:.0f}, {y_m[0]:.0f}) by ({x_m[-1] - x_m[0]:.1f}, {y_m[-1] - y_m[0]:.1f}) m; UTM: from {utm[0].round().tolist()} by {np.diff(utm, axis=0)[0].round(1).tolist()}")
assert abs(x_m[-1] - x_m[0] + 149.4) < 0.1
assert abs(np.degrees(np.arctan2(x_m[-1] - x_m[0], y_m[-1] - y_m[0])) + 8.5) < 0.1
assert abs(x_m[0] - 856607.6) < 0.1
print({topic: [each % 1000 for each in stamps] for topic, stamps in times_ns.items()})
assert all(stamp % 1000 == 0 for stamp in times_ns[numbers])
assert all(stamp % 1000 == 123 for stamp in times_ns[text])
print(len(pictures), pictures[:3])
assert len(pictures) == 28
assert np.allclose([at_s for at_s, _ in pictures], np.arange(2, 30) / 10)
assert (np.diff([grey for _, grey in pictures]) > 0).all()
assert pictures[0][1] < 1
PYTHON
venv/bin/python read.py
