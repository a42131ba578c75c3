"""The protocol of client, server and workers: one JSON object per line, over Unix sockets.

Requests carry `op` (hello, submit, cancel, status, drain, shutdown) and are answered by one
object with `reply`; objects with `event` (note, finished, killed) are sent unrequested.
"""

import json
import socket

from bagassets.base.json_types import JsonObject

Message = JsonObject
# `module:function` and its arguments, run by a server while it starts.
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
        """Read once and return the complete messages.

        Sets `is_drained` if a non-blocking socket has nothing to read, and `is_closed` if the other end
        is gone.

        Raises:
            ValueError: a line is no message.
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
        messages = [json.loads(line) for line in complete if line]
        if not all(isinstance(message, dict) for message in messages):
            raise ValueError("a message is an object")
        return messages
