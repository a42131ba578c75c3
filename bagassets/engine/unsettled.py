"""Recordings whose last run did not end well.

Dagster shows them as failed, or lacks their newest checks, though all of their assets may be on record: a recipe was wrong
for a while, or a worker was killed a moment before its end. The next build records these once more. Each is noted in a file
of its own as its run begins, so that whatever ends the worker, and on whichever machine, the note stays.
"""

from contextlib import suppress
from pathlib import Path

from bagassets.base.files import remove, write_atomically
from bagassets.engine.plan import Plan
from bagassets.store.canonical import digest_bytes

_FOLDER = "unsettled"


class Unsettled:
    """The recordings of a project whose last run has not ended well, or goes on.

    Args:
        state: the state folder.
    """

    def __init__(self, state: Path) -> None:
        self._folder = state / _FOLDER

    def noted(self) -> frozenset[str]:
        """Return the partition keys."""
        found = set()
        with suppress(FileNotFoundError):
            for file in self._folder.glob("[!.]*"):  # not what is being written
                with suppress(OSError, UnicodeDecodeError):  # it was removed meanwhile, or is not ours
                    found.add(file.read_text("utf-8"))
        return frozenset(found)

    def add(self, key: str) -> None:
        """Note a recording; where the disk is full, what is made of it fails as well, and says so."""
        file = self._file(key)
        with suppress(OSError):
            if not file.exists():
                write_atomically(file, key.encode(), folders=True)

    def discard(self, key: str) -> None:
        """Forget a recording, if it was noted."""
        with suppress(OSError):  # then it is recorded once more
            remove(self._file(key))

    def forget_settled(self, plan: Plan) -> None:
        """Forget the recordings that are gone, or take no part any more: they have no run that could end well."""
        for key in self.noted():
            if key not in plan.bags or plan.bags[key].settled:
                self.discard(key)

    def _file(self, key: str) -> Path:
        """Keys may be too long for the name of a file, and have folders."""
        return self._folder / digest_bytes(key.encode())
