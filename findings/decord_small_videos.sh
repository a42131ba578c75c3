#!/usr/bin/env bash
# Episodes of a benchmark have small pictures, 96 x 96 or 72 x 48, as an H.264 file for each. What does decord read of them?
# Guess: height, width and 3 colours, as its documentation says, like of any other size. Seen on 2026-11-29, without a word:
#   decord2 3.4.0   FOUR values a pixel for widths of 48, 96 and 144, six for 32
#   decord 0.6.0    four for widths of 48 and 72
# A row ends at a multiple of 32, 64 or 128 bytes, as FFmpeg likes it on the processor at hand (here one with AVX-512), and its length
# divided by the width is taken for the number of colours. The bytes are still those of three: pixels (R, G, B) and (r, g, b) are read as
# (R, G, B, r) and (g, b, …), so that `frame[..., :3]` has wrong colours, is narrower than it was, and black to its right.
# `get_batch` raises an error for such a file ("The size must exactly match"). 64, 84, 128, 224 and larger ones are well.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
for decord in decord2==3.4.0 decord==0.6.0; do
  python3 -m venv --clear "$folder/venv"
  "$folder/venv/bin/pip" install --quiet --disable-pip-version-check "$decord" av==18.1.0 numpy==2.4.6
  cd "$folder"
  echo "$decord"
  venv/bin/python - <<'PYTHON'
import av
import decord
import numpy as np

HEIGHT = 48


def write(path, width):
    ramp = np.linspace(40, 220, width).astype(np.uint8)
    image = np.stack([np.tile(ramp, (HEIGHT, 1)), np.full((HEIGHT, width), 100, np.uint8), np.tile(ramp[::-1], (HEIGHT, 1))], 2)
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"crf": "5"})
        stream.width, stream.height, stream.pix_fmt = width, HEIGHT, "yuv420p"
        for _ in range(3):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    with av.open(path) as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24")


wrong = {}
for width in (32, 48, 72, 96, 144, 64, 84, 128, 224, 640):
    written = write(f"{width}.mp4", width)
    read = decord.VideoReader(f"{width}.mp4")[0].asnumpy()
    if read.shape != (HEIGHT, width, 3):
        wrong[width] = read.shape
        assert not np.allclose(read[..., :3], written, atol=20)
    rows = read.reshape(HEIGHT, -1)
    assert abs(rows[:, : width * 3].astype(int) - written.reshape(HEIGHT, -1)).max() < 8
print("shapes of those that are wrong:", wrong)
assert wrong
assert not {64, 84, 128, 224, 640} & set(wrong)
PYTHON
done
