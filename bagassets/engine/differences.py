"""The differences between two actions, and a short text about them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from bagassets.base.alike import names_text
from bagassets.base.json_types import JsonMapping

_MOST_CHARACTERS = 24
_NOTHING: tuple[object, ...] = (None, {}, [])
_KINDS = ("topic", "channel", "msg", "labels", "calibration")  # of inputs


@dataclass(frozen=True)
class Change:
    """One value that differs between two actions.

    Attributes:
        group: `step`, `version`, `libraries`, `params` or `inputs`.
        name: its name within the group, with dots between nested names; nested values that are all new, or all gone, are one.
        before: the old value; None, an empty object or an empty list if there was none.
        now: the new value; the same if there is none any more.
    """

    group: str
    name: str
    before: object
    now: object

    @property
    def verb(self) -> str:
        """What has become of it."""
        return "is new" if self.before in _NOTHING else "is gone" if self.now in _NOTHING else "changed"

    def __str__(self) -> str:
        verb = self.verb
        if self.group == "inputs":
            return f"{_input_name(self.name)} {verb}"
        whats = {"step": "step", "version": "step version", "libraries": f"library {self.name}"}
        what = whats.get(self.group, self.name)
        if verb == "changed" and _is_short(self.before) and _is_short(self.now):
            return f"{what} {self.before} -> {self.now}"
        return f"{what} {verb}"


def compare_actions(before: JsonMapping, now: JsonMapping) -> list[Change]:
    """Return the differences between two actions, given as JSON, in the order of their fields."""
    changes = [
        Change(name, "", before[name], now[name]) for name in ("step", "version") if before[name] != now[name]
    ]
    for group in ("libraries", "params", "inputs"):
        changes += _compare(group, "", before[group], now[group])
    return changes


def _compare(group: str, prefix: str, old: JsonMapping, new: JsonMapping) -> Iterator[Change]:
    for name in sorted(old.keys() | new.keys()):
        before, now = old.get(name), new.get(name)
        if isinstance(before, Mapping) and isinstance(now, Mapping) and before and now:
            yield from _compare(group, f"{prefix}{name}.", before, now)
        elif before != now:
            yield Change(group, f"{prefix}{name}", before, now)


def describe_changes(changes: Sequence[Change]) -> str:
    """Return a short text that names the first few changes.

    Where topics or files are new or gone, parameters and artifacts that come and go with them are left out.
    """
    from_outside = [one for one in changes if one.name.partition(":")[0] in _KINDS]
    if any(one.verb != "changed" for one in from_outside):
        changes = [one for one in changes if one in from_outside or one.verb == "changed"]
    return names_text(list(dict.fromkeys(map(str, changes))))


def flatten(value: JsonMapping, prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield dotted name and value of each leaf; lists and empty objects are leaves."""
    for name, inner in value.items():
        if isinstance(inner, Mapping) and inner:
            yield from flatten(inner, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", inner


def _input_name(name: str) -> str:
    if name == "bag":
        return "the recording's content"
    kind, _, rest = name.partition(":")
    named = {"msg": "definition", "calibration": "calibration file"}.get(kind, kind)
    return f"{named} {rest}" if kind in _KINDS else name


def _is_short(value: object) -> bool:
    return not isinstance(value, Mapping | list) and len(str(value)) <= _MOST_CHARACTERS
