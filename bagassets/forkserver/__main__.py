"""Start a server in the background: `python -m bagassets.forkserver SPEC STAMP TIMEOUT_S [FIRST_JOB]`.

The command returns 0 as soon as a server with this stamp answers, be it this one or
another that was quicker, and 1 if it cannot start. Its output goes to its log.
"""

import json
import logging
import os
import socket
import sys
import time
from pathlib import Path

from bagassets.base.errors import BagAssetsError, StoreError
from bagassets.base.fingerprints import signature
from bagassets.base.lock_files import LockFile
from bagassets.forkserver.protocol import FirstJob
from bagassets.forkserver.server import Server
from bagassets.forkserver.server_files import ServerFiles
from bagassets.forkserver.spec import SOURCE_CHANGED, ServerSpec

_LOG = logging.getLogger(__name__)
_POLL_S = 0.05
_KEPT_LOGS = 200


def main(arguments: list[str]) -> int:
    """Fork the server and wait until it answers."""
    logging.basicConfig(format="%(asctime)s %(name)s: %(message)s", level=logging.WARNING)
    logging.getLogger("bagassets").setLevel(logging.INFO)
    spec, stamp, timeout_s = ServerSpec.from_json(json.loads(arguments[0])), arguments[1], float(arguments[2])
    ready, signal_ready = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(ready)
        code = 1
        try:
            files, first_job = ServerFiles(spec.state_folder, stamp), arguments[3:]
            first = json.loads(first_job[0]) if first_job else None
            code = _serve(spec, files, timeout_s, signal_ready, first)
        except BagAssetsError as err:
            _LOG.error("%s", err)
        except Exception:  # noqa: BLE001  (`os._exit` would swallow it)
            _LOG.exception("the server ended")
        finally:
            logging.shutdown()
            os._exit(code)
    os.close(signal_ready)
    if os.read(ready, 1):
        return 0
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def _serve(
    spec: ServerSpec, files: ServerFiles, timeout_s: float, signal_ready: int, first_job: FirstJob | None
) -> int:
    deadline = time.monotonic() + timeout_s
    while (lock := _lock_of_server(files.lock)) is None:
        if _answers(files):
            return 0
        if time.monotonic() > deadline:
            _LOG.error("another server holds %s and does not answer", files.lock)
            return 1
        time.sleep(_POLL_S)
    # Left by a server that was killed; a first job would take it for ours.
    files.remove_socket()
    lock.write("")
    _remove_leftovers(spec.state_folder)
    logs = (files.folder / "logs").glob("*.log")
    for log in sorted(logs, key=lambda path: signature(path)[1:2], reverse=True)[_KEPT_LOGS:]:
        log.unlink(missing_ok=True)
    server = Server(spec, files, lock)
    try:
        server.prepare(first_job)
    except BagAssetsError:
        raise
    except Exception:  # noqa: BLE001  (modules of users may raise anything)
        _LOG.exception("the modules cannot be imported")
        return 1
    if spec.stamp() != files.stamp:
        _LOG.info("the code, the recipe or an installed package changed meanwhile")
        return SOURCE_CHANGED

    def on_ready() -> None:
        os.write(signal_ready, b"1")
        os.close(signal_ready)

    server.serve(on_ready)
    return 0


def _lock_of_server(path: Path) -> LockFile | None:
    """Return the lock of a server, held; None if another process holds it."""
    while True:
        lock = LockFile.open(path)
        try:
            is_ours = lock.try_lock()
        except OSError as err:
            raise StoreError(
                f"{path.parent}: files cannot be locked there ({err.strerror}); set `state` in the recipe to a folder on a local "
                "disk, and `store` to the shared one."
            ) from err
        if not is_ours:
            lock.close()
            return None
        if lock.is_in_place:
            return lock
        lock.close()  # the last holder removed the file between our open and our lock


def _remove_leftovers(state_folder: Path) -> None:
    """Remove the files of servers that were killed."""
    for files in ServerFiles.known(state_folder):
        lock = _lock_of_server(files.lock)
        if lock is not None:
            files.remove_socket()
            files.log.unlink(missing_ok=True)
            lock.remove()


def _answers(files: ServerFiles) -> bool:
    path = files.socket
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        return path is not None and probe.connect_ex(str(path)) == 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
