"""Putting a page on disk, whole or not at all."""

from contextlib import suppress
from pathlib import Path
from uuid import uuid4

from bagassets.errors import DatasetError

__all__ = ["write_page"]


def write_page(path: Path, page: str) -> int:
    """Write a page, and return its size in bytes.

    Raises:
        DatasetError: it cannot be written.
    """
    data = page.encode()
    temporary = path.with_name(f".{path.name}.{uuid4().hex}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(data)
        temporary.replace(path)
    except OSError as err:
        with suppress(OSError):
            temporary.unlink()
        raise DatasetError(
            f"{path}: the page cannot be written ({err.strerror}); choose another place."
        ) from err
    return len(data)
