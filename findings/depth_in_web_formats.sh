#!/usr/bin/env bash
# Depth images, 16 bits, in millimetres, are to be smaller than as PNG. They are saved without loss in newer formats with Pillow, as `Image.fromarray(depth).save(...)`, and with OpenCV.
# Guess: those with 8 bits (WebP, BMP) refuse; AVIF has 12 bits and refuses or scales; HEIF, JPEG 2000 and JPEG XL keep 16 bits.
# Seen with pillow 13.0.0, pillow-heif 1.8.1, pillow-jxl-plugin 1.3.8 and opencv-python-headless 5.0.0.93 on 2026-11-30, without a word:
# - WebP (`lossless=True`) and AVIF of Pillow, WebP, BMP and JPEG of OpenCV: all that is farther than 255 mm is 255
# - HEIF of the plug-in, at its quality "lossless" (-1): it reads as 16 bits again, in steps of 64 mm: 200 is 192, 63000 is 62976
# - kept: PNG, TIFF, JPEG 2000, JPEG XL (`lossless=True`), and PPM, which Pillow reads as 32 bits
# BMP and JPEG of Pillow refuse.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pillow==13.0.0 pillow-heif==1.8.1 pillow-jxl-plugin==1.3.8 opencv-python-headless==5.0.0.93 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import io

import cv2
import numpy as np
import pillow_heif
import pillow_jxl  # noqa: F401
from PIL import Image

pillow_heif.register_heif_opener()
depth_mm = np.tile(np.arange(0, 64000, 1000, dtype=np.uint16), (64, 1))
depth_mm[0] = 200
SHOWN = (0, 5, 5), (0, 1, 63)


def by_pillow(name, **options):
    """Return what Pillow reads of the depth that it saved."""
    file = io.BytesIO()
    Image.fromarray(depth_mm).save(file, name, **options)
    read = np.array(Image.open(file))
    print(f"Pillow, {name}: {read.dtype} {read.shape}, 200, 1000 and 63000 are {read.reshape(64, 64, -1)[*SHOWN, 0].tolist()}")
    return read.reshape(64, 64, -1)[..., 0].astype(int)


def by_opencv(suffix):
    """Return what OpenCV reads of the depth that it encoded, without conversion."""
    _, encoded = cv2.imencode(suffix, depth_mm)
    read = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED)
    print(f"OpenCV, {suffix}: {read.dtype} {read.shape}, 200, 1000 and 63000 are {read.reshape(64, 64, -1)[*SHOWN, 0].tolist()}")
    return read.reshape(64, 64, -1)[..., 0].astype(int)


cut = np.minimum(depth_mm, 255)
for name, options in (("png", {}), ("tiff", {}), ("jpeg2000", {}), ("jxl", {"lossless": True}), ("ppm", {})):
    assert np.array_equal(by_pillow(name, **options), depth_mm)
assert np.array_equal(by_pillow("webp", lossless=True), cut)
assert np.abs(by_pillow("avif", quality=100) - cut).max() <= 3
steps = by_pillow("heif", quality=-1)
assert np.array_equal(steps, depth_mm // 64 * 64)
for suffix in (".png", ".jp2", ".tiff"):
    assert np.array_equal(by_opencv(suffix), depth_mm)
for suffix in (".webp", ".bmp", ".jpg"):
    assert np.abs(by_opencv(suffix) - cut).max() <= 5
for name in ("bmp", "jpeg"):
    try:
        Image.fromarray(depth_mm).save(io.BytesIO(), name)
    except OSError as error:
        print(f"Pillow, {name}: {error}")
    else:
        raise AssertionError(name)
PYTHON
