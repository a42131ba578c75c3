#!/usr/bin/env bash
# Cameras record JPEG (sensor_msgs/CompressedImage). A script opens each message with Pillow and packs it into MDS shards (the `streaming`
# of MosaicML), as a column of type `jpeg`. What is in the shard? Guess: the JPEG that was recorded.
# Seen with mosaicml-streaming 0.13.0 and pillow 13.0.0 on 2026-11-28: that only for a picture which was opened from a file of its own, and is
# still there. One that was opened from the bytes of a message is compressed again, with Pillow's quality of 75, without a word: half the
# bytes, and pixels that differ by up to 55 of 255 levels, here for a noisy picture of quality 95. A column of type `bytes` keeps it. litdata 0.2.76 did the same, by hand.
# torch and what else `streaming` imports is not needed for this: the module is taken from the wheel.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pillow==13.0.0 numpy==2.1.3 typing-extensions==4.15.0
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps mosaicml-streaming==0.13.0
cd "$folder"
venv/bin/python - <<'PYTHON'
import importlib.util
import io
import sysconfig
from pathlib import Path

import numpy as np
from PIL import Image

path = Path(sysconfig.get_path("purelib"), "streaming/base/format/mds/encodings.py")
spec = importlib.util.spec_from_file_location("encodings_of_mds", path)
mds = importlib.util.module_from_spec(spec)
spec.loader.exec_module(mds)

noise = np.random.default_rng(0).normal(128, 40, (48, 64, 3))
file = io.BytesIO()
Image.fromarray(np.clip(noise, 0, 255).astype(np.uint8)).save(file, "JPEG", quality=95)
recorded = file.getvalue()
Path("recorded.jpg").write_bytes(recorded)


def pixels(jpeg):
    return np.asarray(Image.open(io.BytesIO(jpeg))).astype(int)


of_file = mds.mds_encode("jpeg", Image.open("recorded.jpg"))
of_message = mds.mds_encode("jpeg", Image.open(io.BytesIO(recorded)))
worst = np.abs(pixels(of_message) - pixels(recorded)).max()
print(f"{len(recorded)} bytes recorded; {len(of_file)} of a file, {len(of_message)} of a message, off by up to {worst} levels")
assert of_file == recorded
assert len(of_message) < 0.6 * len(recorded)
assert worst > 30
assert mds.mds_encode("bytes", recorded) == recorded
PYTHON
