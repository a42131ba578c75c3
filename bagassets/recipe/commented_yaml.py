"""YAML with comments: fields one per line, each with the reason it has its value."""

import re
from collections.abc import Iterable

__all__ = ["Sheet", "scalar"]

_WIDTH = 110
# Text that every YAML reader takes as text without quotes.
_BARE = re.compile(r"[A-Za-z_/][A-Za-z0-9_./-]*")
_NOT_TEXT = frozenset({"null", "true", "false", "yes", "no", "on", "off", "y", "n"})


def scalar(value: str) -> str:
    """Return text as a YAML scalar, quoted only if it must be."""
    if _BARE.fullmatch(value) and value.lower() not in _NOT_TEXT:
        return value
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in escaped) + '"'


class Sheet:
    """Lines of YAML in the making."""

    def __init__(self) -> None:
        self._lines: list[str] = []

    def field(self, depth: int, text: str, comment: str = "") -> None:
        """Add a line, its comment behind it or, if that is too long, above it."""
        line = "  " * depth + text
        if comment and len(line) + len(comment) + 4 <= _WIDTH:
            self._lines.append(f"{line}  # {comment}")
            return
        if comment:
            # A list entry's comment belongs to the entry, above its dash.
            self.note(depth, comment)
        self._lines.append(line)

    def note(self, depth: int, text: str) -> None:
        """Add a comment of its own, wrapped."""
        pad = "  " * depth + "# "
        line = pad
        for word in " ".join(text.split()).split(" "):
            if len(line) + len(word) > _WIDTH and line != pad:
                self._lines.append(line.rstrip())
                line = f"{pad}  "
            line += word + " "
        self._lines.append(line.rstrip())

    def notes(self, depth: int, texts: Iterable[str]) -> None:
        """Add several comments."""
        for text in texts:
            self.note(depth, text)

    def off(self, depth: int, text: str) -> None:
        """Add a line that is commented out: removing `# ` makes it count."""
        self._lines.append("  " * depth + "# " + text)

    def blank(self) -> None:
        """Add an empty line."""
        self._lines.append("")

    def text(self) -> str:
        """Return all lines."""
        return "\n".join(self._lines) + "\n"
