"""Canonical JSON and digests: one value has one text, and one text one digest."""

import json
from pathlib import Path
from typing import Any

from blake3 import blake3

__all__ = ["canonical_json", "digest_bytes", "digest_file", "digest_json"]


def canonical_json(value: Any) -> bytes:
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


def digest_json(value: Any) -> str:
    """Return the digest of the canonical JSON of `value`."""
    return digest_bytes(canonical_json(value))


def digest_file(path: Path) -> str:
    """Return the BLAKE3 digest of a file, memory-mapped and hashed with all cores."""
    hasher = blake3(max_threads=blake3.AUTO)
    hasher.update_mmap(path)
    return hasher.hexdigest()
