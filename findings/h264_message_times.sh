#!/usr/bin/env bash
# A recording holds H.264 frame by frame, one a message with its time (foxglove.CompressedVideo). Which message is a decoded frame of?
# Guess: with PyAV's `parse()`, as in its example for raw streams, the picture comes out with the message that was put in.
# Seen with PyAV 18.1.0 on 2026-11-28: one message later, since the parser knows the end of a frame only when the next begins: whoever
# takes the time of the message that he put in is late by one frame, 33 ms here, and loses the last if he does not flush.
# With `av.Packet(data)` instead of `parse(data)`, each comes out with its own, and keeps the pts that it was given.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check av==18.1.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import io

import av
import numpy as np

FRAMES = 12


def messages():
    """Return frames without B slices, of a grey that rises by 10 from one to the next."""
    with av.open(io.BytesIO(), "w", format="h264") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.options = {"tune": "zerolatency", "crf": "10"}
        packets = []
        for number in range(FRAMES):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 10 * number, np.uint8), format="rgb24")
            frame.pts = number
            packets += stream.encode(frame)
        return [bytes(packet) for packet in (*packets, *stream.encode(None))]


def number_of(frame):
    return round(float(frame.to_ndarray(format="gray").mean()) / 10)


def parsed(decoder, number, data):
    return decoder.parse(data)


def packed(decoder, number, data):
    packet = av.Packet(data)
    packet.pts = number
    return [packet]


for make in (parsed, packed):
    decoder = av.CodecContext.create("h264", "r")
    came = [
        (number, number_of(frame))
        for number, data in enumerate(messages())
        for packet in make(decoder, number, data)
        for frame in decoder.decode(packet)
    ]
    print(f"{make.__name__}: (message, picture in it)", came)
    if make is parsed:
        assert came == [(number + 1, number) for number in range(FRAMES - 1)]
    else:
        assert came == [(number, number) for number in range(FRAMES)]
PYTHON
