"""The files of a server: socket, lock and logs."""

import hashlib
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from bagassets.base.errors import BagAssetsError

_SHORT_FOLDER = Path("/tmp")  # noqa: S108  (the folder below it is checked to be ours alone)
_SOCKET_PATH_LIMIT = 100  # bytes; the system's limit is 108 on Linux and 104 elsewhere, with the final zero


class ServerFiles(NamedTuple):
    """Files of one server.

    Attributes:
        state_folder: folder that keeps all state of a recipe.
        stamp: stamp of the server's spec.
    """

    state_folder: Path
    stamp: str

    @property
    def folder(self) -> Path:
        """Folder of all servers of this state folder."""
        return self.state_folder / "forkserver"

    @property
    def lock(self) -> Path:
        """The file that the server holds locked while it serves; it contains the path of the socket."""
        return self.folder / f"{self.stamp[:16]}.lock"

    @property
    def log(self) -> Path:
        """The log of the server itself."""
        return self.folder / f"{self.stamp[:16]}.log"

    def job_log(self, label: str) -> Path:
        """Return the file that receives a worker's output."""
        return self.folder / "logs" / f"{re.sub(r'[^A-Za-z0-9_.-]', '_', label)[:100]}.log"

    @property
    def socket(self) -> Path | None:
        """Socket of the server that runs or ran here, as written in its lock file; None if there was none.

        After a power loss, or in a copy of the state folder, the file may hold anything else; that is ignored.
        """
        try:
            path = Path(self.lock.read_text("utf-8"))
        except (OSError, UnicodeDecodeError):
            return None
        is_ours = path == self._socket_here or path.name == self._socket_elsewhere
        return path if path.is_absolute() and is_ours else None

    def choose_socket(self) -> Path:
        """Return the path for a new server's socket: in this folder, unless the path would be too long.

        Whoever binds it removes the socket of an earlier server that was killed.

        Raises:
            BagAssetsError: the runtime folder, used instead, belongs to somebody else.
        """
        path = self._socket_here
        if len(os.fsencode(path)) <= _SOCKET_PATH_LIMIT:
            return path
        return _runtime_folder() / self._socket_elsewhere

    def remove_socket(self) -> None:
        """Remove the socket; only valid while holding the lock.

        Besides the path in the lock file, the default path is removed: a server that was killed, or met a full disk,
        may have made its socket without noting it.
        """
        for path in {self._socket_here, self.socket}:
            if path is not None and path.is_socket():
                path.unlink(missing_ok=True)

    @property
    def _socket_here(self) -> Path:
        return self.folder / f"{self.stamp[:16]}.sock"

    @property
    def _socket_elsewhere(self) -> str:
        """Name of the socket in the runtime folder, which servers of all state folders share."""
        owner = hashlib.sha256(os.fsencode(self.folder)).hexdigest()[:16]
        return f"{owner}-{self.stamp[:16]}.sock"

    def make(self) -> None:
        """Create the folders.

        Raises:
            BagAssetsError: they cannot be created.
        """
        try:
            (self.folder / "logs").mkdir(parents=True, exist_ok=True)
        except OSError as err:
            raise BagAssetsError(
                f"{self.folder}: the folder of the fork server cannot be made ({err.strerror}); "
                "make the state folder writable, or name another one in the recipe (field state)."
            ) from err

    @classmethod
    def known(cls, state_folder: Path) -> Iterator["ServerFiles"]:
        """Yield the files of every server that was started here, whether it is alive or not."""
        folder = state_folder / "forkserver"
        for stamp in sorted({path.stem for kind in ("lock", "sock") for path in folder.glob(f"*.{kind}")}):
            yield cls(state_folder, stamp)


def last_lines(log: Path, most: int = 15) -> list[str]:
    """Return the last lines of a log; none if it cannot be read."""
    try:
        return log.read_text("utf-8", "replace").splitlines()[-most:]
    except OSError:
        return []


def _runtime_folder() -> Path:
    """Return a short folder that only this user may enter."""
    import tempfile

    try:
        base = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())
    except OSError:  # it tests whether files can be written; even a full disk has room for a socket
        base = _SHORT_FOLDER
    if len(os.fsencode(base)) > _SOCKET_PATH_LIMIT - 60:
        base = _SHORT_FOLDER
    folder = base / f"bagassets-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise BagAssetsError(
            f"{folder}: must be a folder that only you may enter, because the fork server puts its socket there; "
            "remove it, or set XDG_RUNTIME_DIR to a folder of your own."
        )
    return folder
