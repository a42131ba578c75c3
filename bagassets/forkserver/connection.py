"""The server's side of a client's connection."""

import selectors
import socket
from collections.abc import Callable

from bagassets.forkserver.protocol import Lines, Message, encode


class Connection:
    """Reads requests and writes answers without ever waiting for the client."""

    def __init__(
        self,
        accepted: socket.socket,
        selector: selectors.BaseSelector,
        on_message: Callable[["Connection", Message], None],
        on_close: Callable[["Connection"], None],
    ) -> None:
        accepted.setblocking(False)
        self._socket = accepted
        self._selector = selector
        self._on_message = on_message
        self._on_close = on_close
        self._lines = Lines()
        self._unsent = b""
        self._is_open = True
        selector.register(accepted, selectors.EVENT_READ, self._ready)

    def send(self, message: Message) -> None:
        """Send a message now or as soon as the client reads."""
        if self._is_open:
            self._unsent += encode(message)
            self._flush()

    def close_file(self) -> None:
        """Close the copy of the socket in a forked process; the connection itself stays open."""
        self._socket.close()

    def close(self) -> None:
        """End the connection."""
        if self._is_open:
            self._is_open = False
            self._selector.unregister(self._socket)
            self._socket.close()
            self._on_close(self)

    def _ready(self) -> None:
        if self._is_open and self._unsent:
            self._flush()
        if not self._is_open:
            return
        try:
            messages = self._lines.receive(self._socket)
        except ValueError:
            self.close()  # not our protocol
            return
        for message in messages:
            self._on_message(self, message)
        if self._lines.is_closed:
            self.close()

    def _flush(self) -> None:
        try:
            sent = self._socket.send(self._unsent)
        except BlockingIOError:
            sent = 0
        except OSError:
            self.close()
            return
        self._unsent = self._unsent[sent:]
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if self._unsent else 0)
        self._selector.modify(self._socket, events, self._ready)
