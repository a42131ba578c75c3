"""The id of a store, by which another machine can tell whether it sees the same one.

Where a file system is not mounted, its mount point is an empty folder: a store without anything, to whoever looks there.
"""

from contextlib import suppress
from pathlib import Path
from uuid import uuid4

from bagassets.base.files import create_atomically

_FILE = "store.id"


def id_of_store(root: Path) -> str | None:
    """Return the id of the store in `root`; None if it has none, or cannot be read."""
    try:
        return (root / _FILE).read_text("utf-8").strip() or None
    except (OSError, UnicodeDecodeError):
        return None


def identify(root: Path) -> str | None:
    """Return the id of the store in `root`, which gets one if need be; None if it cannot be written."""
    found = id_of_store(root)
    if found is None:
        with suppress(OSError):
            create_atomically(root / _FILE, f"{uuid4().hex}\n".encode())
        found = id_of_store(root)  # that of the first writer
    return found
