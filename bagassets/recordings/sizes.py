"""Checking the sizes that a recording announces against the recipe's `limits`, before memory is allocated."""

from pathlib import Path

from bagassets.base.errors import SizeLimitError
from bagassets.base.quantities import readable_bytes
from bagassets.recipe.model import Limits

GIGABYTE = 1_000_000_000


class Sizes:
    """The bounds on one recording.

    Args:
        path: the recording.
        size: bytes of its files.
        limits: of the recipe.
        whole: the bounds on all files together, if these are on one of several.
    """

    def __init__(self, path: Path, size: int, limits: Limits, whole: "Sizes | None" = None) -> None:
        self._path = path
        self._whole = whole
        self._size = size
        self._limits = limits
        self._offsets: set[int] = set()
        self.unpacked_bytes = 0

    def add_chunk(self, offset: int, unpacked_bytes: int) -> None:
        """Count the announced size of a chunk; a chunk counts once, however often it is added.

        Args:
            offset: of the chunk in the file.
            unpacked_bytes: its announced uncompressed size.

        Raises:
            SizeLimitError: the chunk, or the recording, may not hold that much.
        """
        self.check_chunk(offset, unpacked_bytes)
        if offset in self._offsets:
            return
        self._offsets.add(offset)
        self.add(unpacked_bytes)

    def add(self, unpacked_bytes: int) -> None:
        """Count bytes that were unpacked, or will be.

        Raises:
            SizeLimitError: the recording may not hold that much.
        """
        self.unpacked_bytes += unpacked_bytes
        if self.unpacked_bytes > max(GIGABYTE, self._limits.compression_ratio * self._size):
            raise SizeLimitError(
                f"{self._path}: its {readable_bytes(self._size)} unpack to {readable_bytes(self.unpacked_bytes)} or "
                f"more, over {self._limits.compression_ratio} times as much; if you trust the recording, raise "
                "limits.compression_ratio in the recipe."
            )
        if self._whole is not None:
            self._whole.add(unpacked_bytes)

    def check_chunk(self, offset: int, unpacked_bytes: int) -> None:
        """Check the announced size of one chunk.

        Raises:
            SizeLimitError: no chunk may hold that much.
        """
        if unpacked_bytes > self._limits.chunk_bytes:
            raise SizeLimitError(
                f"{self._path}: the chunk at byte {offset} holds {readable_bytes(unpacked_bytes)} unpacked, more than "
                f"{readable_bytes(self._limits.chunk_bytes)}; if you trust the recording, raise limits.chunk_bytes in "
                "the recipe."
            )

    def check_connections(self, number: int) -> None:
        """Check the number of connections: publishers in ROS 1, channels in MCAP.

        Raises:
            SizeLimitError: a recording may not have that many.
        """
        if number > self._limits.connections:
            raise SizeLimitError(
                f"{self._path}: it has {number} connections or more; if you trust the recording, raise "
                "limits.connections in the recipe."
            )
