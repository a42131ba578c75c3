#!/usr/bin/env bash
# Depth images of 16 bits, in millimetres, are packed for WebDataset as PNG, and read with `decode("pil")`, "rgb", "rgb8", "l" or "l8".
# Guess: "pil" has the 16 bits, and the others scale them or refuse. Seen with webdataset 1.0.2 and pillow 13.0.0 on 2026-11-28: the shard
# has them, whether an array or the bytes of a PNG were given, and each of these decoders makes 8 bits of it by cutting off at 255: all that
# is farther away than 255 mm is 255 (1.0 as a float), without a word. "pil" gives an RGB image, too. What was not decoded is intact:
# `Image.open(io.BytesIO(sample["depth.png"]))`.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check webdataset==1.0.2 pillow==13.0.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import io

import numpy as np
import webdataset
from PIL import Image

DEPTH_MM = np.array([[100, 300], [2000, 65000]], dtype=np.uint16)
png = io.BytesIO()
Image.fromarray(DEPTH_MM).save(png, "PNG")
with webdataset.TarWriter("depth.tar") as writer:
    writer.write({"__key__": "array", "depth.png": DEPTH_MM})
    writer.write({"__key__": "bytes", "depth.png": png.getvalue()})


def images(decoder=None):
    dataset = webdataset.WebDataset("depth.tar", shardshuffle=False)
    return [sample["depth.png"] for sample in (dataset.decode(decoder) if decoder else dataset)]


for stored in images():
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(stored))), DEPTH_MM)
for decoder in ("pil", "rgb8", "rgb", "l8", "l"):
    for image in images(decoder):
        grey = np.asarray(image)
        grey = grey[..., 0] if grey.ndim == 3 else grey
        levels = np.round(grey * (255 if grey.dtype == np.float32 else 1)).astype(int)
        print(f"{decoder}: {grey.dtype} {levels.tolist()}")
        assert np.array_equal(levels, np.minimum(DEPTH_MM, 255))
PYTHON
