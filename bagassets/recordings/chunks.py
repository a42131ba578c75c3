"""The chunks of a recording that were unpacked last, so that none is unpacked for every message."""

from collections.abc import Callable

from bagassets.recordings.damage import DamageError
from bagassets.recordings.sizes import GIGABYTE

__all__ = ["LatestChunks", "lasting"]

# Chunks overlap with their neighbours; recorders fill them to a megabyte or a few.
_KEPT_CHUNKS = 4
# A pass unpacks each chunk once, some twice. A made-up index could have it done for every message.
_MOST_REPEATS = 20
# A message that is used later keeps its whole chunk in memory; of a large chunk it is better copied.
_LARGE_CHUNK_BYTES = 16 * 1024 * 1024


class LatestChunks:
    """The content of chunks, the last few of which are kept.

    Messages come sorted by time. Where times of neighbouring chunks overlap, as those of many recorders
    do, reading goes back and forth between them, and would unpack each again every time.

    Args:
        load: reads and unpacks the chunk at a position of the file.
        most_bytes: how much may be kept beside the newest chunk.
        total_bytes: of all chunks of the recording, unpacked.
        kept: how many chunks may be kept.
    """

    def __init__(
        self, load: Callable[[int], bytes], most_bytes: int, total_bytes: int, kept: int = _KEPT_CHUNKS
    ) -> None:
        self._load = load
        self._most_bytes = most_bytes
        self._most_kept = kept
        self._left_bytes = _MOST_REPEATS * total_bytes + GIGABYTE
        self._kept: dict[int, bytes] = {}
        self._kept_bytes = 0
        self._newest = -1

    def at(self, position: int) -> bytes:
        """Return what is in the chunk at a position of the file.

        Raises:
            DamageError: messages jump between chunks without end.
        """
        if position == self._newest:
            return self._kept[position]
        content = self._kept.pop(position, None)
        if content is None:
            content = self._load(position)
            self._kept_bytes += len(content)
            self._left_bytes -= len(content)
            if self._left_bytes < 0:
                raise DamageError("its index goes back and forth between chunks without end")
        self._kept[position] = content  # the newest last
        self._newest = position
        while len(self._kept) > 1 and (
            len(self._kept) > self._most_kept or self._kept_bytes > self._most_bytes
        ):
            self._kept_bytes -= len(self._kept.pop(next(iter(self._kept))))
        return content

    def drop(self, position: int) -> None:
        """Keep a chunk no longer."""
        self._kept_bytes -= len(self._kept.pop(position, b""))
        if position == self._newest:
            self._newest = -1


def lasting(message: memoryview) -> bytes | memoryview:
    """Return the bytes of a message so that they keep no more memory in use than a few times their own."""
    chunk_bytes = len(message.obj) if isinstance(message.obj, bytes) else 0
    return bytes(message) if chunk_bytes > _LARGE_CHUNK_BYTES and chunk_bytes > 4 * len(message) else message
