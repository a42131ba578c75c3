"""The differences between two actions, and a short text about them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from bagassets.base.alike import names_text
from bagassets.base.json_types import JsonMapping

_MOST_CHARACTERS = 24
_KINDS = ("topic", "channel", "msg", "labels", "calibration")  # of inputs


@dataclass(frozen=True)
class Change:
    """One value that differs between two actions.

    Attributes:
        group: `step`, `version`, `libraries`, `params` or `inputs`.
        name: its name within the group, with dots between nested names.
        before: the old value; None if there was none.
        now: the new value; None if there is none any more.
    """

    group: str
    name: str
    before: object
    now: object

    def __str__(self) -> str:
        verb = "is new" if self.before is None else "is gone" if self.now is None else "changed"
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
        old, new = dict(flatten(before[group])), dict(flatten(now[group]))
        changes += [
            Change(group, name, old.get(name), new.get(name))
            for name in sorted(old.keys() | new.keys())
            if old.get(name) != new.get(name)
        ]
    return changes


def describe_changes(changes: Sequence[Change]) -> str:
    """Return a short text that names the first few changes."""
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
