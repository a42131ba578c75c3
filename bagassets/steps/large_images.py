"""Keeping threads from working on so many large images at a time that the memory does not suffice."""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Condition

__all__ = ["LARGE_IMAGES"]

# Of images up to this size there are as many in work as there are threads.
_SMALL_PIXELS = 12_000_000


class _Room:
    """How many pixels large images that are in work may have together."""

    def __init__(self) -> None:
        self._taken = 0
        self._changed = Condition()

    @contextmanager
    def room_for(self, pixels: int, most_pixels: int) -> Iterator[None]:
        """Wait until an image fits beside those in work, or is the only one.

        Args:
            pixels: of the image.
            most_pixels: of all large images in work together.
        """
        if pixels <= _SMALL_PIXELS:
            yield
            return
        with self._changed:
            self._changed.wait_for(lambda: not self._taken or self._taken + pixels <= most_pixels)
            self._taken += pixels
        try:
            yield
        finally:
            with self._changed:
                self._taken -= pixels
                self._changed.notify_all()


LARGE_IMAGES = _Room()
