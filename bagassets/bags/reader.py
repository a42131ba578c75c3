"""What all readers share: topics, decoding, restriction to declared topics."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from bagassets.bags.damage import DamageError, damaged
from bagassets.bags.inventory import Definition
from bagassets.bags.layouts import choice_of
from bagassets.bags.model import Format, RawMessage, SkimmedPacket, TopicInfo
from bagassets.bags.typestores import MessageTypes, Serialization
from bagassets.errors import BagAssetsError, DecodeError, SizeLimitError
from bagassets.recipe.model import Limits

__all__ = ["BaseRecording", "RefusedBytes", "RestrictedRecording", "TopicSource", "merge_topics"]

_BYTES = (bytes, memoryview, bytearray)
_FIRST_NS, _LAST_NS = -(2**63), 2**63 - 1


class RefusedBytes(bytes):
    """Stands for the bytes of a message that exceeds the recipe's `limits`; they are not handed on.

    The topic's digest is that of what a step can see: a limit that lets the message in makes stale what
    reads the topic, and nothing else.

    Attributes:
        reason: why decoding it fails.
    """

    reason: str

    def __new__(cls, reason: str = "it is larger than limits.message_bytes in the recipe allows") -> Self:
        """Make the place holder."""
        made = super().__new__(cls, reason.encode())
        made.reason = reason
        return made


@dataclass(frozen=True)
class TopicSource:
    """One connection of a recording: a topic, its type, and the definition that came with it."""

    topic: str
    msgtype: str
    count: int
    definition: Definition
    serialization: Serialization
    problem: str | None = None


class BaseRecording(ABC):
    """A recording whose messages are read by a subclass."""

    def __init__(
        self,
        path: Path,
        file_format: Format,
        sources: Iterable[TopicSource],
        message_definitions: Sequence[Path],
        limits: Limits,
    ) -> None:
        self.path = path
        self.format = file_format
        self._limits = limits
        merged = merge_topics(sources, limits)
        if len(merged) > limits.topics:
            raise SizeLimitError(
                f"{path}: it has {len(merged)} topics; if you trust the recording, raise limits.topics in the recipe."
            )
        # Topics of one type may have come with different definitions: each goes by its own.
        self._types = {
            name: MessageTypes(s.serialization, {s.msgtype: s.definition}, message_definitions, limits)
            for name, s in merged.items()
        }
        self.topics: dict[str, TopicInfo] = {}
        for name, source in sorted(merged.items()):
            problem = source.problem or self._types[name].problem(source.msgtype)
            self.topics[name] = TopicInfo(name, source.msgtype, source.count, problem)

    @abstractmethod
    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of `topics`, all known, in order of log time."""

    @abstractmethod
    def close(self) -> None:
        """Close the files."""

    def check_content(self) -> None:  # noqa: B027  (most formats have no checksums, or are always checked)
        """Check the checksums that the format has while messages are read, where that costs time."""

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of `topics` in order of log time; see `Recording`."""
        unknown = sorted(set(topics) - self.topics.keys())
        if unknown:
            raise KeyError(f"topic {unknown[0]} is not in {self.path} or was not declared by the step")
        return self._guarded(topics) if topics else iter(())

    def _guarded(self, topics: Collection[str]) -> Iterator[RawMessage]:
        # Nothing but the reader runs in here: what a consumer raises does not enter a generator.
        try:
            large = {topic: self._types[topic].large_bytes(self.topics[topic].msgtype) for topic in topics}
            for message in self._read(topics):
                yield self._checked(message, large[message.topic])
        except BagAssetsError:
            raise
        except Exception as err:  # whatever the libraries raise: see `damaged`
            raise damaged(self.path, err) from err

    def _checked(self, message: RawMessage, large_bytes: int) -> RawMessage:
        """Return a message, or its place holder if it exceeds the limits."""
        # Databases give whatever type the damaged bytes have.
        if not isinstance(message.log_time_ns, int) or not isinstance(message.data, _BYTES):
            raise DamageError(f"a message of {message.topic} has no time or no bytes")
        if not _FIRST_NS <= message.log_time_ns <= _LAST_NS:
            raise DamageError(f"a message of {message.topic} has no possible time")
        if len(message.data) <= large_bytes:
            return message
        reason = self._types[message.topic].refusal(message.msgtype, message.data)
        return message if reason is None else replace(message, data=RefusedBytes(reason))

    def decode(self, message: RawMessage) -> Any:
        """Return the message object; see `Recording`."""
        if isinstance(message.data, RefusedBytes):
            raise DecodeError(message.data.reason)
        return self._types[message.topic].decode(message.msgtype, message.data)

    def header(self, message: RawMessage) -> tuple[int, str] | None:
        """Return header stamp in nanoseconds and frame id (no leading slash), or None without header."""
        if isinstance(message.data, RefusedBytes):
            return None
        return self._types[message.topic].header(message.msgtype, message.data)

    def packet(self, message: RawMessage, payloads: Sequence[str]) -> SkimmedPacket | None:
        """Return what is asked of a packet message, without decoding it; see `Recording`."""
        if isinstance(message.data, RefusedBytes):
            return None
        return self._types[message.topic].packet(message.msgtype, message.data, payloads)

    def has_definition(self, topic: str) -> bool:
        """Tell whether a definition came with the messages of a topic."""
        return self._types[topic].has_definition(self.topics[topic].msgtype)

    def definition(self, topic: str) -> Definition:
        """Return what the messages of a topic are decoded with."""
        return self._types[topic].definition(self.topics[topic].msgtype)

    def assume(self, definitions: Mapping[str, Definition]) -> None:
        """Decode topics that came without definition with those that the inventory found to fit."""
        for topic, definition in definitions.items():
            if topic in self.topics:
                self._types[topic].assume(self.topics[topic].msgtype, definition)

    def layout_digest(self, topic: str) -> str:
        """Return a digest of how the messages of a topic are laid out; empty if that is not known."""
        layout = self._types[topic].layout(self.topics[topic].msgtype)
        return "" if layout is None else layout.digest

    def is_ambiguous(self, topic: str) -> bool:
        """Tell whether only the bytes of messages tell how those of a topic are laid out."""
        return self._types[topic].is_ambiguous(self.topics[topic].msgtype)

    def serialization(self, topic: str) -> Serialization:
        """Return how the messages of a topic are serialized."""
        return self._types[topic].serialization

    def header_stamp_ns(self, message: RawMessage) -> int | None:
        """Return the header stamp, or None without header; see `Recording`."""
        header = self.header(message)
        return None if header is None else header[0]

    def restrict(self, topics: Collection[str]) -> "RestrictedRecording":
        """Return a view that offers `topics` only."""
        return RestrictedRecording(self, topics)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class RestrictedRecording(BaseRecording):
    """A view of a recording that offers the topics a step declared; closing it closes nothing."""

    def __init__(self, inner: BaseRecording, topics: Collection[str]) -> None:
        self.path = inner.path
        self.format = inner.format
        self.topics = {name: info for name, info in inner.topics.items() if name in set(topics)}
        self._limits = inner._limits  # noqa: SLF001  (a view of the same class)
        self._types = inner._types  # noqa: SLF001  (a view of the same class)
        self._inner = inner

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        return self._inner.messages(topics)

    def close(self) -> None:
        """Do nothing: the recording belongs to whoever opened it."""


def merge_topics(sources: Iterable[TopicSource], limits: Limits) -> dict[str, TopicSource]:
    """Join the connections of each topic; a topic with two types, or two layouts of one, cannot be decoded."""
    merged: dict[str, TopicSource] = {}
    for source in sources:
        before = merged.get(source.topic)
        if before is None:
            merged[source.topic] = source
            continue
        problem = before.problem or source.problem
        if before.msgtype != source.msgtype:
            problem = f"it carries two types, {before.msgtype} and {source.msgtype}"
        elif _contradict(before, source, limits):
            problem = f"its messages were recorded with two different definitions of {source.msgtype}"
        definition = before.definition if before.definition.text else source.definition
        merged[source.topic] = replace(
            before, count=before.count + source.count, problem=problem, definition=definition
        )
    return merged


def _contradict(one: TopicSource, other: TopicSource, limits: Limits) -> bool:
    """Tell whether the same bytes would decode differently; comments make no difference."""
    if one.definition == other.definition or not one.definition.text or not other.definition.text:
        return False
    choices = [
        choice_of(source.msgtype, source.serialization, source.definition, (), limits)
        for source in (one, other)
    ]
    digests = {choice if isinstance(choice, str) else choice.best.digest for choice in choices}
    return len(digests) > 1
