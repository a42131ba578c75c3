#!/usr/bin/env bash
# A table (CSV) of a vehicle that drives 1 km due north in Munich has a stamp in integer nanoseconds, latitude and longitude in each row. It becomes an MCAP with tabular2mcap: position by the
# function that it offers for its templates, `latlon_to_utm`, and time by the template that it proposes, `{{ stamp | int }}`. Guess: UTM to a centimetre, going 1 km north; and stamps to the nanosecond.
# Seen with tabular2mcap 0.1.12 on 2026-11-30, without a word:
# - no UTM: degrees times 111,320 m, those of longitude times the cosine of each row's own latitude. The place is 169 km to the east and 24 km to the north of its UTM coordinates, and
#   what drives 1 km north drives 150 m to the west on its way (33 m in UTM, whose grid is turned there), the more so the farther from Greenwich and the equator
# - stamps are multiples of 256 ns, as a row that has a column of floats makes a float of each of its integers: two lines in 300 ns have one time, or 512 ns between them
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check "tabular2mcap[protobuf]==0.1.12" mcap==1.6.0 mcap-ros2-support==0.6.0 pandas==3.1.1 numpy==2.4.6 utm==0.9.0
mkdir "$folder/tables"
cd "$folder"
cat >config.yaml <<'YAML'
writer_format: json
tabular_mappings:
  - file_pattern: "drive.csv"
    converter_functions:
      - {function_name: place, schema_name: foxglove.Point3, topic_suffix: place}
YAML
cat >functions.yaml <<'YAML'
functions:
  place:
    schema_name: foxglove.Point3
    log_time_template: "{{ stamp | int }}"
    template: "{{ latlon_to_utm(latitude, longitude) }}"
YAML
venv/bin/python - <<'PYTHON'
START_NS, LATITUDES = 1_700_000_000_000_000_100, [48.1, 48.1 + 1000 / 111_200]
STAMPS_NS = [START_NS, START_NS + 300]
with open("tables/drive.csv", "w") as file:
    file.write("stamp,latitude,longitude\n")
    file.writelines(f"{stamp},{latitude:.9f},11.5\n" for stamp, latitude in zip(STAMPS_NS, LATITUDES, strict=True))
PYTHON
venv/bin/tabular2mcap -i tables -o drive.mcap -c config.yaml -f functions.yaml >output.txt 2>&1 || { tail -5 output.txt; exit 1; }
venv/bin/python - <<'PYTHON'
import csv
import json

import numpy as np
import utm
from mcap.reader import make_reader

with open("tables/drive.csv") as file:
    rows = [(int(row["stamp"]), float(row["latitude"]), float(row["longitude"])) for row in csv.DictReader(file)]
with open("drive.mcap", "rb") as file:
    messages = [(message.log_time, json.loads(message.data)) for _, _, message in make_reader(file).iter_messages()]
found = np.array([[place["x"], place["y"]] for _, place in messages])
right = np.array([utm.from_latlon(latitude, longitude)[:2] for _, latitude, longitude in rows])
off_km = (found - right)[0] / 1000
course = np.degrees(np.arctan2(*(found[1] - found[0])))
print("off by", off_km.round(1), "km, east and north; the way:", (found[1] - found[0]).round(1), f"m, course {course:.1f} degrees")
print("the way in UTM:", (right[1] - right[0]).round(1), "m")
assert (off_km.round() == [169, 24]).all() and round(float(course), 1) == -8.5 and round(float(found[1, 0] - found[0, 0])) == -150
times = [time for time, _ in messages]
print("stamps:", [stamp for stamp, _, _ in rows], "log times:", times)
assert all(time % 256 == 0 for time in times) and times[1] - times[0] != 300
PYTHON
