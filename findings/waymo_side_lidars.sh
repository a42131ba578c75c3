#!/usr/bin/env bash
# A wall 15 m beside one of Waymo's cars is seen by a side lidar: 200 rows from -90 to 30 degrees, which the Parquet files say by the two ends alone, not row by row as for
# the lidar on the roof. torch-waymo 0.2.0 makes points of the range image without TensorFlow. Guess: the same points as Waymo's own code has.
# Seen with it and waymo-open-dataset-tf-2-12-0 1.6.7 on 2026-11-30, without a word: the two ends are taken for the middles of the first and the last row, where
# Waymo's code takes them for the outer edges of these. Rows are up to 0.3 degrees off: the top of the wall is 7 cm too high and 5 cm too near, as a wall that leans. The
# lidar on the roof, whose rows are listed, is right
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check torch==2.13.0 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 tqdm==4.67.1 pyarrow==26.0.1 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps torch-waymo==0.2.0 waymo-open-dataset-tf-2-12-0==1.6.7 2>/dev/null
venv/bin/python - <<'PYTHON'
import contextlib
import importlib.util
import sys
from unittest.mock import MagicMock

import numpy as np
from torch_waymo.converters.geometry import beam_inclinations, range_image_to_point_cloud

ROWS, COLUMNS, WALL_M = 200, 600, 15.0
ENDS_RAD = np.radians([-90.0, 30.0])

# Waymo's code, with numpy for the few functions of TensorFlow that it calls
tensorflow = sys.modules["tensorflow"] = MagicMock(cast=np.asarray, range=np.arange, expand_dims=np.expand_dims)
tensorflow.compat.v1.name_scope = lambda *_: contextlib.nullcontext()
spec = importlib.util.find_spec("waymo_open_dataset")
path = f"{next(iter(spec.submodule_search_locations))}/utils/range_image_utils.py"
waymo = importlib.util.module_from_spec(importlib.util.spec_from_file_location("range_image_utils", path))
waymo.__spec__.loader.exec_module(waymo)
rows_rad = waymo.compute_inclination(ENDS_RAD, ROWS)[::-1]  # the topmost first

azimuths_rad = ((np.arange(COLUMNS, 0, -1) - 0.5) / COLUMNS * 2 - 1) * np.pi
forwards = np.cos(rows_rad)[:, None] * np.cos(azimuths_rad)
ranges_m = np.where(forwards > 0.1, WALL_M / np.maximum(forwards, 0.1), 0)
image = np.stack([ranges_m, *np.zeros((3, ROWS, COLUMNS))], axis=-1)
by_ends = range_image_to_point_cloud(image, np.eye(4), beam_inclinations(ROWS, [], *ENDS_RAD))
by_rows = range_image_to_point_cloud(image, np.eye(4), beam_inclinations(ROWS, rows_rad[::-1], *ENDS_RAD))
assert np.allclose(by_rows[:, 0], WALL_M)

off_deg = np.degrees(beam_inclinations(ROWS, [], *ENDS_RAD) - rows_rad)
ahead = np.abs(by_rows[:, 1]) < 0.2  # what is straight ahead of the lidar
top = np.argmax(np.where(ahead, by_rows[:, 2], -np.inf))
print(f"rows from {off_deg.min():.2f} to {off_deg.max():.2f} degrees off")
print(f"the wall's top at {by_rows[top, 2]:.2f} m is at {by_ends[top, 2]:.2f} m, and {by_ends[top, 0]:.2f} m away")
assert np.allclose([off_deg.min(), off_deg.max()], [-0.3, 0.3])
assert np.allclose(by_ends[top, [0, 2]] - by_rows[top, [0, 2]], [-0.045, 0.078], atol=0.01)
PYTHON
