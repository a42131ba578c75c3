"""Counting the strings and nested messages ("elements") in a message's bytes, before objects are made of them.

A message of a few megabytes may announce millions of objects, a hundred times its size; a list whose elements have no
fields announces billions in four bytes.
"""

import sys
from collections.abc import Iterator
from struct import Struct, error

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Fielddefs

from bagassets.base.errors import DecodeError
from bagassets.recordings.known_types import FieldType, Types
from bagassets.recordings.model import Serialization

SIZES = {
    **dict.fromkeys(("bool", "byte", "char", "octet", "int8", "uint8"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int32", "uint32", "float32"), 4),
    **dict.fromkeys(("int64", "uint64", "float64"), 8),
    "float128": 16,
}
"""Bytes of each primitive type but strings."""

_COUNT = {"<": Struct("<I"), ">": Struct(">I")}
# rosbags' name for the field that C++ adds to empty messages; ROS 1 does not serialize it.
_FILLER = "structure_needs_at_least_one_member"
_NO_FIELDS: Fielddefs = [(_FILLER, (Nodetype.BASE, ("uint8", 0)))]


def announced_elements(types: Types, msgtype: str) -> int:
    """Return how many strings and messages every message of a type has, those in variable-length lists aside.

    Raises:
        ValueError: the type contains itself, or an array has a negative length.
    """
    return _Elements(types, "cdr").fixed(msgtype)


def fewest_bytes_of(
    types: Types, msgtype: str, serialization: Serialization, most_elements: int
) -> int | None:
    """Return the smallest size at which a message can hold more than `most_elements`; None if none can.

    Raises:
        ValueError: as for `announced_elements`.
    """
    elements = _Elements(types, serialization)
    left = most_elements - elements.fixed(msgtype)
    items = [elements.of_item(item) for item in elements.list_items(msgtype)]
    densities = [number / size if size else float("inf") for number, size in items]
    if not densities:
        return None
    return int(max(0, left) / max(densities))


def check_elements(
    types: Types, msgtype: str, serialization: Serialization, data: bytes | memoryview, most_elements: int
) -> None:
    """Check the number of elements in a message.

    Raises:
        DecodeError: there are more than `most_elements`, or its bytes do not fit the type.
    """
    try:
        _Walk(types, serialization, data, most_elements).message(msgtype)
    except (error, IndexError) as err:
        raise DecodeError(f"its bytes do not fit {msgtype}") from err


def padded_end(types: Types, msgtype: str, data: bytes | memoryview) -> int | None:
    """Return where a message in CDR ends whose bytes are as many as Fast DDS estimates for it; None if they are not.

    `serialize_message` of rclpy and rclcpp (`rmw_serialize` of rmw_fastrtps) takes the estimate for the length. It has gaps for
    the items of empty lists, too, so behind the message is whatever was in memory.
    """
    try:
        walk = _Walk(types, "cdr", data, sys.maxsize)
        walk.message(msgtype)
    except (error, IndexError):
        return None
    return walk.end + 4 if 0 <= len(data) - 4 - walk.estimate < 4 else None


class _Elements:
    """The least number of elements and bytes of each type in a definition."""

    def __init__(self, types: Types, serialization: Serialization) -> None:
        self._types = types
        self._ros1 = serialization == "ros1"
        self._known: dict[str, tuple[int, int]] = {}
        self._fields: dict[str, Fielddefs] = {}
        self._open: list[str] = []

    def fields_of(self, msgtype: str) -> Fielddefs:
        """Return the fields of a type that are serialized: of one without any, a byte in CDR."""
        if msgtype not in self._fields:
            fields = self._types[msgtype][1] or _NO_FIELDS
            self._fields[msgtype] = [field for field in fields if not (self._ros1 and field[0] == _FILLER)]
        return self._fields[msgtype]

    def fixed(self, msgtype: str) -> int:
        """Return the number of strings and messages in a type, those in lists aside."""
        return self._of_type(msgtype)[0]

    def of_item(self, description: FieldType) -> tuple[int, int]:
        """Return the least number of elements and of bytes of a field or list item."""
        kind, inner = description
        if kind == Nodetype.BASE:
            return (1, 4) if inner[0] == "string" else (0, SIZES.get(inner[0], 1))
        if kind == Nodetype.NAME:
            elements, size = self._of_type(inner)
            return elements + 1, size
        item, length = inner
        if kind == Nodetype.SEQUENCE:
            self.of_item(item)  # raises if the item's type is impossible
            return 0, 4
        if length < 0:
            msg = f"an array of {length} elements"
            raise ValueError(msg)
        elements, size = self.of_item(item)
        return elements * length, size * length

    def list_items(self, msgtype: str) -> Iterator[FieldType]:
        """Yield the items of all lists of strings and messages in a type."""
        seen, waiting = set(), [msgtype]
        while waiting:
            name = waiting.pop()
            if name in seen:
                continue
            seen.add(name)
            for _, (kind, inner) in self._types[name][1]:
                item: FieldType = inner[0] if kind in {Nodetype.ARRAY, Nodetype.SEQUENCE} else (kind, inner)
                if item[0] == Nodetype.NAME:
                    waiting.append(item[1])
                if kind == Nodetype.SEQUENCE and (item[0] == Nodetype.NAME or item[1][0] == "string"):
                    yield item

    def _of_type(self, msgtype: str) -> tuple[int, int]:
        if msgtype not in self._known:
            if msgtype in self._open:
                msg = f"{msgtype} contains itself"
                raise ValueError(msg)
            self._open.append(msgtype)
            elements = size = 0
            for _, description in self.fields_of(msgtype):
                more, bytes_ = self.of_item(description)
                elements, size = elements + more, size + bytes_
            self._open.pop()
            self._known[msgtype] = elements, size
        return self._known[msgtype]


class _Walk:
    """Walks the bytes of one message and counts its elements.

    Attributes:
        end: where it is, behind the encapsulation of CDR.
        estimate: where it would be if the items of empty lists were aligned, too.
    """

    def __init__(
        self, types: Types, serialization: Serialization, data: bytes | memoryview, most_elements: int
    ) -> None:
        self._ros1 = serialization == "ros1"
        self._data = data if self._ros1 else data[4:]
        self._count = _COUNT["<" if self._ros1 or data[1] & 1 else ">"]
        self._left = most_elements
        self.end = self.estimate = 0
        self._fewest = _Elements(types, serialization)

    def message(self, msgtype: str) -> None:
        for _, description in self._fewest.fields_of(msgtype):
            self._field(*description)

    def _field(self, kind: FieldType, inner: FieldType) -> None:
        if kind == Nodetype.BASE:
            if inner[0] == "string":
                self._take_one()
                self._skip(self._number(), 1)
            else:
                self._skip(1, SIZES.get(inner[0], 1))
        elif kind == Nodetype.NAME:
            self._take_one()
            self.message(inner)
        else:
            item, length = inner
            number = length if kind == Nodetype.ARRAY else self._number()
            if item[0] == Nodetype.BASE and item[1][0] != "string":
                self._skip(number, SIZES.get(item[1][0], 1))
                return
            self._require(number * self._fewest.of_item(item)[0])
            for _ in range(number):
                self._field(*item)

    def _take_one(self) -> None:
        self._left -= 1
        self._require(0)

    def _require(self, number: int) -> None:
        if self._left < number:
            raise DecodeError("its lists hold more than limits.message_elements in the recipe allows")

    def _number(self) -> int:
        self._align(4)
        (number,) = self._count.unpack_from(self._data, self.end)
        self._advance(4)
        return int(number)

    def _skip(self, number: int, size: int) -> None:
        self._align(min(size, 8), empty=not number)
        self._advance(number * size)
        if self.end > len(self._data):
            raise IndexError

    def _advance(self, size: int) -> None:
        self.end += size
        self.estimate += size

    def _align(self, size: int, *, empty: bool = False) -> None:
        if self._ros1:
            return
        self.estimate = (self.estimate + size - 1) & -size
        if not empty:
            self.end = (self.end + size - 1) & -size
