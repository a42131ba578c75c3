#!/usr/bin/env bash
# A label image, 0 for the background and 1, 2, 3 for objects, is given to pycocotools as a mask. What is encoded?
# Guess: all that is not 0, as with a mask of 0 and 255; or an error. Seen with pycocotools 2.0.11 on 2026-11-28: neither. A run ends
# wherever the VALUE changes, and runs are background and object by turns: of columns 0, 1, 2, 0 the first object's is masked, the
# second's is not, and the last, which is background, is. Rows 0, 1, 2, 3 become rows 1 and 3. 0 and 255 are right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pycocotools==2.0.11 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from pycocotools import mask


def columns(values):
    image = np.asfortranarray(np.tile(np.array(values, np.uint8), (4, 1)))
    return mask.decode(mask.encode(image))[0].tolist()


rows = np.asfortranarray(np.repeat(np.arange(4, dtype=np.uint8)[:, None], 4, axis=1))
seen = columns([0, 255, 255, 0]), columns([0, 1, 2, 0]), mask.decode(mask.encode(rows))[:, 0].tolist()
print("0 255 255 0:", seen[0], " 0 1 2 0:", seen[1], " rows 0 1 2 3:", seen[2])
raise SystemExit(0 if seen == ([0, 1, 1, 0], [0, 1, 0, 1], [0, 1, 0, 1]) else "no longer so")
PYTHON
