"""Decoding serialized messages with the definitions that came with them, or with what is known.

Each message type gets a type store of its own, made from its own definition: a definition that
does not parse, or that contradicts another topic's, costs that topic only.
"""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype

from bagassets.bags.inventory import Definition
from bagassets.bags.layouts import Choice, Layout, Serialization, choice_of
from bagassets.bags.model import SkimmedPacket
from bagassets.bags.skim import HEADER, Skimmer, packet_skimmer
from bagassets.errors import DecodeError
from bagassets.recipe.model import Limits

__all__ = ["MessageTypes", "Serialization", "normalise_msgtype"]


def normalise_msgtype(name: str) -> str:
    """Return `pkg/msg/Type` for a type written either way."""
    parts = " ".join(name.split()).split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else "/".join(parts)


class MessageTypes:
    """The message types of one recording.

    Args:
        serialization: how payloads are serialized.
        definitions: type -> the definition that came with the recording.
        message_definitions: folders of `.msg` files, laid out as `pkg/msg/Type.msg` or `pkg/Type.msg`.
        limits: how large definitions may be, and what messages may hold; those of an empty recipe by default.
    """

    def __init__(
        self,
        serialization: Serialization,
        definitions: Mapping[str, Definition],
        message_definitions: Sequence[Path] = (),
        limits: Limits | None = None,
    ) -> None:
        self.serialization = serialization
        self._limits = limits or Limits()
        self._definitions = dict(definitions)
        self._folders = tuple(message_definitions)
        self._choices: dict[str, Choice | str] = {}
        self._headers: dict[str, str] = {}
        self._skimmers: dict[str, Skimmer | None] = {}

    def problem(self, msgtype: str) -> str | None:
        """Return why messages of a type cannot be decoded, or None."""
        choice = self._choice(msgtype)
        return choice if isinstance(choice, str) else None

    def decode(self, msgtype: str, data: bytes | memoryview) -> Any:
        """Return the message object.

        Raises:
            DecodeError: the bytes do not fit the type, or the type is not known.
        """
        choice = self._choice(msgtype)
        if isinstance(choice, str):
            raise DecodeError(choice)
        return choice.decode(data)

    def has_definition(self, msgtype: str) -> bool:
        """Tell whether a definition came with the messages of a type, or was assumed."""
        own = self._definitions.get(msgtype)
        return own is not None and own.format != "none" and bool(own.text)

    def assume(self, msgtype: str, definition: Definition) -> None:
        """Decode a type that came without definition as it was found to be laid out before."""
        if not self.has_definition(msgtype) and definition.text:
            self._definitions[msgtype] = definition
            self._choices.pop(msgtype, None)
            self._headers.pop(msgtype, None)
            self._skimmers.pop(msgtype, None)

    def definition(self, msgtype: str) -> Definition:
        """Return what messages of a type are decoded with, wherever it came from.

        A recording's own definition as it is; any other as text that holds without what is
        installed here. Where several layouts are possible it is the one that fitted best so far.
        """
        own = self._definitions.get(msgtype, Definition("none", ""))
        layout = self.layout(msgtype)
        if self.has_definition(msgtype) or layout is None:
            return own
        return Definition("msg", layout.text)

    def layout(self, msgtype: str) -> Layout | None:
        """Return how messages of a type are laid out, as far as those decoded so far tell; None if not known."""
        choice = self._choice(msgtype)
        return None if isinstance(choice, str) else choice.best

    def is_ambiguous(self, msgtype: str) -> bool:
        """Tell whether messages may be laid out in several ways, which only their bytes tell apart."""
        choice = self._choice(msgtype)
        return isinstance(choice, Choice) and len(choice.layouts) > 1

    def header(self, msgtype: str, data: bytes | memoryview) -> tuple[int, str] | None:
        """Return stamp in nanoseconds and frame id from the bytes of a message, without decoding it.

        Known for types whose first field is a header, or a sequence of elements that begin with
        one (TFMessage, MarkerArray), of which the first counts; else None.
        """
        layout = self._headers.get(msgtype)
        if layout is None:
            layout = self._headers[msgtype] = self._where_header(msgtype)
        if layout == "none":
            return None
        try:
            return _read_header(data, self.serialization, sequence=layout == "sequence")
        except (struct.error, IndexError):
            return None  # too short to hold a header

    def packet(self, msgtype: str, data: bytes | memoryview, payloads: Sequence[str]) -> SkimmedPacket | None:
        """Return what is asked of a packet message, without decoding it; None if only decoding tells.

        Args:
            msgtype: type of the message.
            data: its bytes.
            payloads: names that the field with the packet may have; the same in every call.
        """
        if msgtype not in self._skimmers:
            layout = None if self.is_ambiguous(msgtype) else self.layout(msgtype)
            self._skimmers[msgtype] = None if layout is None else packet_skimmer(layout, payloads)
        skim = self._skimmers[msgtype]
        return None if skim is None else skim(data)

    def large_bytes(self, msgtype: str) -> int:
        """Return from what size on messages of a type are looked into by `refusal`."""
        choice = self._choice(msgtype)
        most_bytes = self._limits.message_bytes
        if isinstance(choice, str):
            return most_bytes
        large = [layout.large_bytes(self._limits.message_elements) for layout in choice.layouts]
        return min([most_bytes, *(size for size in large if size is not None)])

    def refusal(self, msgtype: str, data: bytes | memoryview) -> str | None:
        """Return why a message must not be decoded: it is too large, or holds too much; None if it may be."""
        if len(data) > self._limits.message_bytes:
            return "it is larger than limits.message_bytes in the recipe allows"
        choice = self._choice(msgtype)
        if isinstance(choice, str):
            return None
        try:
            for layout in choice.layouts:
                layout.check_elements(data, self._limits.message_elements)
        except DecodeError as err:
            return str(err)
        return None

    def _where_header(self, msgtype: str) -> str:
        layout = self.layout(msgtype)
        first = None if layout is None else _first_field(layout, msgtype)
        if layout is None or first is None:
            return "none"
        if first == (Nodetype.NAME, HEADER):
            return "header"
        if first[0] == Nodetype.SEQUENCE:
            inner, _ = first[1]
            if inner[0] == Nodetype.NAME and _first_field(layout, inner[1]) == (Nodetype.NAME, HEADER):
                return "sequence"
        return "none"

    def _choice(self, msgtype: str) -> Choice | str:
        if msgtype not in self._choices:
            definition = self._definitions.get(msgtype)
            self._choices[msgtype] = choice_of(
                msgtype, self.serialization, definition, self._folders, self._limits
            )
        return self._choices[msgtype]


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
