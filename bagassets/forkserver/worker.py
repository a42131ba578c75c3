"""The worker's side: everything in the child process from the fork to its end.

A function that runs in a worker takes one JSON object and returns JSON. It may call `note`
to tell the server and the client something while it works, and `cancel_requested` to find out
why it was interrupted.
"""

import io
import json
import logging
import os
import signal
import socket
import sys
import time
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonMapping
from bagassets.base.lost_interrupts import interrupt_soon
from bagassets.forkserver.protocol import Lines, Message, encode


class _Channel:
    """The worker's end of the socket to the server; does nothing if there is no server."""

    def __init__(self) -> None:
        self._socket: socket.socket | None = None
        self._lines = Lines()
        self._cancelled = False

    def open(self, connection: socket.socket) -> None:
        self._socket = connection

    def send(self, message: Message) -> None:
        if self._socket is None:
            return
        try:
            self._socket.sendall(encode(message))
        except OSError:
            self._socket = None  # the server is gone; the job is still worth finishing

    def is_cancelled(self) -> bool:
        if self._socket is not None and not self._cancelled:
            self._socket.setblocking(False)
            messages = self._lines.receive(self._socket)
            self._socket.setblocking(True)
            self._cancelled = any(message.get("op") == "cancel" for message in messages)
        return self._cancelled


_CHANNEL = _Channel()


def note(content: JsonMapping) -> None:
    """Tell the server something about the running job, and the client if it listens."""
    _CHANNEL.send({"note": dict(content)})


def cancel_requested() -> bool:
    """Return whether a client cancelled this job; otherwise an interrupt comes from elsewhere."""
    return _CHANNEL.is_cancelled()


def load_function(name: str) -> Any:
    """Return the function named `module:function`.

    Raises:
        BagAssetsError: it cannot be loaded.
    """
    module, _, function = name.partition(":")
    try:
        return getattr(import_module(module), function)
    except (ImportError, AttributeError) as err:
        raise BagAssetsError(
            f"{name}: a worker cannot load this function ({err}); expected module:function."
        ) from err


def run_job(connection: socket.socket, job: Message, log: Path) -> NoReturn:
    """Run a job in a process that was just forked, report its result, and end the process."""
    code = 1
    try:
        _become_worker(job, log)
        _CHANNEL.open(connection)
        code = _call(job)
    finally:
        _flush()
        os._exit(code)  # exit handlers inherited from the server must not run here


def _become_worker(job: Message, log: Path) -> None:
    for signum in (signal.SIGTERM, signal.SIGCHLD, signal.SIGHUP):
        signal.signal(signum, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.unraisablehook = interrupt_soon
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    os.environ.clear()
    os.environ.update(job["env"])
    time.tzset()
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    empty = os.open(os.devnull, os.O_RDONLY)
    for source, target in ((empty, 0), (output, 1), (output, 2)):
        os.dup2(source, target)
    os.close(output)
    os.close(empty)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(line_buffering=True)
    try:
        os.chdir(job["cwd"])
    except OSError as err:
        logging.getLogger(__name__).warning("%s: not the job's current folder (%s)", job["cwd"], err.strerror)


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        # Whatever happens, such as a full disk, this process must not go on as the server.
        with suppress(Exception):
            stream.flush()


def _call(job: Message) -> int:
    try:
        result = load_function(job["function"])(job["args"])
        _flush()  # whoever gets the result finds the whole log
        _CHANNEL.send({"result": json.loads(json.dumps(result))})
    except BaseException as err:  # whatever it was, the client gets the error
        is_for_users = isinstance(err, BagAssetsError)
        if not is_for_users:
            logging.getLogger(__name__).exception("%s failed", job["function"])
        error = {"type": type(err).__name__, "message": str(err), "is_for_users": is_for_users}
        _CHANNEL.send({"error": error})
        return 1
    return 0
