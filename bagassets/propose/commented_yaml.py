"""YAML with comments: fields one per line, each with the reason it has its value, and questions where it has none."""

from dataclasses import dataclass

from bagassets.base.escaping import visible

_WIDTH = 110


@dataclass(frozen=True)
class Question:
    """What only the user can decide, and the build needs.

    Attributes:
        line: line of the field without value or, where that may stay as it is, of the text that asks; from 1.
        rig: name of the rig that it is about; "" if it is about none.
        subject: the field or channel.
        text: what is missing, and what to do.
    """

    line: int
    rig: str
    subject: str
    text: str


class Sheet:
    """Lines of YAML in the making.

    Values are put in as `yaml_scalar`; comments may be any text, and stay comments.

    Attributes:
        guesses: number of values that are marked as guessed.
        questions: what was asked.
        rig: name of the rig that is being written; "" outside of rigs.
    """

    def __init__(self) -> None:
        self._lines: list[str] = []
        self.rig = ""
        self.guesses = 0
        self.questions: list[Question] = []

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

    def guess(self, depth: int, text: str, reason: str) -> None:
        """Add a line whose value is guessed for a reason; without one, it is no guess."""
        self.guesses += bool(reason)
        self.field(depth, text, reason and f"guess: {reason}")

    def guess_note(self, depth: int, text: str) -> None:
        """Add a comment on something that is guessed by leaving a field out, or beside one."""
        self.guesses += 1
        self.note(depth, f"guess: {text}")

    def ask(self, depth: int, subject: str, text: str, more: str = "", *, below: bool = False) -> None:
        """Add a question.

        Args:
            depth: depth of the comment.
            subject: field or channel that it is about, for those who do not see where it stands.
            text: what is missing, and what to do.
            more: what only makes sense above the lines that follow.
            below: it is about the field just written, which has no value, so that is its line, as in the recipe's errors.
        """
        self.questions.append(Question(len(self._lines) + (not below), self.rig, subject, text))
        self.note(depth, f"to be decided: {text}{more}")

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

    def off(self, depth: int, text: str) -> None:
        """Add a line that is commented out: removing `# ` makes it count."""
        self._lines.append("  " * depth + "# " + visible(text))

    def blank(self) -> None:
        """Add an empty line."""
        self._lines.append("")

    def text(self) -> str:
        """Return all lines."""
        return "\n".join(self._lines) + "\n"
