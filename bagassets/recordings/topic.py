"""One topic of a recording: what it carries, and how its messages are decoded.

Messages are decoded with the definitions that came with them, or with what is known. Each topic has a type
store of its own, made from its own definition: a definition that does not parse, or that contradicts another
topic's, costs that topic only.
"""

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

from rosbags.interfaces import Nodetype

from bagassets.errors import DecodeError, SizeLimitError
from bagassets.recipe.model import Limits
from bagassets.recordings.layouts import Choice, Layout, Serialization, choice_of
from bagassets.recordings.model import Definition, SkimmedPacket
from bagassets.recordings.skim import HEADER, Skimmer, packet_skimmer

__all__ = ["RefusedBytes", "Serialization", "Topic", "TopicSource", "merge_topics", "normalise_msgtype"]


def normalise_msgtype(name: str) -> str:
    """Return `pkg/msg/Type` for a type written either way."""
    parts = " ".join(name.split()).split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else "/".join(parts)


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


class Topic:
    """One topic.

    Args:
        source: what the recording says of it.
        message_definitions: folders of `.msg` files, laid out as `pkg/msg/Type.msg` or `pkg/Type.msg`.
        limits: how large definitions may be, and what messages may hold; those of an empty recipe by default.

    Attributes:
        name: topic as recorded.
        msgtype: normalised type, `pkg/msg/Type`.
        count: number of messages that the recording announces.
        serialization: how its messages are serialized.
        problem: why they cannot be decoded, in words; None if they can.
    """

    def __init__(
        self, source: TopicSource, message_definitions: Sequence[Path] = (), limits: Limits | None = None
    ) -> None:
        self.name = source.topic
        self.msgtype = source.msgtype
        self.count = source.count
        self.serialization = source.serialization
        self._own = source.definition
        self._folders = tuple(message_definitions)
        self._limits = limits or Limits()
        self._skimmers: dict[tuple[str, ...], Skimmer | None] = {}
        self.problem = source.problem
        if self.problem is None and isinstance(self._layouts, str):
            self.problem = self._layouts

    def decode(self, data: bytes | memoryview) -> Any:
        """Return a message as an object with the fields of its type (rosbags' classes).

        Time fields have `sec` and `nanosec`, array fields are numpy arrays.

        Raises:
            DecodeError: the bytes do not fit the type, the type is not known, or the message exceeds the limits.
        """
        if isinstance(data, RefusedBytes):
            raise DecodeError(data.reason)
        layouts = self._layouts
        if isinstance(layouts, str):
            raise DecodeError(layouts)
        return layouts.decode(data)

    def header(self, data: bytes | memoryview) -> tuple[int, str] | None:
        """Return stamp in nanoseconds and frame id (no leading slash) of a message, without decoding it.

        Known for types whose first field is a header, or a sequence of elements that begin with
        one (TFMessage, MarkerArray), of which the first counts; else None.
        """
        if self._header_at == "none" or isinstance(data, RefusedBytes):
            return None
        try:
            return _read_header(data, self.serialization, sequence=self._header_at != "begin")
        except (struct.error, IndexError):
            return None  # too short to hold a header

    def packet(self, data: bytes | memoryview, payloads: tuple[str, ...]) -> SkimmedPacket | None:
        """Return header and bytes of a packet without decoding its message; None if only decoding tells.

        Args:
            data: the message.
            payloads: names that the field with the packet may have.
        """
        if payloads not in self._skimmers:
            layout = None if self.is_ambiguous else self.layout
            self._skimmers[payloads] = None if layout is None else packet_skimmer(layout, payloads)
        skim = self._skimmers[payloads]
        return None if skim is None or isinstance(data, RefusedBytes) else skim(data)

    @property
    def has_definition(self) -> bool:
        """True if a definition came with the messages, or was assumed."""
        return self._own.format != "none" and bool(self._own.text)

    @property
    def definition(self) -> Definition:
        """What messages are decoded with, wherever it came from.

        A recording's own definition as it is; any other as text that holds without what is
        installed here. Where several layouts are possible it is the one that fitted best so far.
        """
        layout = self.layout
        if self.has_definition or layout is None:
            return self._own
        return Definition("msg", layout.text)

    def assume(self, definition: Definition) -> None:
        """Decode messages that came without definition as they were found to be laid out before."""
        if not self.has_definition and definition.text:
            self._own = definition
            self._skimmers.clear()
            for name in ("_layouts", "_header_at"):
                self.__dict__.pop(name, None)

    @property
    def layout(self) -> Layout | None:
        """How messages are laid out, as far as those decoded so far tell; None if that is not known."""
        return None if isinstance(self._layouts, str) else self._layouts.best

    @property
    def layout_digest(self) -> str:
        """Digest of how messages are laid out; empty if that is not known."""
        return "" if self.layout is None else self.layout.digest

    @property
    def is_ambiguous(self) -> bool:
        """True if messages may be laid out in several ways, which only their bytes tell apart."""
        return isinstance(self._layouts, Choice) and len(self._layouts.layouts) > 1

    @property
    def large_bytes(self) -> int:
        """From what size on messages are looked into by `refusal`."""
        most_bytes = self._limits.message_bytes
        if isinstance(self._layouts, str):
            return most_bytes
        large = [layout.large_bytes(self._limits.message_elements) for layout in self._layouts.layouts]
        return min([most_bytes, *(size for size in large if size is not None)])

    def refusal(self, data: bytes | memoryview) -> str | None:
        """Return why a message must not be decoded: it is too large, or holds too much; None if it may be."""
        if len(data) > self._limits.message_bytes:
            return "it is larger than limits.message_bytes in the recipe allows"
        if isinstance(self._layouts, str):
            return None
        try:
            for layout in self._layouts.layouts:
                layout.check_elements(data, self._limits.message_elements)
        except DecodeError as err:
            return str(err)
        return None

    @cached_property
    def _layouts(self) -> Choice | str:
        """The layouts that messages may have, or why there are none."""
        return choice_of(self.msgtype, self.serialization, self._own, self._folders, self._limits)

    @cached_property
    def _header_at(self) -> Literal["none", "begin", "begin of first element"]:
        """Where the header of a message is."""
        layout = self.layout
        first = None if layout is None else _first_field(layout, self.msgtype)
        if layout is None or first is None:
            return "none"
        if first == (Nodetype.NAME, HEADER):
            return "begin"
        if first[0] == Nodetype.SEQUENCE:
            inner, _ = first[1]
            if inner[0] == Nodetype.NAME and _first_field(layout, inner[1]) == (Nodetype.NAME, HEADER):
                return "begin of first element"
        return "none"


def merge_topics(
    path: Path, sources: Iterable[TopicSource], message_definitions: Sequence[Path], limits: Limits
) -> dict[str, Topic]:
    """Return the topics of a recording, sorted by name.

    Args:
        path: the recording, for messages.
        sources: its connections, several of which may be of one topic. A topic with two types, or two layouts of
            one, cannot be decoded.
        message_definitions: as for `Topic`.
        limits: as for `Topic`.

    Raises:
        SizeLimitError: there are more than the limits allow.
    """
    merged: dict[str, TopicSource] = {}
    for source in sources:
        before = merged.get(source.topic)
        merged[source.topic] = source if before is None else _joined(before, source, limits)
    if len(merged) > limits.topics:
        raise SizeLimitError(
            f"{path}: it has {len(merged)} topics; if you trust the recording, raise limits.topics in the recipe."
        )
    # Topics of one type may have come with different definitions: each goes by its own.
    return {name: Topic(source, message_definitions, limits) for name, source in sorted(merged.items())}


def _joined(one: TopicSource, other: TopicSource, limits: Limits) -> TopicSource:
    problem = one.problem or other.problem
    if one.msgtype != other.msgtype:
        problem = f"it carries two types, {one.msgtype} and {other.msgtype}"
    elif _contradict(one, other, limits):
        problem = f"its messages were recorded with two different definitions of {other.msgtype}"
    definition = one.definition if one.definition.text else other.definition
    return replace(one, count=one.count + other.count, problem=problem, definition=definition)


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


def _first_field(layout: Layout, msgtype: str) -> Any:
    fields = layout.types[msgtype][1]
    return fields[0][1] if fields else None


def _read_header(
    data: bytes | memoryview, serialization: Serialization, *, sequence: bool
) -> tuple[int, str] | None:
    if serialization == "ros1":
        order, at = "<", 0
    else:
        order, at = ("<" if data[1] & 1 else ">"), 4
    if sequence:
        (count,) = struct.unpack_from(f"{order}I", data, at)
        at += 4
        if count == 0:
            return None
    if serialization == "ros1":
        at += 4  # seq
    seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", data, at)
    frame = bytes(data[at + 12 : at + 12 + length]).rstrip(b"\0").decode("utf-8", "replace")
    return seconds * 1_000_000_000 + nanoseconds, frame.lstrip("/")
