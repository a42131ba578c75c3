"""What reads boxes from a type of messages.

A message is split into its items first and each item decoded by itself, so that one box that
is nonsense does not cost the others.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from bagassets.decode.model import BoxReading
from bagassets.recordings.model import Message

__all__ = ["BoxDecoder"]


@dataclass(frozen=True)
class BoxDecoder:
    """How boxes are read from one message type.

    Attributes:
        items: message -> its items in order.
        decode: (message, item) -> box; None if the item is no box at all.
            Raises DecodeError if it is a box that cannot be used. `source` of the box stays empty.
    """

    items: Callable[[Message], Iterable[Message]]
    decode: Callable[[Message, Message], BoxReading | None]
