"""Opening the recording that a step reads, unchanged; whoever waits learns now and then how far reading has come."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from bagassets.base.errors import BagAssetsError
from bagassets.base.quantities import readable_bytes
from bagassets.recipe.model import Limits
from bagassets.recordings.digest import RecordingStat, assert_unchanged
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.model import OnRead, RecordingFiles
from bagassets.recordings.open import open_recording
from bagassets.recordings.recording import Recording


@dataclass(frozen=True)
class MessageSource:
    """Opens a recording, and sees that it stays as it was when its digest was taken.

    Attributes:
        files: those of the recording.
        stat: sizes and times of its files when its digest was taken.
        message_definitions: folders of `.msg` files.
        limits: limits on the memory that reading may take.
        on_read: called with how far reading has come; see `open_recording`.
        what: what the whole recording is read for, for those who wait.
    """

    files: RecordingFiles
    stat: RecordingStat
    message_definitions: Sequence[Path]
    limits: Limits
    on_read: OnRead | None = None
    what: str = "images and clouds"

    def verify_unchanged(self) -> None:
        """Check that the recording is still the one that was digested.

        Raises:
            ChangedWhileReadError: it has changed; what was read from it must not be recorded.
        """
        assert_unchanged(self.files, self.stat)

    @contextmanager
    def whole(self, inventory: Inventory | None = None, *, salvaged: bool = False) -> Iterator[Recording]:
        """Open the whole recording, and check before and after that it did not change.

        Args:
            inventory: has the definitions for topics that lack one in the recording; None to look for them.
            salvaged: read what can be read of a damaged recording, as is done if the inventory says that it is.
        """
        self.verify_unchanged()
        opener = open_recording
        if salvaged or (inventory is not None and inventory.damage is not None):
            from bagassets.recordings.salvage.open import open_salvaged as opener  # noqa: PLC0415  (few are damaged)
        on_read = followed(self.files, self.what, self.on_read)
        try:
            with opener(self.files, self.message_definitions, self.limits, on_read) as recording:
                if inventory is not None:
                    for name, topic in recording.topics.items():
                        if name in inventory.topics:
                            topic.assume(inventory.topics[name].definition)
                yield recording
        except BagAssetsError:
            self.verify_unchanged()  # if it changed, that is the cause to report
            raise
        self.verify_unchanged()


# --- how far reading has come ------------------------------------------------------------

EVERY_S = 10.0
"""Time before the first report and between two; a read that takes less is not reported."""


@dataclass(frozen=True)
class Progress:
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


Tell = Callable[[Progress], None]

_TELL: ContextVar[Tell | None] = ContextVar("tell", default=None)


@contextmanager
def progress_told(tell: Tell) -> Iterator[None]:
    """Have `tell` called now and then while recordings are read in this block; what it raises is ignored."""
    before = _TELL.get()
    _TELL.set(tell)  # no token: a block inside a generator may end in another context
    try:
        yield
    finally:
        _TELL.set(before)


def tell_progress(reading: Progress) -> None:
    """Tell whoever wants to be told."""
    told = _TELL.get()
    if told is not None:
        with suppress(Exception):
            told(reading)


def followed(recording: RecordingFiles, what: str, on_read: OnRead | None) -> OnRead | None:
    """Return what a reader is to call for each read: `on_read`, and now and then whoever wants to be told.

    Args:
        recording: what is read.
        what: what for.
        on_read: called in any case.
    """
    tell = _TELL.get()
    if tell is None:
        return on_read
    positions: dict[Path, int] = {}
    began = time.monotonic()
    due = began + EVERY_S

    def read(path: Path, position: int, data: bytes) -> None:
        nonlocal due
        if on_read is not None:
            on_read(path, position, data)
        positions[path] = position
        now = time.monotonic()
        if now < due:
            return
        due = now + EVERY_S
        # A position is rough, and may be beyond the end.
        done = min(sum(positions.values()), recording.size)
        with suppress(Exception):
            tell(Progress(what, done / max(recording.size, 1), recording.size, done / (now - began)))

    return read
