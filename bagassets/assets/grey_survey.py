"""Grey values of all images of a topic, counted in a single pass over the topic.

No image can be written before the last one was seen, since percentiles are those of the whole recording. So
messages are stored as recorded in an unnamed file on the store's disk, which vanishes with the process. A second pass
over the topic would read and decompress every chunk of the recording again, for each such camera.
"""

from collections.abc import Iterator
from math import ceil
from pathlib import Path
from struct import Struct
from tempfile import TemporaryFile

import numpy as np

from bagassets.base.errors import StoreError
from bagassets.geometry.undistortion import Pixels
from bagassets.recordings.model import RawMessage

_HEAD = Struct("<qQ")  # log time, number of bytes
_VALUES = 1 << 16


class GreySurvey:
    """Counts grey values and keeps the messages.

    Args:
        folder: folder of the unnamed file of messages.

    Raises:
        StoreError: the file cannot be created.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        try:
            # Unbuffered, since whole images are written.
            self._file = TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115  (closed by `messages`)
        except OSError as err:
            raise self._refused(err) from err
        self._histogram = np.zeros(_VALUES, np.int64)
        self._like: RawMessage | None = None

    def add(self, message: RawMessage, pixels: Pixels | None) -> None:
        """Keep a message, and count the values of its image unless it did not decode.

        Raises:
            StoreError: the file cannot be written.
        """
        self._like = self._like or message._replace(data=b"")
        try:
            for part in (_HEAD.pack(message.log_time_ns, len(message.data)), message.data):
                rest = memoryview(part)
                while rest:  # a nearly full disk takes only a part
                    rest = rest[self._file.write(rest) :]
        except OSError as err:
            self._file.close()
            raise self._refused(err) from err
        if pixels is not None:
            self._histogram += np.bincount(pixels.ravel(), minlength=_VALUES)

    def _refused(self, err: OSError) -> StoreError:
        return StoreError(
            f"{self._folder}: 16-bit images cannot be stored there meanwhile ({err.strerror}); free disk space, or give "
            "`to_8bit` a `range` instead of `percentiles`."
        )

    def range(self, low_percent: float, high_percent: float) -> tuple[float, float]:
        """Return the grey values at two percentiles over all images, the second one greater than the first.

        A percentile is the smallest value with that share of all values at or below it.
        """
        seen = np.cumsum(self._histogram)
        ranks = (max(1, ceil(percent / 100.0 * int(seen[-1]))) for percent in (low_percent, high_percent))
        low, high = (int(np.searchsorted(seen, rank)) for rank in ranks)
        return float(low), float(max(high, low + 1))

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages in order, and remove them."""
        with self._file as file:
            file.seek(0)
            while head := file.read(_HEAD.size):
                log_time_ns, size = _HEAD.unpack(head)
                data = file.read(size)
                if self._like is not None:
                    yield self._like._replace(log_time_ns=log_time_ns, data=data)
