"""Output into a pipe whose reader may stop reading, as `head` does.

A command then goes on in silence and ends with the status that it has anyway, whether or not it was quick enough to write
everything before its reader was gone.
"""

import io
import os
import stat
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


class _Pipe(io.FileIO):
    """A pipe that swallows what is written once nobody reads it any more."""

    def write(self, data: "ReadableBuffer", /) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            return super().write(data)


def outliving_reader(stream: TextIO) -> TextIO:
    """Return a stream to use in place of one that writes into a pipe; any other stays what it is."""
    try:
        mode = os.fstat(stream.fileno()).st_mode
    except (OSError, ValueError):  # it is no file
        return stream
    if not (stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)):
        return stream
    pipe = io.BufferedWriter(_Pipe(stream.fileno(), "w", closefd=False))
    return io.TextIOWrapper(pipe, stream.encoding, stream.errors, line_buffering=bool(stream.line_buffering))
