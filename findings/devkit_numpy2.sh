#!/usr/bin/env bash
# Which nuscenes-devkit does pip take beside numpy 2?
# Guess: the newest, or an error that names the conflict. Seen with pip 25.3 on 2026-11-28: 1.2.0 requires numpy < 2, so pip goes
# back without a word to what allows any numpy: 1.1.9 of wheels alone, 1.1.11 where it may build old matplotlib and Shapely from
# source. Neither has custom splits: their DetectionEval knows the scenes of nuScenes alone, and no dataset of one's own.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pip==25.3
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --dry-run --only-binary :all: --ignore-installed \
  --report "$folder/report.json" nuscenes-devkit numpy==2.3.5
"$folder/venv/bin/python" - "$folder/report.json" <<'PYTHON'
import json
import sys

taken = {one["metadata"]["name"]: one["metadata"]["version"] for one in json.load(open(sys.argv[1]))["install"]}
print("nuscenes-devkit", taken["nuscenes-devkit"], "beside numpy", taken["numpy"])
assert taken["nuscenes-devkit"] == "1.1.9"
PYTHON
for version in 1.1.9 1.1.11 1.2.0; do
  "$folder/venv/bin/pip" download --quiet --disable-pip-version-check --no-deps --dest "$folder" "nuscenes-devkit==$version"
done
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys
from pathlib import Path
from zipfile import ZipFile

for wheel in sorted(Path(sys.argv[1]).glob("*.whl")):
    text = ZipFile(wheel).read("nuscenes/utils/splits.py").decode()
    print(wheel.name, "knows custom splits" if "get_scenes_of_custom_split" in text else "knows no custom splits")
    assert ("get_scenes_of_custom_split" in text) == ("1.2.0" in wheel.name)
PYTHON
