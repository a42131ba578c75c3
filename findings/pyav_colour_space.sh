#!/usr/bin/env bash
# Does setting the colour space of PyAV's encoder make it convert RGB frames to that colour space?
# Guess: yes. Seen with PyAV 18.1.0 on 2026-11-28: no, it only writes the tag BT.709. Frames are converted by BT.601, as without it,
# and a reader that believes the tag shows other colours: (200, 30, 40) comes back as (213, 45, 36). Only `reformat` with
# `dst_colorspace` converts, and without the tag in the encoder that is as wrong: (184, 10, 39).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check av==18.1.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import io

import av
import numpy as np

SENT = (200, 30, 40)


def received(tag, convert):
    """Return the colour that comes back from a video of one colour, written almost without loss."""
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt, stream.options = 64, 48, "yuv420p", {"crf": "1"}
        if tag:
            context = stream.codec_context
            context.colorspace = context.color_primaries = context.color_trc = 1  # BT.709
        frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), SENT, np.uint8), format="rgb24")
        if convert:
            frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709")
        frame.pts = 0
        container.mux([*stream.encode(frame), *stream.encode(None)])
    file.seek(0)
    with av.open(file) as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24")[24, 32].astype(int)


for tag, convert, right in ((False, False, True), (True, False, False), (False, True, False), (True, True, True)):
    colour = received(tag, convert)
    error = int(np.abs(colour - SENT).max())
    print(f"tagged {tag!s:5} converted {convert!s:5} {colour.tolist()}, off by {error}")
    assert error <= 3 if right else error >= 10
PYTHON
