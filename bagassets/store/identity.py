"""The id of a store, by which another machine can tell whether it sees the same one.

Where a file system is not mounted, its mount point is an empty folder: a store without anything, to whoever looks there.
"""

import re
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

from bagassets.base.files import create_atomically, write_atomically

_FILE = "store.id"
_ID = re.compile(r"([0-9a-f]{32})\n?")


def id_of_store(root: Path) -> str | None:
    """Return the id of the store in `root`; None if it has none, it was torn by a power loss, or cannot be read."""
    try:
        found = _ID.fullmatch((root / _FILE).read_text("utf-8"))
    except (OSError, UnicodeDecodeError):
        return None
    return None if found is None else found[1]


def identify(root: Path) -> str | None:
    """Return the id of the store in `root`, which gets one if need be; None if it cannot be written."""
    found = id_of_store(root)
    if found is None:
        with suppress(OSError):
            new = f"{uuid4().hex}\n".encode()
            if not create_atomically(root / _FILE, new) and id_of_store(root) is None:
                write_atomically(root / _FILE, new)
        found = id_of_store(root)  # that of the first writer
    return found
