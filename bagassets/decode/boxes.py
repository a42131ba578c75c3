"""The interface of box decoders.

A message is split into items first, and each item is decoded by itself, so that one bad box does not cost the others.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from bagassets.decode.model import BoxReading
from bagassets.recordings.model import Message

__all__ = ["BoxDecoder"]


@dataclass(frozen=True)
class BoxDecoder:
    """Reads boxes from one message type.

    Attributes:
        items: message -> its items in order.
        decode: (message, item) -> box, whose `source` stays empty; None if the item is not a box.
            Raises DecodeError for an unusable box.
    """

    items: Callable[[Message], Iterable[Message]]
    decode: Callable[[Message, Message], BoxReading | None]
