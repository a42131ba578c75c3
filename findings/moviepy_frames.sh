#!/usr/bin/env bash
# An episode of 100 pictures becomes an MP4 with moviepy: `ImageSequenceClip(pictures, fps=10)`, then `write_videofile`. Then a film whose pictures are right is read with
# it, picture by picture (`iter_frames`). Which pictures are there? Guess: the hundred, each once, both times.
# Seen with moviepy 2.2.1 on 2026-11-29, without a word, for pictures that have their number in them as stripes:
#   10 a second   99 are written, and 28 of them are the picture before: 22, 23, 23, 25, 26, 27, 28, 28, 30 …
#   15, 30        99 are written, and 24 and 6 of them are the picture before
#   50            all
# The time that each picture begins at is a float32: a tiny float32 is taken away from it, and since NumPy 2 that makes a float32 of a float64. It is later than the time
# that is looked up, for some. And their number is cut off after a sum of floats, which is a little too small. Pictures and states of a dataset are then a frame apart,
# here and there. Read at 30 a second, the last picture is missing; all others are right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check moviepy==2.2.1 av==18.1.0 numpy==2.4.6
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
from fractions import Fraction

import av
import numpy as np
from moviepy import ImageSequenceClip, VideoFileClip

NUMBERS = list(range(100))


def picture(number):
    """Return a picture of eight stripes, white for each bit of its number."""
    stripes = np.array([255 * (number >> bit & 1) for bit in range(8)], dtype=np.uint8)
    return np.broadcast_to(stripes.repeat(8)[None, :, None], (64, 64, 3)).copy()


def number(image):
    """Return the number of a picture."""
    return sum(1 << bit for bit in range(8) if image[:, 8 * bit : 8 * bit + 8].mean() > 127)


def stored(path):
    """Return the numbers of the pictures in a film."""
    with av.open(path) as film:
        return [number(frame.to_ndarray(format="rgb24")) for frame in film.decode(video=0)]


def write(path, rate):
    """Write a film of all pictures with PyAV."""
    with av.open(path, "w") as film:
        stream = film.add_stream("libx264", rate=Fraction(rate))
        stream.width = stream.height = 64
        stream.pix_fmt = "yuv420p"
        for index in NUMBERS:
            film.mux(stream.encode(av.VideoFrame.from_ndarray(picture(index), format="rgb24")))
        film.mux(stream.encode())


for rate in (10, 15, 30, 50):
    clip = ImageSequenceClip([picture(index) for index in NUMBERS], fps=rate)
    assert isinstance(clip.images_starts[1], np.float32)
    clip.write_videofile("written.mp4", logger=None)
    written = stored("written.mp4")
    write("right.mp4", rate)
    assert stored("right.mp4") == NUMBERS
    read = [number(image) for image in VideoFileClip("right.mp4").iter_frames()]
    off = [sum(a != b for a, b in zip(numbers, NUMBERS)) for numbers in (written, read)]
    print(f"{rate} a second: {len(written)} written, {off[0]} of them another one; {len(read)} read; {written[20:32]}")
    assert (len(written), off[0]) == {10: (99, 28), 15: (99, 24), 30: (99, 6), 50: (100, 0)}[rate]
    assert off[1] == 0 and len(read) == (99 if rate == 30 else 100)
    assert all(a in (b, b - 1) for a, b in zip(written, NUMBERS))
PYTHON
