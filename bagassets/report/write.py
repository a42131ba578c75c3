"""Writing a page, whole or not at all."""

from pathlib import Path

from bagassets.base.errors import DatasetError
from bagassets.base.files import write_atomically


def write_page(path: Path, page: str) -> int:
    """Write a page, and return its size in bytes.

    Raises:
        DatasetError: it cannot be written.
    """
    data = page.encode()
    try:
        write_atomically(path, data, folders=True)
    except OSError as err:
        raise DatasetError(
            f"{path}: the page cannot be written ({err.strerror}); choose another place."
        ) from err
    return len(data)
