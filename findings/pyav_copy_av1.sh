#!/usr/bin/env bash
# Packets of an AV1 file are copied to another file, without decoding: does the template of a stream need a decoder?
# Guess: no, a stream is described by its parameters alone, as with H.264.
# Seen on 2026-11-28 with av 18.1.0: `add_stream_from_template` looks for an *encoder* of the decoder's name. H.264 is called `h264` by
# both; AV1 is decoded by `libdav1d`, which encodes nothing: UnknownCodecError. With `opaque=True` the packets are copied, and all
# pictures are there.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check av==18.1.0 numpy==2.4.6
cd "$folder"
cat >check.py <<'PYTHON'
import av
import numpy as np

NUMBER = 5


def write(encoder):
    with av.open(f"{encoder}.mp4", "w") as file:
        stream = file.add_stream(encoder, rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        for number in range(NUMBER):
            image = np.full((64, 64, 3), 40 * number, np.uint8)
            file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        file.mux(stream.encode())


def copied(encoder, **how):
    """Return how many pictures a copy of the packets has, or the error."""
    with av.open(f"{encoder}.mp4") as source, av.open("copy.mp4", "w") as copy:
        try:
            stream = copy.add_stream_from_template(source.streams.video[0], **how)
        except ValueError as err:
            return type(err).__name__
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                copy.mux(packet)
    with av.open("copy.mp4") as copy:
        return sum(1 for _ in copy.decode(video=0))


for encoder in ("libx264", "libsvtav1"):
    write(encoder)
seen = {encoder: (copied(encoder), copied(encoder, opaque=True)) for encoder in ("libx264", "libsvtav1")}
print(av.__version__, seen)
assert seen == {"libx264": (NUMBER, NUMBER), "libsvtav1": ("UnknownCodecError", NUMBER)}
PYTHON
"$folder/venv/bin/python" check.py 2>errors || { cat errors; exit 1; }
