"""Change notifications for a folder, where the file system supports them."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Self

__all__ = ["Notifications"]

# The first answer comes after this time even without a change; from then on no change is missed.
_FIRST_MS = 500


class Notifications:
    """Calls `wake` soon after anything changed below a folder, from a thread of its own.

    Args:
        root: the folder.
        wake: called after changes; many changes at once cause few calls.
        failed: called with the reason if the file system sends no notifications.
    """

    def __init__(self, root: Path, wake: Callable[[], None], failed: Callable[[str], None]) -> None:
        self._root = root
        self._wake = wake
        self._failed = failed
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._identity: tuple[int, int] | None = None

    def follow(self) -> None:
        """Start, or start anew if the path leads to another folder by now: replaced, or mounted over."""
        try:
            stat = self._root.stat()
        except OSError:
            return  # gone for now; the next call may find it again
        identity = (stat.st_dev, stat.st_ino)
        if self._identity == identity:
            return
        self.close()
        self._identity, self._stop = identity, threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(self._stop,), name="bagassets-notify", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop, and wait for the thread to end."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self, stop: threading.Event) -> None:
        from watchfiles import watch

        try:
            changes = watch(
                self._root,
                watch_filter=None,
                stop_event=stop,
                raise_interrupt=False,
                ignore_permission_denied=True,
                rust_timeout=_FIRST_MS,
                yield_on_timeout=True,
            )
            established = False
            for batch in changes:
                # Nobody reports changes between the last scan and the first notification: scan once more.
                if batch or not established:
                    self._wake()
                established = True
        except (OSError, RuntimeError) as err:  # the latter from watchfiles, also for too many watches
            self._failed(str(err))
