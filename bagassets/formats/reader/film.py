"""Frames of a video by their numbers, decoded when they are asked for: forwards without seeking, else from a key frame on."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DatasetError

if TYPE_CHECKING:
    from av.container import InputContainer

_BT601, _BT709 = 5, 1  # of FFmpeg's `AVColorSpace`: BT.470 BG, which has the matrix of BT.601, and BT.709
_AHEAD = 16  # frames that are decoded and passed over rather than sought
_HAS_THREADS = 17  # from this PyAV on, pictures are converted by threads, too
_LOST = -1_000  # after a failure nothing is ahead


class Film:
    """A video file whose frames stand at whole multiples of 1 / fps.

    Args:
        path: the file.
        fps: frames per second.

    Raises:
        DatasetError: PyAV is not installed, or the file is no video.
    """

    def __init__(self, path: Path, fps: int) -> None:
        self._path = path
        self._fps = fps
        self._pid = self._next = 0
        self._open()

    def frame(self, number: int) -> NDArray[np.uint8]:
        """Return a frame by its number in the file: (H, W, 3), RGB.

        Raises:
            DatasetError: there is none, or it cannot be decoded.
        """
        if self._pid != os.getpid():
            self._open()  # a decoder does not outlive a fork
        try:
            if not self._next <= number <= self._next + _AHEAD:
                self._seek(number)
            frame = next((one for one in self._frames if self._number(one) >= number), None)
            self._next = _LOST if frame is None else self._number(frame) + 1
            if frame is not None and self._next == number + 1:
                return self._rgb(frame)
            why = "it has no such frame"
        except (OSError, ValueError) as err:  # PyAV's errors are both
            why = str(err)
        raise DatasetError(
            f"{self._path}: frame {number} cannot be read ({why}); `bagassets verify` finds damaged files, and the next build makes "
            "them again."
        )

    def _open(self) -> None:
        try:
            import av
        except ImportError:
            raise DatasetError(
                f"{self._path}: images of a LeRobot dataset are frames of videos, and PyAV, which reads these, is not installed; "
                "`pip install 'bagassets[video]'` brings it."
            ) from None
        try:
            self._container: InputContainer = av.open(str(self._path))
            self._stream = self._container.streams.video[0]
        except (OSError, ValueError, IndexError) as err:
            raise DatasetError(f"{self._path}: this video cannot be opened ({err}).") from err
        # Those of many files would be many, and a decoder with threads cannot be given up after a fork, which has none of them.
        self._stream.codec_context.thread_count = 1
        self._one_thread = {"threads": 1} if int(av.__version__.partition(".")[0]) >= _HAS_THREADS else {}
        self._frames: Iterator[Any] = self._container.decode(self._stream)
        self._next = 0
        self._pid = os.getpid()

    def _seek(self, number: int) -> None:
        """Go to the last key frame that is not after a frame."""
        base = self._stream.time_base or 1
        start = self._stream.start_time or 0
        self._container.seek(start + round(number / self._fps / base), stream=self._stream)
        self._frames = self._container.decode(self._stream)

    def _number(self, frame: Any) -> int:  # noqa: ANN401  (av.VideoFrame, which is imported late)
        return round(float((frame.pts - (self._stream.start_time or 0)) * self._stream.time_base) * self._fps)

    def _rgb(self, frame: Any) -> NDArray[np.uint8]:  # noqa: ANN401  (as above)
        # Some versions of PyAV go by the matrix that is tagged, others do not.
        matrix = _BT709 if int(frame.colorspace) == _BT709 else _BT601
        converted = frame.reformat(format="rgb24", src_colorspace=matrix, **self._one_thread)
        rgb: NDArray[np.uint8] = converted.to_ndarray()
        return rgb
