#!/usr/bin/env bash
# A camera's H.264 is converted to YUV by BT.709, and says so in its tags, as HD cameras do it. Which colour does a frame have as RGB (`to_ndarray(format="rgb24")`), and in another
# program by FFmpeg? Guess: the one that was sent, since the frame knows its tag (`frame.colorspace`); `src_colorspace` is there for videos without tags.
# Seen with PyAV 15.1.0 (which lerobot pins), 16.1.0 and 17.0.0, and FFmpeg of imageio-ffmpeg 0.8.1 on 2026-11-30, of (200, 30, 40), without a word:
# - PyAV 15 and 16 have (184, 10, 39), though `frame.colorspace` says BT.709: the matrix is always that of BT.601. PyAV 17 and FFmpeg have (198, 28, 38)
# - `reformat(format="rgb24", src_colorspace="ITU709")` is not heeded there either, as it is what the tag says already; only together with
#   `dst_color_range="JPEG"` it is, which makes a video of full range wrong in another way, by 13
# - a video that was converted by BT.601, and says so or says nothing, is right in all of them
# So pictures of one data set change with the version of the reader: whoever writes videos for others does well to write BT.601.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat > colours.py <<'PYTHON'
import subprocess
import sys

import av
import imageio_ffmpeg
import numpy as np

SENT = (200, 30, 40)
LIMITED, FULL = (1, "MPEG"), (2, "JPEG")


def write(tag, matrix, color_range):
    """Write a video of one colour, almost without loss, with a tag of its colour space (None: no tag)."""
    number, name = color_range
    with av.open("colour.mp4", "w") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt, stream.options = 64, 48, "yuv420p", {"crf": "1"}
        context = stream.codec_context
        if tag is not None:
            context.colorspace = context.color_primaries = context.color_trc = tag
            context.color_range = number
        frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), SENT, np.uint8), format="rgb24")
        frame = frame.reformat(format="yuv420p", dst_colorspace=matrix, dst_color_range=name)
        frame.pts = 0
        container.mux([*stream.encode(frame), *stream.encode(None)])


def off(pixels):
    """Return the largest difference between the colour in the middle and the one that was sent."""
    return int(np.abs(pixels[24, 32].astype(int) - SENT).max())


version = int(av.__version__.split(".")[0])
for tag, matrix, color_range in ((1, "ITU709", LIMITED), (1, "ITU709", FULL), (5, "ITU601", LIMITED), (5, "ITU601", FULL), (None, "ITU601", LIMITED)):
    write(tag, matrix, color_range)
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", "colour.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    by_ffmpeg = np.frombuffer(subprocess.run(command, check=True, capture_output=True).stdout, np.uint8).reshape(48, 64, 3)
    with av.open("colour.mp4") as container:
        frame = next(container.decode(video=0))
    plain = frame.to_ndarray(format="rgb24")
    named = frame.reformat(format="rgb24", src_colorspace=matrix).to_ndarray()
    ranged = frame.reformat(format="rgb24", src_colorspace=matrix, dst_color_range="JPEG").to_ndarray()
    print(f"PyAV {av.__version__}, tag {tag}, range {color_range[1]}: {plain[24, 32].tolist()}, off by {off(plain)}, named {off(named)}, and range {off(ranged)}")
    assert off(by_ffmpeg) <= 3
    if tag == 1:
        assert int(frame.colorspace) == 1
    wrong = tag == 1 and version < 17
    assert (off(plain) >= 10, off(named) >= 10) == (wrong, wrong)
    assert (off(ranged) >= 10) == (color_range == FULL and version < 17)
PYTHON
for version in 15.1.0 16.1.0 17.0.0; do
  python3 -m venv "venv-$version"
  "venv-$version/bin/pip" install --quiet --disable-pip-version-check "av==$version" imageio-ffmpeg==0.8.1 numpy==2.4.6
  "venv-$version/bin/python" colours.py
done
