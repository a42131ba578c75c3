"""How far this process has come with reading a recording, reported now and then to whoever waits."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from bagassets.base.quantities import readable_bytes
from bagassets.recordings.model import OnRead, RecordingFiles

__all__ = ["Reading", "Tell", "followed", "readings_told"]

EVERY_S = 10.0
"""Time before the first report and between two; a read that takes less is not reported."""


@dataclass(frozen=True)
class Reading:
    """How far a pass over a recording has come.

    Attributes:
        what: what the pass is for.
        share: part of the bytes that it has passed, 0 to 1.
        size: bytes of the recording.
        bytes_per_s: how fast it was so far.
    """

    what: str
    share: float
    size: int
    bytes_per_s: float

    def __str__(self) -> str:
        return f"{self.what}: {self.share:.0%} of {readable_bytes(self.size)}, {readable_bytes(round(self.bytes_per_s))}/s"


Tell = Callable[[Reading], None]

_TELL: ContextVar[Tell | None] = ContextVar("tell", default=None)


@contextmanager
def readings_told(tell: Tell) -> Iterator[None]:
    """Have `tell` called now and then while recordings are read in this block; what it raises is ignored."""
    before = _TELL.get()
    _TELL.set(tell)  # no token: a block inside a generator may end in another context
    try:
        yield
    finally:
        _TELL.set(before)


def followed(recording: RecordingFiles, what: str, on_read: OnRead | None) -> OnRead | None:
    """Return what a reader is to call for each read: `on_read`, and now and then whoever wants to be told.

    Args:
        recording: what is read.
        what: what for.
        on_read: called in any case.
    """
    tell = _TELL.get()
    return on_read if tell is None else _Pass(recording, what, tell, on_read)


class _Pass:
    """One pass over a recording."""

    def __init__(self, recording: RecordingFiles, what: str, tell: Tell, on_read: OnRead | None) -> None:
        self._size, self._what, self._tell, self._on_read = recording.size, what, tell, on_read
        self._positions: dict[Path, int] = {}
        self._began = time.monotonic()
        self._due = self._began + EVERY_S

    def __call__(self, path: Path, position: int, data: bytes) -> None:
        if self._on_read is not None:
            self._on_read(path, position, data)
        self._positions[path] = position
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + EVERY_S
        # A position is rough, and may be beyond the end.
        done = min(sum(self._positions.values()), self._size)
        with suppress(Exception):
            self._tell(Reading(self._what, done / max(self._size, 1), self._size, done / (now - self._began)))
