"""Reading YAML as plain data, with the line of every field and without YAML's surprises.

Unlike with `yaml.safe_load`, a key given twice is an error, keys are always text, and values are null, true/false, numbers
or text. PyYAML follows YAML 1.1, where `12:30` is the number 750, `010` is 8, `2024-05-01` is a date and `1e-3` is text;
here they are text, text, text and a number.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from bagassets.base.errors import RecipeError
from bagassets.base.json_types import Json, JsonObject

_TAG = "tag:yaml.org,2002:"
# A text has fewer values than characters; aliases may add up to this many.
_PLENTY = 100_000
_TRUE = frozenset({"true", "yes", "on"})


@dataclass(frozen=True, slots=True)
class Place:
    """The place of a value in the file.

    Attributes:
        line: line of its key, or of the value itself in a list; from 1.
        children: places of the values in it, by key or index.
    """

    line: int
    children: Mapping[str | int, "Place"] = field(default_factory=dict)

    def line_of(self, location: tuple[str | int, ...]) -> int:
        """Return the line of the deepest value along `location` that is in the file."""
        place = self
        for part in location:
            if part not in place.children:
                break
            place = place.children[part]
        return place.line


class _Loader(yaml.SafeLoader):
    """The scanner and parser of PyYAML with fewer kinds of scalars."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012  PyYAML's own type


for _name, _pattern, _first in (
    ("null", r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("bool", r"^(?i:true|false|yes|no|on|off)$", list("tTfFyYnNoO")),
    ("int", r"^[-+]?(?:0|[1-9][0-9_]*)$", list("-+0123456789")),
    (
        "float",
        r"^(?:[-+]?(?:\.[0-9]+|(?:0|[1-9][0-9_]*)(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?i:inf)|\.(?i:nan))$",
        list("-+0123456789."),
    ),
    ("merge", r"^<<$", ["<"]),
):
    _Loader.add_implicit_resolver(_TAG + _name, re.compile(_pattern), _first)


def read_yaml(text: str, path: Path) -> tuple[Json, Place]:
    """Return the data in `text` and the places of its values; `path` is for messages.

    Raises:
        RecipeError: the text is not YAML, or uses a feature that a recipe does not have.
    """
    try:
        node = yaml.compose(text.removeprefix("\ufeff"), Loader=_Loader)
    except yaml.YAMLError as err:
        raise RecipeError(_syntax_error(err, text, path)) from err
    except RecursionError:
        raise RecipeError(f"{path}:1: the recipe is nested too deeply for a recipe.") from None
    if node is None:
        return None, Place(1)
    return _Reader(path, _PLENTY + len(text)).value(
        node, 1 if isinstance(node, yaml.MappingNode) else _line(node), ()
    )


def _syntax_error(err: yaml.YAMLError, text: str, path: Path) -> str:
    if isinstance(err, yaml.reader.ReaderError):
        line = text.count("\n", 0, err.position) + 1
        return f"{path}:{line}: the recipe has a character that YAML does not allow ({text[err.position]!r})."
    if (at := f"\n{text}".find("\n<<<<<<< ")) >= 0:
        where = f"{path}:{text.count(chr(10), 0, at) + 1}"
        return f"{where}: a merge in git left both sides here; keep one, without the lines of <<<<<<<, ======= and >>>>>>>."
    mark = getattr(err, "problem_mark", None)
    where = f"{path}:{mark.line + 1}" if mark is not None else str(path)
    problem = str(getattr(err, "problem", None) or "not valid YAML")
    if "'\\t'" in problem:
        return f"{where}: the line is indented with a tab; YAML is indented with spaces."
    if "expected a single document" in str(getattr(err, "context", "")):
        return f"{where}: a second document starts here; a recipe is one YAML document, remove the `---`."
    context = getattr(err, "context", None)
    start = getattr(err, "context_mark", None)
    if context and start is not None and mark is not None and start.line != mark.line:
        problem = f"{problem}, {context} that starts in line {start.line + 1}"
    return f"{where}: the recipe is not valid YAML ({problem})."


class _Reader:
    """Turns YAML nodes into data and places."""

    def __init__(self, path: Path, most: int) -> None:
        self._path = path
        self._open: set[int] = set()
        self._left = self._most = most

    def value(self, node: yaml.Node, line: int, at: tuple[str, ...]) -> tuple[Json, Place]:
        """Return data and place of `node`, whose key is in `line`."""
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node, at), Place(line)
        self._enter(node, line, at)
        try:
            if isinstance(node, yaml.SequenceNode) and node.tag == _TAG + "seq":
                pairs = [
                    self.value(item, _line(item), (*at, str(number)))
                    for number, item in enumerate(node.value)
                ]
                return [data for data, _ in pairs], Place(
                    line, {n: place for n, (_, place) in enumerate(pairs)}
                )
            if isinstance(node, yaml.MappingNode) and node.tag == _TAG + "map":
                data, places = self._mapping(node, at)
                return data, Place(line, places)
        finally:
            self._open.discard(id(node))
        raise self._error(_line(node), at, f"the tag {node.tag} has no meaning in a recipe; remove it")

    def _mapping(
        self, node: yaml.MappingNode, at: tuple[str, ...]
    ) -> tuple[JsonObject, dict[str | int, Place]]:
        data: JsonObject = {}
        places: dict[str | int, Place] = {}
        merged: list[tuple[yaml.Node, int]] = []
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise self._error(
                    _line(key_node), at, "a field's name must be plain text, but this is a list or mapping"
                )
            if key_node.tag == _TAG + "merge":
                several = isinstance(value_node, yaml.SequenceNode)
                sources = value_node.value if several else [value_node]
                merged += [(source, _line(key_node)) for source in sources]
                continue
            key = str(key_node.value)
            if key in data:
                first = places[key].line
                raise self._error(
                    _line(key_node), (*at, key), f"given twice, first in line {first}; remove one of the two"
                )
            data[key], places[key] = self.value(value_node, _line(key_node), (*at, key))
        for source, line in merged:
            if not isinstance(source, yaml.MappingNode):
                raise self._error(line, at, "`<<` takes an alias of a mapping, or a list of such aliases")
            self._enter(source, line, at)
            inherited, their_places = self._mapping(source, at)
            self._open.discard(id(source))
            data = inherited | data
            places = their_places | places
        return data, places

    def _enter(self, node: yaml.Node, line: int, at: tuple[str, ...]) -> None:
        if id(node) in self._open:
            raise self._error(line, at, "the alias refers to a value that contains it")
        self._open.add(id(node))
        # Ten lines of aliases to lists of aliases can stand for billions of values.
        self._left -= 1 + len(node.value)
        if self._left < 0:
            raise self._error(
                line, at, f"its aliases stand for more than {self._most} values; write out what is meant"
            )

    def _scalar(self, node: yaml.ScalarNode, at: tuple[str, ...]) -> str | int | float | bool | None:
        text = str(node.value)
        try:
            match node.tag.removeprefix(_TAG):
                case "null":
                    return None
                case "bool":
                    return text.lower() in _TRUE
                case "int":
                    return int(text.replace("_", ""))
                case "float":
                    return float(re.sub(r"^([-+]?)\.(?=[iInN])", r"\1", text.replace("_", "")))
                case "str":
                    return text
        except ValueError:
            raise self._error(_line(node), at, f"{text!r} is not a number") from None
        raise self._error(_line(node), at, f"the tag {node.tag} has no meaning in a recipe; remove it")

    def _error(self, line: int, at: tuple[str, ...], problem: str) -> RecipeError:
        field = f"{'.'.join(at)}: " if at else ""
        return RecipeError(f"{self._path}:{line}: {field}{problem}.")


def _line(node: yaml.Node) -> int:
    return int(node.start_mark.line) + 1
