"""Writing a page, whole or not at all."""

from pathlib import Path

from bagassets.base.atomic import write_atomically
from bagassets.base.errors import DatasetError


def write_page(path: Path, page: str) -> int:
    """Write a page, and return its size in bytes.

    Raises:
        DatasetError: it cannot be written.
    """
    data = page.encode()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, data)
    except OSError as err:
        raise DatasetError(
            f"{path}: the page cannot be written ({err.strerror}); choose another place."
        ) from err
    return len(data)
