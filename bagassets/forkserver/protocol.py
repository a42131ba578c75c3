"""How client, server and workers talk: one JSON object per line, over Unix sockets.

Requests carry `op` (hello, submit, cancel, status, drain, shutdown) and are answered by one
object with `reply`; objects with `event` (started, note, finished, killed) come unasked.
"""

import json
import socket
from typing import Any

__all__ = ["FirstJob", "Lines", "Message", "encode"]

Message = dict[str, Any]
# `module:function` and its arguments, for a server to begin with.
FirstJob = tuple[str, Message]
_CHUNK = 1 << 16


def encode(message: Message) -> bytes:
    """Return the line that carries `message`."""
    return json.dumps(message, separators=(",", ":")).encode() + b"\n"


class Lines:
    """Cuts a stream of bytes into messages."""

    def __init__(self) -> None:
        self._pending = b""
        self.is_closed = False
        self.is_drained = False

    def receive(self, connection: socket.socket) -> list[Message]:
        """Read what is there and return the messages that are complete.

        A non-blocking socket with nothing to read yields none; one whose other end is gone
        sets `is_closed`. `is_drained` tells that there was nothing to read.
        """
        self.is_drained = False
        try:
            data = connection.recv(_CHUNK)
        except BlockingIOError:
            self.is_drained = True
            return []
        except OSError:
            data = b""
        if not data:
            self.is_closed = True
            return []
        *complete, self._pending = (self._pending + data).split(b"\n")
        return [json.loads(line) for line in complete if line]
