#!/usr/bin/env bash
# A camera of 30 frames a second is recorded with Lab Streaming Layer (XDF), as in experiments with people and robots. Its clock is that of the recorder, and each
# frame has its stamp. After 5 s, 24 frames are lost, 0.8 s. When were the others taken, by pyxdf? Guess: at their stamps.
# Seen with pyxdf 1.17.5 on 2026-11-29, as it is set up (`dejitter_timestamps=True`), without a word: up to 0.22 s before and 0.58 s after them. What has a nominal
# rate gets stamps that lie evenly between its first and its last, 33.8 ms apart in place of 33.3, and the gap is gone. A gap counts as one if it is longer than a
# second AND than 500 samples, which for a camera is 16.7 s: those of 16 s go, too, and frames are then up to 10.4 s off. Where every tenth frame is lost by chance, they
# are up to 0.20 s off. A stream without a nominal rate (0), such as markers of events, stays as it is, so that the two no longer fit together. With
# `dejitter_timestamps=False` all is right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pyxdf==1.17.5 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import struct
from pathlib import Path

import numpy as np
import pyxdf

RATE_HZ = 30
START_S = 100.0


def chunk(tag, body):
    """Return a chunk of XDF."""
    return b"\x04" + struct.pack("<IH", len(body) + 2, tag) + body


def write(numbers, nominal_hz=RATE_HZ):
    """Write a recording with the frames of these numbers, whose value is their number."""
    header = (
        f"<info><name>camera</name><type>video</type><channel_count>1</channel_count><nominal_srate>{nominal_hz}</nominal_srate>"
        "<channel_format>double64</channel_format><created_at>0</created_at></info>"
    )
    samples = b"".join(struct.pack("<Bdd", 8, START_S + number / RATE_HZ, number) for number in numbers)
    clock = b"".join(chunk(4, struct.pack("<Idd", 1, START_S + second, 0.0)) for second in range(0, 21, 5))
    chunks = [
        chunk(1, b"<info><version>1.0</version></info>"),
        chunk(2, struct.pack("<I", 1) + header.encode()),
        chunk(3, struct.pack("<IBI", 1, 4, len(numbers)) + samples),
        clock,
        chunk(6, struct.pack("<I", 1) + f"<info><sample_count>{len(numbers)}</sample_count></info>".encode()),
    ]
    Path("drive.xdf").write_bytes(b"XDF:" + b"".join(chunks))


def off_s(**options):
    """Return how much later than its stamp each frame is."""
    (stream,), _ = pyxdf.load_xdf("drive.xdf", **options)
    return stream["time_stamps"] - (START_S + stream["time_series"][:, 0] / RATE_HZ)


for lost, first_s, last_s in ((24, -0.22, 0.58), (480, -5.55, 10.44), (510, 0, 0)):
    write(np.r_[0:150, 150 + lost : 1800])
    print(f"{lost} in a row are lost: {off_s().min():.2f} to {off_s().max():.2f} s off")
    assert np.allclose(off_s(dejitter_timestamps=False), 0)
    assert np.allclose([off_s().min(), off_s().max()], [first_s, last_s], atol=0.01)
write(np.r_[0:150, 174:1800], nominal_hz=0)
assert np.allclose(off_s(), 0)
write(np.sort(np.random.default_rng(0).choice(600, 540, replace=False)))
print(f"60 of 600 are lost here and there: {off_s().min():.2f} to {off_s().max():.2f} s off")
assert np.allclose([off_s().min(), off_s().max()], [-0.20, 0.15], atol=0.005)
PYTHON
