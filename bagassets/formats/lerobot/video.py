"""Videos of episodes: encoded to the same bytes on every machine, and joined by copying their packets.

What would pick another algorithm by the processor is switched off: x264 has `cpu-independent`, swscale `bitexact` and
`accurate_rnd`; SVT-AV1's algorithms give equal results. Each encoder has one thread, and episodes run side by side.
"""

import io
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DatasetError
from bagassets.formats.lerobot.settings import Encoding

PYAV = "av"
"""The distribution whose version, that of the encoders and the muxer in it, is part of the key."""

_BT601, _LIMITED = 6, 1  # of ITU-T H.273 and FFmpeg: SMPTE 170M, and levels 16..235
_SCALER = 0x4 | 0x40000 | 0x80000  # of swscale: bicubic, accurate_rnd, bitexact
_BITEXACT = {"fflags": "+bitexact"}
# Without B-frames and open groups; SVT-AV1's prediction structure 1 is its low delay; presets above 8 leave out
# small changes between key frames (lamps stay dark for some frames), with those of PyAV 17 and later.
_ENCODERS = {
    "h264": ("libx264", "x264-params", "cpu-independent=1:stitchable=1", "veryfast", 23),
    "av1": ("libsvtav1", "svtav1-params", "lp=1:pred-struct=1", "8", 30),
}


def with_defaults(settings: Encoding) -> Encoding:
    """Return the settings of an encoder with the quality and the preset that are usual for its codec where they give none."""
    _, _, _, preset, crf = _ENCODERS[settings.codec]
    return settings.model_copy(update={"crf": settings.crf or crf, "preset": settings.preset or preset})


def even(image: NDArray[np.uint8], odd_size: str) -> NDArray[np.uint8]:
    """Return an image of even width and height, (H, W, 3): its last row or column is cropped, or there twice."""
    height, width = image.shape[:2]
    if odd_size == "pad":
        return np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return image[: height // 2 * 2, : width // 2 * 2]


def encode(images: Iterable[NDArray[np.uint8]], fps: int, settings: Encoding, extra: str = "") -> bytes:
    """Return an MP4 file of images in BGR, (H, W, 3) of the same even size; frame i stands at i / fps exactly.

    Args:
        images: at least one.
        fps: frames per second.
        settings: as of `with_defaults`.
        extra: further parameters of the encoder's own, for tests.
    """
    import av  # noqa: PLC0415  (an extra, and 0.1 s)
    from av.video.reformatter import ColorRange, Colorspace, VideoReformatter  # noqa: PLC0415

    os.environ.setdefault("SVT_LOG", "1")  # errors only: it greets on stderr otherwise
    encoder, parameters, fixed, _, _ = _ENCODERS[settings.codec]
    options = {
        "crf": str(settings.crf),
        "preset": str(settings.preset),
        "g": str(settings.keyframes),
        "threads": "1",
        parameters: fixed + extra,
    }
    if settings.codec == "h264":
        options["bf"] = "0"
    convert = VideoReformatter()
    file = io.BytesIO()
    with av.open(file, "w", format="mp4", options=_BITEXACT) as container:
        stream: Any = None
        converted: Any = None
        last = None
        for number, image in enumerate(images):
            if stream is None:
                stream = container.add_stream(encoder, fps, options=options)
                stream.height, stream.width, stream.pix_fmt = *image.shape[:2], "yuv420p"
                context = stream.codec_context
                context.colorspace = context.color_primaries = context.color_trc = _BT601
                context.color_range = _LIMITED
                with scheduling_kept():
                    context.open()
            if image is not last:  # a repeated one is converted once
                frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
                converted = convert.reformat(
                    frame,
                    format="yuv420p",
                    dst_colorspace=Colorspace.ITU601,
                    src_color_range=ColorRange.JPEG,
                    dst_color_range=ColorRange.MPEG,
                    interpolation=_SCALER,
                )
                last = image
            converted.pts = number
            container.mux(stream.encode(converted))
        container.mux(stream.encode())
    return file.getvalue()


@contextmanager
def scheduling_kept() -> Iterator[None]:
    """Have all threads scheduled as this one was: for root, SVT-AV1 makes its own and its caller real-time ones.

    Whatever they start would be, too, and nothing else would run on a machine whose processors they keep busy.
    """
    if sys.platform != "linux":
        yield
        return
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        yield
    finally:
        for thread in (int(task.name) for task in Path("/proc/self/task").iterdir()):
            with suppress(ProcessLookupError):
                if os.sched_getscheduler(thread) == os.SCHED_FIFO:
                    os.sched_setscheduler(thread, policy, parameters)


def join(parts: Sequence[tuple[Path, int]], fps: int, out: Path) -> None:
    """Join videos of episodes into one file by copying their packets; frame i of all stands at i / fps exactly.

    Args:
        parts: files of equal encoder settings, and how many frames each has, in order.
        fps: frames per second.
        out: the file to write.

    Raises:
        DatasetError: a file has another number of frames, or they are not at their times.
    """
    import av  # noqa: PLC0415  (an extra, and 0.1 s)

    offset = 0
    with av.open(str(out), "w", format="mp4", options=_BITEXACT) as target:
        stream = None
        for path, frames in parts:
            with av.open(str(path)) as source:
                own = source.streams.video[0]
                if stream is None:
                    # Opaque: as copied packets need no encoder, of which that of AV1 has another name than the decoder.
                    stream = target.add_stream_from_template(own, opaque=True)
                ticks = int(1 / ((own.time_base or 0) * fps))
                number = 0
                for packet in source.demux(own):
                    if packet.dts is None:  # the last one, which is empty
                        continue
                    if packet.pts != number * ticks or packet.dts != packet.pts:
                        raise DatasetError(
                            f"{path}: frame {number} is not at its time; remove the artifact with `bagassets verify`, then build again."
                        )
                    packet.pts = packet.dts = (offset + number) * ticks
                    packet.duration = ticks
                    packet.stream = stream
                    target.mux(packet)
                    number += 1
                if number != frames:
                    raise DatasetError(
                        f"{path}: has {number} frames instead of {frames}; remove the artifact with `bagassets verify`, then build again."
                    )
                offset += frames


def header(data: bytes) -> str:
    """Return the parameters of an MP4 file's stream that all parts of a joined file share, as text."""
    import av  # noqa: PLC0415  (an extra, and 0.1 s)

    with av.open(io.BytesIO(data)) as container:
        context = container.streams.video[0].codec_context
        return f"{context.width}x{context.height} {bytes(context.extradata or b'').hex()}"
