"""Video streams whose pictures have their number painted in, encoded by PyAV as robots' encoders do."""

import os
from fractions import Fraction

import av
import numpy as np
from av.video.reformatter import ColorRange, Colorspace

from bagassets.formats.lerobot.video import scheduling_kept

os.environ.setdefault("SVT_LOG", "1")  # it greets on stderr otherwise
SIZE = WIDTH, HEIGHT = 192, 128
_BLOCK, _BITS, _TOP = 16, 10, 96
X265 = {"preset": "ultrafast", "x265-params": "log-level=none:bframes=0"}
X264 = {"preset": "ultrafast", "tune": "zerolatency"}
OPTIONS = {  # without delay, as on robots
    "libx264": X264,
    "libx265": X265,
    "libsvtav1": {"preset": "8", "crf": "20", "svtav1-params": "lp=1:pred-struct=1:lookahead=0"},
    "libvpx-vp9": {"deadline": "realtime", "cpu-used": "8", "lag-in-frames": "0"},
}
PATCHES = [(200, 30, 30), (30, 180, 40), (40, 60, 210), (220, 210, 40)]  # RGB


def painted(number):
    """Return a picture (H, W, 3), RGB: its number in blocks at the bottom, patches of colour, something that moves."""
    picture = np.full((HEIGHT, WIDTH, 3), 96, np.uint8)
    for at, colour in enumerate(PATCHES):
        picture[8:72, 8 + 44 * at : 44 + 44 * at] = colour
    picture[76:92, (number * 5) % (WIDTH - 16) :][:, :16] = 230
    for bit in range(_BITS):
        picture[_TOP : _TOP + _BLOCK, bit * _BLOCK : (bit + 1) * _BLOCK] = 235 if number >> bit & 1 else 16
    return picture


def number_in(picture):
    """Return the number painted into a picture of any order of colours."""
    inner = picture[_TOP + 4 : _TOP + _BLOCK - 4]
    blocks = [inner[:, bit * _BLOCK + 4 : (bit + 1) * _BLOCK - 4].mean() for bit in range(_BITS)]
    assert all(abs(mean - 125) > 60 for mean in blocks), "no number can be read"
    return sum((mean > 125) << bit for bit, mean in enumerate(blocks))


def encode(
    codec="libx264",
    number=40,
    *,
    gop=10,
    b_frames=0,
    matrix=None,
    full=False,
    options=None,
    size=None,
    noise=False,
    pixels="yuv420p",
):
    """Return the packets of a stream, in the order in which they must be decoded, with their number in time.

    Args:
        codec: encoder.
        number: of pictures.
        gop: pictures from key frame to key frame.
        b_frames: pictures in a row that refer to later ones.
        matrix: what is tagged: `ITU709` or `ITU601`, which pictures are converted with; None for 601 without a tag.
        full: whether the range is full, tagged.
        options: of the encoder.
        size: width and height; else `SIZE`, with numbers.
        noise: pictures are noise.
        pixels: format of the pixels.
    """
    context = av.CodecContext.create(codec, "w")
    context.width, context.height = size or SIZE
    context.pix_fmt, context.gop_size, context.max_b_frames = pixels, gop, b_frames
    context.time_base, context.framerate = Fraction(1, 20), Fraction(20)
    context.options = OPTIONS[codec] if options is None else options
    if matrix is not None:
        context.colorspace = {"ITU709": 1, "ITU601": 5}[matrix]
    context.color_range = 2 if full else (1 if matrix is not None else 0)
    with scheduling_kept():
        context.open()
    packets = []
    for at in range(number):
        picture = painted(at) if size is None else np.zeros((*size[::-1], 3), np.uint8)
        if noise:
            picture = np.random.default_rng(at).integers(0, 256, picture.shape, np.uint8)
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(
            format=pixels, dst_colorspace=Colorspace[matrix or "ITU601"],
            dst_color_range=ColorRange.JPEG if full else ColorRange.MPEG,
        )  # fmt: skip
        frame.pts = at
        packets += context.encode(frame)
    packets += context.encode(None)
    return [(int(packet.pts), bytes(packet)) for packet in packets]
