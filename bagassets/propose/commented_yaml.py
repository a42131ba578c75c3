"""YAML with comments: fields one per line, each with the reason it has its value."""

from collections.abc import Iterable

from bagassets.escaping import visible

__all__ = ["Sheet"]

_WIDTH = 110


class Sheet:
    """Lines of YAML in the making.

    Values are put in as `yaml_scalar`; comments may be any text, and stay comments.
    """

    def __init__(self) -> None:
        self._lines: list[str] = []

    def field(self, depth: int, text: str, comment: str = "") -> None:
        """Add a line, its comment behind it or, if that is too long, above it."""
        line = "  " * depth + text
        comment = visible(comment)
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
        for word in visible(text).split():
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
        self._lines.append("  " * depth + "# " + visible(text))

    def blank(self) -> None:
        """Add an empty line."""
        self._lines.append("")

    def text(self) -> str:
        """Return all lines."""
        return "\n".join(self._lines) + "\n"
