"""What differs between two actions, in words."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Change", "changes", "flat", "in_words"]

_MOST_WORDS = 3
_MOST_CHARACTERS = 24


@dataclass(frozen=True)
class Change:
    """One thing about an action that differs.

    Attributes:
        group: `step`, `version`, `libraries`, `params` or `inputs`.
        name: which of the group, with dots between nested names.
        before: its value then; None if there was none.
        now: its value now; None if there is none any more.
    """

    group: str
    name: str
    before: Any
    now: Any

    def __str__(self) -> str:
        verb = "is new" if self.before is None else "is gone" if self.now is None else "changed"
        if self.group == "inputs":
            return f"{_input_name(self.name)} {verb}"
        what = {"step": "step", "version": "step version", "libraries": f"library {self.name}"}.get(
            self.group, self.name
        )
        if verb == "changed" and _is_short(self.before) and _is_short(self.now):
            return f"{what} {self.before} -> {self.now}"
        return f"{what} {verb}"


def changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[Change]:
    """Return what differs between two actions, given as JSON, in the order of their fields."""
    found = [
        Change(name, "", before[name], now[name]) for name in ("step", "version") if before[name] != now[name]
    ]
    for group in ("libraries", "params", "inputs"):
        old, new = dict(flat(before[group])), dict(flat(now[group]))
        found += [
            Change(group, name, old.get(name), new.get(name))
            for name in sorted(old.keys() | new.keys())
            if old.get(name) != new.get(name)
        ]
    return found


def in_words(found: Sequence[Change]) -> str:
    """Return a short list of changes for a line of text."""
    words = list(dict.fromkeys(str(change) for change in found))
    more = f" and {len(words) - _MOST_WORDS} more" if len(words) > _MOST_WORDS else ""
    return ", ".join(words[:_MOST_WORDS]) + more


def flat(value: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted name and value of all leaves; lists are leaves, as are empty objects."""
    for name, inner in value.items():
        if isinstance(inner, Mapping) and inner:
            yield from flat(inner, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", inner


def _input_name(name: str) -> str:
    kind, _, rest = name.partition(":")
    if name == "bag":
        return "the recording's content"
    kinds = {"topic": "topic", "channel": "channel", "msg": "definition", "labels": "labels"}
    return f"{kinds[kind]} {rest}" if kind in kinds else name


def _is_short(value: Any) -> bool:
    return not isinstance(value, Mapping | list) and len(str(value)) <= _MOST_CHARACTERS
