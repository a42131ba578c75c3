"""An open recording of any file format: its topics, its messages in order, and views of some of its topics."""

import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from heapq import heappop, heappush, heapreplace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Generic, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import BagAssetsError
from bagassets.recipe.model import Limits
from bagassets.recordings.damage import DamageError, damage_passed_over, unreadable
from bagassets.recordings.merge_topics import merge_topics
from bagassets.recordings.model import Format, Message, OnRead, RawMessage
from bagassets.recordings.rewinds import Rewind, find_rewind, join_in_order
from bagassets.recordings.salvage.damage_map import Damage
from bagassets.recordings.topic import ForeignBytes, RefusedBytes, Topic, TopicSource

if TYPE_CHECKING:
    from bagassets.recordings.database_file import Database
    from bagassets.recordings.mcap_file import McapFile
    from bagassets.recordings.rosbag1 import IndexReader

_BYTES = (bytes, memoryview, bytearray)
_FIRST_NS, _LAST_NS = -(2**63), 2**63 - 1
_MESSAGE = partial(tuple.__new__, RawMessage)  # in a third of the time

T = TypeVar("T")


class Recording(ABC):
    """An open recording; subclasses read one file format each. Close it, or use it as a context manager.

    Args:
        path: the bag file, or the folder of a ROS 2 bag.
        file_format: the format of its files.
        topics: its topics, sorted by name.

    Attributes:
        repeated: topic -> messages that were left out as repeated by the recorder, in the last pass.
        damage: what is damaged, if it is read all the same; complete after a pass over all topics.
    """

    def __init__(self, path: Path, file_format: Format, topics: Mapping[str, Topic]) -> None:
        self.path = path
        self.format = file_format
        self.topics = topics
        self.repeated: Counter[str] = Counter()
        self.damage: Damage | None = None

    @abstractmethod
    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of `topics`, which the recording has, in order of log time, with the types of their connections."""

    @property
    def files(self) -> Sequence["Database | McapFile | IndexReader"]:
        """The open files that it is read from in their order."""
        return ()

    def close(self) -> None:  # noqa: B027  (a pack is open during reads only, and a view belongs to whoever opened it)
        """Close the files."""

    def _carrying(
        self, topics: Collection[str], sources: Mapping[int, TopicSource]
    ) -> dict[int, tuple[str, str]]:
        """Return connection -> topic and type, of those of `sources` that carry `topics`."""
        return {
            number: (source.topic, self.topics[source.topic].type_of(source.msgtype))
            for number, source in sources.items()
            if source.topic in topics
        }

    def span_ns(self) -> tuple[int, int] | None:
        """Return first and last log time, if the recording is one file with messages, and says so."""
        return None

    def rewind(self) -> Rewind | None:
        """Return where log times go back in the order in which the recording was written."""
        with damage_passed_over(self.path):  # of what reading messages does not need
            return find_rewind(join_in_order(_log_times_of(file) for file in self.files))
        return None

    def check_content(self) -> None:  # noqa: B027  (most formats have no checksums, or always verify them)
        """Verify checksums while messages are read, if the format has any and verifying them costs time."""

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of `topics` in order of log time, in one pass over the file.

        Raises:
            KeyError: a topic is not in the recording.
            RecordingError: the file turns out to be damaged.
        """
        unknown = sorted(set(topics) - self.topics.keys())
        if unknown:
            raise KeyError(f"topic {unknown[0]} is not in {self.path} or was not declared by the step")
        return self._guarded(topics) if topics else iter(())

    def decode(self, message: RawMessage) -> Message:
        """Return a message of any topic as an object; see `Topic.decode`.

        Raises:
            DecodeError: as `Topic.decode`.
        """
        return self.topics[message.topic].decode(message.data)

    def restrict(self, topics: Collection[str]) -> "Recording":
        """Return a view of `topics` only, so that a step cannot read what it did not declare."""
        return RestrictedRecording(self, topics)

    def _guarded(self, topics: Collection[str]) -> Iterator[RawMessage]:
        # Only the reader runs in here: exceptions of the consumer do not enter a generator.
        try:
            # Nearly all messages are as usual, which is seen without a call: there are thousands a second.
            usual = {topic: (self.topics[topic].msgtype, self.topics[topic].large_bytes) for topic in topics}
            for message in self._read(topics):
                topic, msgtype, log_time_ns, data = message
                its_type, most = usual[topic]
                is_usual = type(log_time_ns) is int and type(data) in _BYTES and msgtype == its_type
                if is_usual and len(data) <= most and _FIRST_NS <= log_time_ns <= _LAST_NS:
                    yield message
                else:
                    yield self._checked(message, most)
        except BagAssetsError:
            raise
        except Exception as err:  # whatever the libraries raise: see `unreadable`
            raise unreadable(self.path, err) from err

    def _checked(self, message: RawMessage, large_bytes: int) -> RawMessage:
        """Return a message, or a placeholder for one that exceeds the limits, or is not of the type of its topic."""
        # From damaged bytes SQLite may return values of any type.
        if not isinstance(message.log_time_ns, int) or not isinstance(message.data, _BYTES):
            raise DamageError(f"a message of {message.topic} has no time or no bytes")
        if not _FIRST_NS <= message.log_time_ns <= _LAST_NS:
            raise DamageError(f"a message of {message.topic} has no possible time")
        topic = self.topics[message.topic]
        if message.msgtype != topic.msgtype:
            refused = ForeignBytes(f"it is {message.msgtype}, and most on its topic are {topic.msgtype}")
            return message._replace(msgtype=topic.msgtype, data=refused)
        if len(message.data) <= large_bytes:
            return message
        reason = topic.refusal(message.data)
        return message if reason is None else message._replace(data=RefusedBytes(reason))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class How(NamedTuple):
    """How recordings are opened.

    Attributes:
        message_definitions: folders of `.msg` files for types that a recording does not define.
        limits: bounds on sizes.
        on_read: called with how far reading has come; it must not raise.
    """

    message_definitions: Sequence[Path]
    limits: Limits
    on_read: OnRead | None


F = TypeVar("F", bound="Database | McapFile | IndexReader")


class FileRecording(Recording, Generic[F]):
    """A recording of one file, which is closed with it, or if it has no topics that can be.

    Args:
        path: the file.
        file_format: its format.
        file: the open file.
        how: how it was opened.
    """

    def __init__(self, path: Path, file_format: Format, file: F, how: How) -> None:
        self._file = file
        try:
            self._sources = file.sources(file.counts())
            topics = merge_topics(path, self._sources.values(), how.message_definitions, how.limits)
            super().__init__(path, file_format, topics)
        except BaseException:
            file.close()
            raise

    @property
    def files(self) -> tuple[F, ...]:
        """The open file."""
        return (self._file,)

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        wanted = self._carrying(topics, self._sources)
        for connection, log_time_ns, data in self._file.messages(wanted.keys()):
            topic, msgtype = wanted[connection]
            yield _MESSAGE((topic, msgtype, log_time_ns, data))

    def span_ns(self) -> tuple[int, int] | None:
        """Return first and last log time, as its index says."""
        return self._file.span_ns()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def merged(streams: Sequence[tuple[int, int, Iterator[T]]], time_of: Callable[[T], int]) -> Iterator[T]:
    """Yield what several streams yield in order of time; at the same time, that of the stream with the smallest number first.

    Args:
        streams: time at which each begins at the earliest, its number, and itself, in order of time and number. Each is begun
            when the others have come that far.
        time_of: returns the time of one of their items.
    """
    # Those that are being read, with their next items.
    reading: list[tuple[int, int, T, Iterator[T]]] = []
    begins = [*(start for start, _, _ in streams), math.inf]
    for (_, number, begun), due in zip(streams, begins[1:], strict=True):
        for first in islice(begun, 1):
            heappush(reading, (time_of(first), number, first, begun))
        while reading and reading[0][0] < due:
            _, its_number, item, stream = reading[0]
            yield item
            if (following := next(stream, None)) is None:
                heappop(reading)
            else:
                heapreplace(reading, (time_of(following), its_number, following, stream))


def _log_times_of(file: "Database | McapFile | IndexReader") -> dict[str, NDArray[np.int64]]:
    """Return topic -> (N,) log times as they were written, of topics that one connection carries."""
    sources, times = file.sources(), file.log_times_as_written()
    connections = Counter(sources[number].topic for number in times)
    return {
        source.topic: times[number]
        for number, source in sources.items()
        if connections[source.topic] == 1 and number in times
    }


class RestrictedRecording(Recording):
    """A view of a recording with the topics that a step declared; closing it closes nothing."""

    def __init__(self, inner: Recording, topics: Collection[str]) -> None:
        wanted = set(topics)
        super().__init__(
            inner.path, inner.format, {name: topic for name, topic in inner.topics.items() if name in wanted}
        )
        self._inner = inner

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        return self._inner.messages(topics)

    def _guarded(self, topics: Collection[str]) -> Iterator[RawMessage]:
        return self._read(topics)  # the inner recording checks each message
