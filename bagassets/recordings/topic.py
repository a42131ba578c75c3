"""One topic of a recording: its type, and how its messages are decoded.

Messages are decoded with the definition recorded with them or, without one, with a known definition of their type. Each
topic has its own: a definition that does not parse, or that contradicts another topic's, costs that topic only.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Literal, Self

from rosbags.interfaces import Nodetype

from bagassets.base.errors import DecodeError
from bagassets.recipe.model import Limits
from bagassets.recordings.elements import check_elements
from bagassets.recordings.heads import first_head_of
from bagassets.recordings.known_types import FieldType
from bagassets.recordings.layouts import TF_NAMES, Choice, Layout, choice_of
from bagassets.recordings.model import Definition, Message, Serialization, SkimmedPacket
from bagassets.recordings.skim import HEADER, HEADER_FIELDS, PacketSkimmer, SkimmedPackets, packet_skimmer

UNKNOWN = "unknown"
"""The type of a channel without a schema."""

# Seconds, nanoseconds, length of the frame id.
_HEADS = {order: struct.Struct(f"{order}iII") for order in "<>"}
_STAMP_AT: dict[Serialization, int] = {"ros1": 0, "cdr": 4}  # with the sequence number of ROS 1
_STAMP_END = 12
_NUMBERS = {order: struct.Struct(f"{order}I") for order in "<>"}
_TIME = "builtin_interfaces/msg/Time"
_LONGEST_KEPT = 100  # bytes of a frame id; damaged messages may have any


def one_name(msgtype: str) -> str:
    """Return the name of a type that has two."""
    return TF_NAMES[0] if msgtype in TF_NAMES else msgtype


def normalise_msgtype(name: str) -> str:
    """Return `pkg/msg/Type` for a type written either way."""
    parts = " ".join(name.split()).split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else "/".join(parts)


def is_transient_local(qos: str) -> bool:
    """Tell whether offered QoS profiles (YAML) are transient local: 1 in older recordings, a word in newer ones."""
    return "durability: 1" in qos or "durability: transient_local" in qos


class RefusedBytes(bytes):
    """Placeholder for the bytes of a message that exceeds the recipe's `limits`.

    Topic digests cover what steps can see, so they cover this text, too: raising a limit makes stale what reads the
    topic, and nothing else.

    Attributes:
        reason: why the message is not decoded.
    """

    reason: str

    def __new__(cls, reason: str = "it is larger than limits.message_bytes in the recipe allows") -> Self:
        """Return a placeholder with this reason."""
        placeholder = super().__new__(cls, reason.encode())
        placeholder.reason = reason
        return placeholder


class ForeignBytes(RefusedBytes):
    """Placeholder for those of a message of another type than its topic; it says nothing about the others."""


@dataclass(frozen=True)
class TopicSource:
    """One connection of a recording: a topic, its type, and its recorded definition.

    Attributes:
        is_latched: its publisher gives its last message to whoever subscribes later.
    """

    topic: str
    msgtype: str
    count: int
    definition: Definition
    serialization: Serialization
    problem: str | None = None
    is_latched: bool = False


class Topic:
    """One topic.

    Args:
        source: the topic as the recording announces it.
        message_definitions: folders of `.msg` files, laid out as `pkg/msg/Type.msg` or `pkg/Type.msg`.
        limits: bounds on definitions and messages; by default those of an empty recipe.

    Attributes:
        source: the topic as the recording announces it.
        name: topic as recorded.
        msgtype: normalised type, `pkg/msg/Type`.
        count: number of messages that the recording announces.
        serialization: how its messages are serialized.
        problem: a clause that says why its messages cannot be decoded; None if they can.
    """

    def __init__(
        self, source: TopicSource, message_definitions: Sequence[Path] = (), limits: Limits | None = None
    ) -> None:
        self.source = source
        self.name = source.topic
        self.msgtype = source.msgtype
        self.count = source.count
        self.serialization = source.serialization
        self._own = source.definition
        self._folders = tuple(message_definitions)
        self._limits = limits or Limits()
        self._skimmers: dict[tuple[str, ...], PacketSkimmer | None] = {}
        self._refused = source.problem
        self.problem = source.problem or self._definition_problem()

    def _definition_problem(self) -> str | None:
        """Return why its messages cannot be decoded with their definition."""
        return self._layouts if isinstance(self._layouts, str) else None

    def type_of(self, recorded: str) -> str:
        """Return the type of one of its connections: its own, if it is just named otherwise or not at all."""
        is_own = recorded == UNKNOWN or one_name(recorded) == one_name(self.msgtype)
        return self.msgtype if is_own else recorded

    def decode(self, data: bytes | memoryview) -> Message:
        """Return a message as an object with the fields of its type (rosbags' classes).

        Time fields have `sec` and `nanosec`, array fields are numpy arrays.

        Raises:
            DecodeError: the bytes do not fit the type, the type is unknown, the topic has another problem, or the message
                exceeds the limits.
        """
        if isinstance(data, RefusedBytes):
            raise DecodeError(data.reason)
        layouts = self._refused or self._layouts
        if isinstance(layouts, str):
            raise DecodeError(layouts)
        return layouts.decode(data)

    def header(self, data: bytes | memoryview) -> tuple[int, str] | None:
        """Return the stamp in nanoseconds and the frame id (no leading slash) of a message, without decoding it.

        None unless the first field of the type is a header, or a sequence whose elements begin with one (TFMessage,
        MarkerArray), of which the first counts. Foxglove's types begin with the same bytes without being a header.
        """
        if self._header_at == "none" or isinstance(data, RefusedBytes):
            return None
        try:
            if self._header_at == "in an unusual header":
                return first_head_of(self.decode(data))
            return _read_header(data, self.serialization, sequence=self._header_at != "begin")
        except (struct.error, IndexError, DecodeError):
            return None  # too short to hold a header

    def unstamped(self, data: bytes | memoryview) -> bytes | None:
        """Return a message without number and stamp of its header: where this is the same, nothing else differs.

        None unless the first field of the type is a header, and there is one layout of it.
        """
        if self._header_at != "begin" or self.is_ambiguous or isinstance(data, RefusedBytes):
            return None
        # Of ROS 1: seq, stamp; of CDR: encapsulation, which has the byte order, and stamp.
        return bytes(data[: _STAMP_AT[self.serialization]]) + bytes(data[_STAMP_END:])

    def packet(self, data: bytes | memoryview, payloads: tuple[str, ...]) -> SkimmedPacket | None:
        """Return header and bytes of a packet without decoding its message; None if the message must be decoded.

        Args:
            data: the message.
            payloads: possible names of the field that holds the packet.
        """
        skimmer = self._skimmer(payloads)
        return None if skimmer is None or isinstance(data, RefusedBytes) else skimmer.one(data)

    def packets(self, messages: Sequence[bytes], payloads: tuple[str, ...]) -> SkimmedPackets | None:
        """Return header and bytes of the packets in messages, as `packet`; None if the messages are not alike, too."""
        skimmer = self._skimmer(payloads)
        refused = skimmer is None or any(isinstance(data, RefusedBytes) for data in messages)
        return None if skimmer is None or refused else skimmer.alike(messages)

    def _skimmer(self, payloads: tuple[str, ...]) -> PacketSkimmer | None:
        if payloads not in self._skimmers:
            layout = None if self.is_ambiguous or self._refused else self.layout
            self._skimmers[payloads] = None if layout is None else packet_skimmer(layout, payloads)
        return self._skimmers[payloads]

    @property
    def has_definition(self) -> bool:
        """True if a definition was recorded with the messages, or assumed."""
        return self._own.format != "none" and bool(self._own.text)

    @property
    def definition(self) -> Definition:
        """The definition that messages are decoded with, wherever it is from.

        A recorded definition is returned unchanged; any other as text that does not depend on installed packages. Where
        several layouts are possible, it is the one that fitted best so far.
        """
        layout = self.layout
        if self.has_definition or layout is None:
            return self._own
        return Definition("msg", layout.text)

    def assume(self, definition: Definition) -> None:
        """Use the definition that an earlier pass found, unless one was recorded."""
        if not self.has_definition and definition.text:
            self._own = definition
            self._skimmers.clear()
            for name in ("_layouts", "_header_at"):
                self.__dict__.pop(name, None)

    @property
    def layout(self) -> Layout | None:
        """The layout that fitted the messages decoded so far best; None if there is none."""
        return None if isinstance(self._layouts, str) else self._layouts.best

    @property
    def layout_digest(self) -> str:
        """Digest of `layout`; empty without one."""
        return "" if self.layout is None else self.layout.digest

    @property
    def is_ambiguous(self) -> bool:
        """True if several layouts are possible, which only the bytes of messages tell apart."""
        return isinstance(self._layouts, Choice) and len(self._layouts.layouts) > 1

    @property
    def large_bytes(self) -> int:
        """The message size in bytes from which `refusal` has to be asked."""
        most_bytes = self._limits.message_bytes
        if isinstance(self._layouts, str):
            return most_bytes
        large = [one.fewest_bytes(self._limits.message_elements) for one in self._layouts.layouts]
        return min([most_bytes, *(size for size in large if size is not None)])

    def refusal(self, data: bytes | memoryview) -> str | None:
        """Return why a message exceeds the limits and must not be decoded; None if it does not."""
        if len(data) > self._limits.message_bytes:
            return "it is larger than limits.message_bytes in the recipe allows"
        if isinstance(self._layouts, str):
            return None
        try:
            for one in self._layouts.layouts:
                most = self._limits.message_elements
                check_elements(one.types, one.msgtype, one.serialization, data, most)
        except DecodeError as err:
            return str(err)
        return None

    @cached_property
    def _layouts(self) -> Choice | str:
        """The possible layouts of messages, or the reason why there are none."""
        return choice_of(self.msgtype, self.serialization, self._own, self._folders, self._limits)

    @cached_property
    def _header_at(self) -> Literal["none", "begin", "begin of first element", "in an unusual header"]:
        """Where the header is in a message.

        A recording may define `std_msgs/Header` as it likes: in ROS 1 without `seq`, say, if it was converted from ROS 2.
        """
        layout = self.layout
        first = None if layout is None else _first_field(layout, self.msgtype)
        if layout is None or first is None:
            return "none"
        elements = first[0] == Nodetype.SEQUENCE and first[1][0][0] == Nodetype.NAME
        msgtype = first[1][0][1] if elements else self.msgtype
        if _first_field(layout, msgtype) == (Nodetype.NAME, HEADER):
            if [name for name, _ in layout.types[HEADER][1]] != HEADER_FIELDS.get(self.serialization):
                return "in an unusual header"
        elif not self._begins_like_one(layout, msgtype):
            return "none"
        return "begin of first element" if elements else "begin"

    def _begins_like_one(self, layout: Layout, msgtype: str) -> bool:
        """Tell whether a type begins with `timestamp` and the text of a frame, which in CDR are the bytes of a header."""
        fields = layout.types[msgtype][1][:2]
        names = tuple(name for name, _ in fields)
        kinds = [kind for _, kind in fields]
        return (
            self.serialization == "cdr"
            and names in {("timestamp", "frame_id"), ("timestamp", "parent_frame_id")}
            and kinds[0] == (Nodetype.NAME, _TIME)
            and kinds[1] == (Nodetype.BASE, ("string", 0))
        )


def _first_field(layout: Layout, msgtype: str) -> FieldType | None:
    fields = layout.types[msgtype][1]
    return fields[0][1] if fields else None


def _read_header(
    data: bytes | memoryview, serialization: Serialization, *, sequence: bool
) -> tuple[int, str] | None:
    if serialization == "ros1":
        head, number, at = _HEADS["<"], _NUMBERS["<"], 0
    else:
        order = "<" if data[1] & 1 else ">"
        head, number, at = _HEADS[order], _NUMBERS[order], 4
    if sequence:
        (count,) = number.unpack_from(data, at)
        at += 4
        if count == 0:
            return None
    if serialization == "ros1":
        at += 4  # seq
    seconds, nanoseconds, length = head.unpack_from(data, at)
    at += head.size
    text = bytes(data[at : at + length])
    frame = _kept_frame(text) if length <= _LONGEST_KEPT else _frame(text)
    return seconds * 1_000_000_000 + nanoseconds, frame


def _frame(text: bytes) -> str:
    return text.rstrip(b"\0").decode("utf-8", "replace").lstrip("/")


_kept_frame = lru_cache(maxsize=256)(_frame)
