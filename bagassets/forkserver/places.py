"""Where a server keeps its socket, lock and logs."""

import hashlib
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bagassets.errors import BagAssetsError

__all__ = ["Places"]

_SOCKET_PATH_LIMIT = 100  # bytes; the system's is 108 on Linux and 104 elsewhere, with the final zero


@dataclass(frozen=True)
class Places:
    """Files of one server.

    Attributes:
        state_folder: folder that keeps all state of a recipe.
        stamp: what the server is keyed by.
    """

    state_folder: Path
    stamp: str

    @property
    def folder(self) -> Path:
        """Folder of all servers of this state folder."""
        return self.state_folder / "forkserver"

    @property
    def lock(self) -> Path:
        """File that the server holds locked while it serves; it names the socket."""
        return self.folder / f"{self.stamp[:16]}.lock"

    @property
    def log(self) -> Path:
        """What the server itself writes."""
        return self.folder / f"{self.stamp[:16]}.log"

    def job_log(self, label: str) -> Path:
        """Return the file that receives what a worker writes."""
        return self.folder / "logs" / f"{re.sub(r'[^A-Za-z0-9_.-]', '_', label)[:100]}.log"

    @property
    def socket(self) -> Path | None:
        """Socket of the server that runs or ran here, as it wrote it down; None if there was none."""
        try:
            text = self.lock.read_text("utf-8")
        except OSError:
            return None
        return Path(text) if text else None

    def choose_socket(self) -> Path:
        """Return where a new server puts its socket: here, unless the path is too long for one.

        Raises:
            BagAssetsError: the runtime folder that is taken instead belongs to somebody else.
        """
        path = self.folder / f"{self.stamp[:16]}.sock"
        if len(os.fsencode(path)) <= _SOCKET_PATH_LIMIT:
            return path
        owner = hashlib.sha256(os.fsencode(self.folder)).hexdigest()[:16]
        return _runtime_folder() / f"{owner}-{self.stamp[:16]}.sock"

    def remove_socket(self) -> None:
        """Remove the socket; only while holding the lock."""
        path = self.socket
        if path is not None:
            path.unlink(missing_ok=True)

    def make(self) -> None:
        """Make the folders.

        Raises:
            BagAssetsError: they cannot be made.
        """
        try:
            (self.folder / "logs").mkdir(parents=True, exist_ok=True)
        except OSError as err:
            raise BagAssetsError(
                f"{self.folder}: the folder of the fork server cannot be made ({err.strerror}); "
                "make the state folder writable, or name another one in the recipe (field state)."
            ) from err

    @classmethod
    def known(cls, state_folder: Path) -> Iterator["Places"]:
        """Yield the places of every server that was started here, alive or not."""
        for lock in sorted((state_folder / "forkserver").glob("*.lock")):
            yield cls(state_folder, lock.stem)


def _runtime_folder() -> Path:
    """Return a short folder that only this user may enter."""
    base = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())
    if len(os.fsencode(base)) > _SOCKET_PATH_LIMIT - 60:
        base = Path("/tmp")  # noqa: S108  (the folder below it is checked to be ours alone)
    folder = base / f"bagassets-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise BagAssetsError(
            f"{folder}: must be a folder that only you may enter, because the fork server puts its socket there; "
            "remove it, or set XDG_RUNTIME_DIR to a folder of your own."
        )
    return folder
