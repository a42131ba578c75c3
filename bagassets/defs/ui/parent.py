"""The end of a process of the web UI together with its parent."""

import os
import signal
import sys
import threading
from collections.abc import Callable
from typing import NoReturn

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


def end_after(main: Callable[[], None]) -> NoReturn:
    """Run `main` until it ends or is interrupted, and end the process at once.

    Nothing is left to be ended then, for which gRPC would take six seconds.
    """
    code: object = 0
    try:
        main()
    except KeyboardInterrupt:
        pass
    except SystemExit as end:
        code = end.code
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else bool(code))
