"""The end of a process of the web UI together with its parent."""

import os
import signal
import threading

_STDIN = 0


def end_with_parent() -> threading.Event:
    """Interrupt this process when its standard input, a pipe from the parent, is closed: by the parent, or by its death.

    Returns:
        An event that is set then, since Python drops an interrupt that arrives in a finalizer or in the middle of an import.
    """
    is_gone = threading.Event()

    def wait() -> None:
        while os.read(_STDIN, 1):
            pass
        os.kill(os.getpid(), signal.SIGINT)
        is_gone.set()

    threading.Thread(target=wait, daemon=True).start()
    return is_gone
