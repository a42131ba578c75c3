"""Numbers in messages of any type, by the path of a field: `position`, `pose.position`, `axes[2]`.

Texts of errors contain no values, because steps count lost messages by them.
"""

import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from math import inf
from numbers import Real
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeGuard

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError, UnsetError
from bagassets.decode.fields import members
from bagassets.recordings.heads import head_of, time_ns
from bagassets.recordings.model import Message

MOST_ELEMENTS = 1_000
"""An array of more is an image or a cloud, and no signal."""

_NUMBER = Real, np.bool_
_NAMES = ("name", "names", "joint_names")
_STEP = re.compile(r"\w+")


class Numbers(NamedTuple):
    """The numbers in a field.

    Attributes:
        labels: what they are called: by the message, else by their paths.
        values: as many values.
        named: True if the message names them.
    """

    labels: tuple[str, ...]
    values: Sequence[float] | NDArray[np.float64]
    named: bool


def numbers_at(message: Message, path: str) -> Numbers:
    """Return the numbers in a field: its value, the elements of an array, or all numbers in a message.

    Those of an array are called as a list of as many texts `name`, `names` or `joint_names` says, which is beside the array or
    in a message around it; those of a list of messages (`joints.position`) as the `name` of each; booleans are 0 and 1.

    Raises:
        UnsetError: the array is empty, or too short.
        DecodeError: there is no such field, or it holds something else than numbers.
    """
    value: Any = message
    around: list[Any] = []
    labels: tuple[str, ...] = ()
    for step in _steps(path):
        around.append(value)
        if isinstance(step, int):
            value = _element(value, step, path)
        elif _is_array(value):
            holders = [one for one in value if _has(one, step)]
            labels = tuple(getattr(one, "name", "") for one in holders)
            if not holders and len(value):
                _member(value[0], step, path)  # which may not even have such a field
            value = [getattr(one, step) for one in holders]
        else:
            value = _member(value, step, path)
    if isinstance(value, _NUMBER):
        return Numbers((path,), (_float(value),), named=False)
    if _is_array(value) and not (len(value) and members_of(value[0])):
        return _array(value, path, labels, around)
    found = list(_inside(value, path))
    return Numbers(tuple(label for label, _ in found), [number for _, number in found], named=False)


def own_stamp_ns(message: Message) -> int:
    """Return the stamp of a message in nanoseconds: that of its header, or its `timestamp` or `stamp`.

    Raises:
        DecodeError: it has none, or it is zero.
    """
    head = head_of(message)
    stamp_ns = time_ns(getattr(message, "stamp", None)) if head is None else head[0]
    if stamp_ns is None:
        raise DecodeError("it has no header with a stamp; set `clock: log` in the recipe")
    if not stamp_ns:
        raise DecodeError("its stamp is zero; set `clock: log` in the recipe")
    return stamp_ns


@lru_cache(1_000)
def _steps(path: str) -> tuple[str | int, ...]:
    return tuple(int(step) if step.isdigit() else step for step in _STEP.findall(path))


def _member(value: Message, name: str, path: str) -> Message:
    try:
        member: Message = getattr(value, name)
    except AttributeError:
        there = ", ".join(members_of(value))
        raise DecodeError(f"there is no field {path}: {name} is not one of {there or 'its parts'}") from None
    return member


def _has(value: Message, name: str) -> bool:
    """Return whether a message in a list has a value for one of its fields, which in protobuf and JSON may be left out."""
    descriptor = getattr(value, "DESCRIPTOR", None)
    field = None if descriptor is None else descriptor.fields_by_name.get(name)
    if field is not None and field.has_presence:
        return bool(value.HasField(name))
    return getattr(value, name, None) is not None


def _element(value: Message, index: int, path: str) -> Message:
    if not _is_array(value):
        raise DecodeError(f"there is no field {path}: what it counts in is no array")
    if index >= len(value):
        raise UnsetError(f"its array is too short for {path}")
    return value[index]


def members_of(value: Message) -> tuple[str, ...]:
    """Return the names of the fields of a message of ROS, protobuf or JSON; none of anything else."""
    if isinstance(value, SimpleNamespace):
        return tuple(vars(value))
    descriptor = getattr(value, "DESCRIPTOR", None)
    return members(value) if descriptor is None else tuple(field.name for field in descriptor.fields)


def _float(value: Any) -> float:  # noqa: ANN401  (any number)
    try:
        return float(value)
    except OverflowError:  # integers of JSON may be of any size
        return inf


def _is_array(value: object) -> TypeGuard[Sequence[Message]]:
    return isinstance(value, np.ndarray) or (isinstance(value, Sequence) and not isinstance(value, str))


def _array(value: Sequence[Any], path: str, labels: tuple[str, ...], around: Sequence[Any]) -> Numbers:
    if len(value) > MOST_ELEMENTS:
        raise DecodeError(f"{path} is an array of more than {MOST_ELEMENTS} elements; name single ones")
    if not len(value):
        raise UnsetError(f"{path} is empty")
    try:
        values = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise DecodeError(f"{path} does not hold numbers") from None
    if values.ndim != 1:
        raise DecodeError(f"{path} is an array of arrays; name one of them, as in {path}[0]")
    lists = (getattr(message, name, None) for message in reversed(around) for name in _NAMES)
    for texts in (labels, *lists):
        if _is_array(texts) and len(texts) == len(value):
            names: tuple[Any, ...] = tuple(texts)
            if all(isinstance(name, str) and name for name in names) and len(set(names)) == len(names):
                return Numbers(names, values, named=True)
    return Numbers(_numbered(path, len(value)), values, named=False)


@lru_cache(1_000)
def _numbered(path: str, number: int) -> tuple[str, ...]:
    return tuple(f"{path}[{index}]" for index in range(number))


def _inside(value: Message, path: str) -> Iterator[tuple[str, float]]:
    """Yield the path of each number in a message, or in a list of messages, and the number."""
    if isinstance(value, _NUMBER):
        yield path, _float(value)
    elif names := members_of(value):
        for name in names:
            yield from _inside(getattr(value, name), f"{path}.{name}")
    elif _is_array(value):
        if len(value) > MOST_ELEMENTS:
            raise DecodeError(f"{path} is an array of more than {MOST_ELEMENTS} elements; name single ones")
        for index, one in enumerate(value):
            yield from _inside(one, f"{path}[{index}]")
    else:
        raise DecodeError(f"{path} is not a number")
