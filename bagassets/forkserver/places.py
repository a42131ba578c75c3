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

__all__ = ["Places", "last_lines"]

_SHORT_FOLDER = Path("/tmp")  # noqa: S108  (the folder below it is checked to be ours alone)
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
        """Socket of the server that runs or ran here, as it wrote it down; None if there was none.

        Whatever else the file holds after a power loss, or in a copy of the state folder, is no socket of this server.
        """
        try:
            path = Path(self.lock.read_text("utf-8"))
        except (OSError, UnicodeDecodeError):
            return None
        is_ours = path == self._socket_here or path.name == self._socket_elsewhere
        return path if path.is_absolute() and is_ours else None

    def choose_socket(self) -> Path:
        """Return where a new server puts its socket: here, unless the path is too long for one.

        Whoever binds it removes what a server that was killed may have left there.

        Raises:
            BagAssetsError: the runtime folder that is taken instead belongs to somebody else.
        """
        path = self._socket_here
        if len(os.fsencode(path)) <= _SOCKET_PATH_LIMIT:
            return path
        return _runtime_folder() / self._socket_elsewhere

    def remove_socket(self) -> None:
        """Remove the socket; only while holding the lock.

        The name that it must have counts as well as the one written down: a server that was killed, or met a full
        disk, may have made its socket and written nothing.
        """
        for path in {self._socket_here, self.socket}:
            if path is not None and path.is_socket():
                path.unlink(missing_ok=True)

    @property
    def _socket_here(self) -> Path:
        return self.folder / f"{self.stamp[:16]}.sock"

    @property
    def _socket_elsewhere(self) -> str:
        """Name of the socket in the runtime folder, where servers of all state folders have theirs."""
        owner = hashlib.sha256(os.fsencode(self.folder)).hexdigest()[:16]
        return f"{owner}-{self.stamp[:16]}.sock"

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
        folder = state_folder / "forkserver"
        for stamp in sorted({path.stem for kind in ("lock", "sock") for path in folder.glob(f"*.{kind}")}):
            yield cls(state_folder, stamp)


def last_lines(log: Path, most: int = 15) -> list[str]:
    """Return the last lines of a log, for an error that its writer died of; none if it cannot be read."""
    try:
        return log.read_text("utf-8", "replace").splitlines()[-most:]
    except OSError:
        return []


def _runtime_folder() -> Path:
    """Return a short folder that only this user may enter."""
    try:
        base = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())
    except OSError:  # it tries whether files can be written; a full disk has room for a socket
        base = _SHORT_FOLDER
    if len(os.fsencode(base)) > _SOCKET_PATH_LIMIT - 60:
        base = _SHORT_FOLDER
    folder = base / f"bagassets-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise BagAssetsError(
            f"{folder}: must be a folder that only you may enter, because the fork server puts its socket there; "
            "remove it, or set XDG_RUNTIME_DIR to a folder of your own."
        )
    return folder
