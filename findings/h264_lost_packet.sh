#!/usr/bin/env bash
# One packet of a recorded H.264 stream is lost: does the decoder say so?
# Guess: a decoder that lacks the picture which the next ones refer to raises an error, or marks what it makes up.
# Seen on 2026-11-28: the FFmpeg of av 18.1.0 (libavcodec 62.28) hands out a picture for each packet that is left, none of them corrupt, with
# `err_detect=explode`, too. The one after the loss shows the picture before it: number 13 for 15. Those of H.265 are refused.
# The loss shows in the frame numbers of the slices, which go up by one from reference to reference.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check av==18.1.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
from fractions import Fraction

import av
import numpy as np

BITS, BLOCK = 5, 16
LOST = 14


def painted(number):
    picture = np.full((64, BITS * BLOCK, 3), 96, np.uint8)
    for bit in range(BITS):
        picture[16:48, bit * BLOCK : (bit + 1) * BLOCK] = 235 if number >> bit & 1 else 16
    return picture


def shown(frame):
    picture = frame.to_ndarray(format="rgb24")
    means = [picture[20:44, bit * BLOCK + 4 : (bit + 1) * BLOCK - 4].mean() for bit in range(BITS)]
    return sum((mean > 125) << bit for bit, mean in enumerate(means))


encoder = av.CodecContext.create("libx264", "w")
encoder.width, encoder.height, encoder.pix_fmt = BITS * BLOCK, 64, "yuv420p"
encoder.time_base, encoder.framerate, encoder.gop_size = Fraction(1, 20), Fraction(20), 10
encoder.options = {"preset": "ultrafast", "tune": "zerolatency"}
packets = []
for number in range(20):
    frame = av.VideoFrame.from_ndarray(painted(number), format="rgb24").reformat(format="yuv420p")
    frame.pts = number
    packets += [bytes(packet) for packet in encoder.encode(frame)]
packets += [bytes(packet) for packet in encoder.encode(None)]
assert len(packets) == 20

decoder = av.CodecContext.create("h264", "r")
decoder.thread_count, decoder.options = 1, {"err_detect": "explode"}
found = {}
for number, data in enumerate(packets):
    if number != LOST:
        packet = av.Packet(data)
        packet.pts = number
        found |= {frame.pts: (int(shown(frame)), frame.is_corrupt) for frame in decoder.decode(packet)}
found |= {frame.pts: (int(shown(frame)), frame.is_corrupt) for frame in decoder.decode(None)}
print({number: one for number, one in found.items() if number > 12})
assert len(found) == 19
assert not any(corrupt for _, corrupt in found.values())
assert found[15][0] == 13
PYTHON
