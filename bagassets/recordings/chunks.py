"""A cache of the chunks decompressed last, so that no chunk is decompressed once per message."""

from collections.abc import Callable

from bagassets.recordings.damage import DamageError
from bagassets.recordings.sizes import GIGABYTE

# Chunks overlap with their neighbours; recorders fill them to a megabyte or a few.
_KEPT_CHUNKS = 4
# A pass decompresses each chunk once, some twice. A forged index could demand it for every message.
_MOST_REPEATS = 20
# A message that outlives its chunk's turn keeps the whole chunk in memory; from a large chunk it is better copied.
_LARGE_CHUNK_BYTES = 16 * 1024 * 1024


class LatestChunks:
    """The content of chunks; the last few are kept.

    Messages are read in order of time. Where neighbouring chunks overlap in time, as with many recorders, reading goes
    back and forth between them, and would decompress one each time.

    Args:
        load: reads and decompresses the chunk at a position of the file.
        most_bytes: how many bytes to keep besides the newest chunk.
        total_bytes: uncompressed size of all chunks of the recording.
        kept: how many chunks to keep.
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
        """Return the content of the chunk at a position of the file.

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
        """Forget a chunk."""
        self._kept_bytes -= len(self._kept.pop(position, b""))
        if position == self._newest:
            self._newest = -1


def detached(message: memoryview) -> bytes | memoryview:
    """Return a message as a view of its chunk, or as a copy if the view would keep a large chunk in memory."""
    chunk_bytes = len(message.obj) if isinstance(message.obj, bytes) else 0
    return bytes(message) if chunk_bytes > _LARGE_CHUNK_BYTES and chunk_bytes > 4 * len(message) else message
