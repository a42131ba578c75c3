"""JSON with line numbers: the entries of a list, each with the line where it begins."""

import json
import re
from collections.abc import Iterator
from json.decoder import JSONDecoder

from bagassets.assets.boxes.files.label import UnreadableLabelsError
from bagassets.base.json_types import Json

_SPACE = re.compile(r"[ \t\r\n]*")


def parse(text: str) -> Json:
    """Return the content of a JSON text.

    Raises:
        UnreadableLabelsError: it is no JSON.
    """
    try:
        return json.loads(text)
    except json.JSONDecodeError as err:
        raise UnreadableLabelsError(err.lineno, f"is no JSON: {err.msg} at column {err.colno}") from None
    except ValueError:  # Python refuses to read integers of thousands of digits
        raise UnreadableLabelsError(0, "has a number with thousands of digits") from None
    except RecursionError:
        raise UnreadableLabelsError(0, "is nested too deeply") from None


def entries(text: str, key: str | None) -> Iterator[tuple[int, Json]]:
    """Yield line and value of each entry of a list in a text that `parse` accepted.

    Args:
        text: the text.
        key: member of the outermost object that holds the list; None if the list is outermost.
    """
    decoder = JSONDecoder()
    position = _skip(text, 0) if key is None else _member(decoder, text, key)
    if text[position] != "[":
        return
    line, counted = 1, 0
    position = _skip(text, position + 1)
    while text[position] != "]":
        line += text.count("\n", counted, position)
        counted = position
        value, position = decoder.raw_decode(text, position)
        yield line, value
        position = _skip(text, position)
        if text[position] == ",":
            position = _skip(text, position + 1)


def _skip(text: str, position: int) -> int:
    found = _SPACE.match(text, position)
    return position if found is None else found.end()


def _member(decoder: JSONDecoder, text: str, key: str) -> int:
    """Return where the value of the last member `key` of the outermost object begins (the last one counts)."""
    found = len(text) - 1
    position = _skip(text, _skip(text, 0) + 1)
    while text[position] == '"':
        name, position = decoder.raw_decode(text, position)
        position = _skip(text, _skip(text, position) + 1)
        if name == key:
            found = position
        _, position = decoder.raw_decode(text, position)
        position = _skip(text, position)
        if text[position] == ",":
            position = _skip(text, position + 1)
    return found
