"""Small messages that the inventory packs while it reads, so that other assets need not read the recording."""

from collections.abc import Iterable
from operator import itemgetter

from bagassets.decode.registry import bulk_types
from bagassets.recordings.model import RawMessage
from bagassets.recordings.topic import RefusedBytes

# Network packets are bulk if they are large (see `bulk_types`): a lidar's have 1200 bytes, a navigation system's 72.
MOST_PACKET_BYTES = 512
MOST_MEAN_BYTES = 64 * 1024
MOST_TOPIC_BYTES = 64 * 1024 * 1024
# For all topics together, including the overhead of each message.
MOST_BYTES = 400_000_000
_OVERHEAD_BYTES = 250


class KeptMessages:
    """Messages of topics; a topic is dropped when it turns out to be bulk, has refused messages, or all take too much memory.

    Args:
        topics: topics that may be kept.
    """

    def __init__(self, topics: Iterable[str]) -> None:
        self._kept: dict[str, list[tuple[int, RawMessage]]] = {name: [] for name in topics}
        self._bytes = dict.fromkeys(self._kept, 0)
        self._held_bytes = 0
        self._packets = bulk_types("large")

    @property
    def topics(self) -> set[str]:
        """The topics that are kept."""
        return set(self._kept)

    def add(self, number: int, message: RawMessage) -> None:
        """Add the next message of a recording, which has this number."""
        name = message.topic
        messages = self._kept.get(name)
        if messages is None:
            return
        if isinstance(message.data, RefusedBytes):  # the recording itself says why
            self._drop(name)
            return
        messages.append((number, message._replace(data=bytes(message.data))))
        self._bytes[name] += len(message.data)
        self._held_bytes += len(message.data) + _OVERHEAD_BYTES
        large = message.msgtype in self._packets and self._bytes[name] > MOST_PACKET_BYTES * len(messages)
        if large or self._bytes[name] > MOST_TOPIC_BYTES:
            self._drop(name)
        while self._held_bytes > MOST_BYTES:
            self._drop(max(self._kept, key=lambda kept: (self._size(kept), kept)))

    def in_order(self) -> list[RawMessage]:
        """Return the kept messages in order, without topics of large messages, however few they are."""
        for name, messages in list(self._kept.items()):
            if self._bytes[name] > MOST_MEAN_BYTES * len(messages):
                self._drop(name)
        entries = (entry for messages in self._kept.values() for entry in messages)
        return [message for _, message in sorted(entries, key=itemgetter(0))]

    def _size(self, name: str) -> int:
        return self._bytes[name] + _OVERHEAD_BYTES * len(self._kept[name])

    def _drop(self, name: str) -> None:
        self._held_bytes -= self._size(name)
        del self._kept[name]
