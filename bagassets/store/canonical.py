"""Canonical JSON and digests: one value has one text, and one text one digest."""

import json
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from blake3 import blake3

# A block fits the cache of one core: hashed on one, 3 GB/s. A file hashed on two cores takes a third more of their time, and
# others are hashed or read beside it.
_READ_BYTES = 1 << 20
# `json.dumps` makes one for each call that has options.
_ENCODER = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def canonical_json(value: object) -> bytes:
    """Return the canonical JSON of `value`: sorted keys, no spaces, UTF-8, shortest floats.

    Raises:
        ValueError: a number is not finite.
        TypeError: a value is not JSON.
    """
    return _ENCODER.encode(value).encode()


def digest_bytes(data: bytes | memoryview) -> str:
    """Return the BLAKE3 digest of `data`, 64 hex digits."""
    return blake3(data).hexdigest()


def digest_json(value: object) -> str:
    """Return the digest of the canonical JSON of `value`."""
    return digest_bytes(canonical_json(value))


def digest_file(path: Path, between: Callable[[int], None] | None = None) -> str:
    """Return the BLAKE3 digest of a file.

    Args:
        path: the file.
        between: called with the number of bytes just read, every few milliseconds; an exception that it raises ends the
            hashing.
    """
    with closing(FileHasher(path)) as hasher:
        return hasher.finish(between)


class FileHasher:
    """Hashes a file from its beginning, a block at a time; close it.

    The file is read, not mapped: a mapped file that somebody truncates kills the process that reads it.

    Attributes:
        position: how many bytes have been hashed.
    """

    def __init__(self, path: Path) -> None:
        self.position = 0
        self._hasher = blake3()
        self._buffer = memoryview(bytearray(min(_READ_BYTES, max(1, path.stat().st_size))))
        self._file = path.open("rb", buffering=0)

    def follow(self, position: int, data: bytes = b"") -> None:
        """Hash up to a position; `data` are the bytes before it, if somebody else has read them already."""
        begin = position - len(data)
        while self.position < begin and self.read_block(begin - self.position):
            pass
        if self.position == begin:  # else the file ends sooner, or the bytes come late and have been hashed
            self._hasher.update(data)
            self.position = self._file.seek(position)

    def read_block(self, most: int | None = None) -> int:
        """Hash the next block, of no more bytes than `most`, and return its size; 0 at the end of the file."""
        read = self._file.readinto(self._buffer[:most]) or 0
        self._hasher.update(self._buffer[:read])
        self.position += read
        return read

    def finish(self, between: Callable[[int], None] | None = None) -> str:
        """Hash the rest, and return the digest of the file; see `digest_file`."""
        while read := self.read_block():
            if between is not None:
                between(read)
        return self._hasher.hexdigest()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
