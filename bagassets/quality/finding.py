"""What a rule finds: sentences about what is wrong, and the numbers it looked at."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from bagassets.json_types import JsonMapping
from bagassets.recipe.model_checks import Severity

__all__ = ["Finding", "clock"]


@dataclass(frozen=True)
class Finding:
    """The outcome of one rule.

    Attributes:
        problems: sentences, each naming its first offender; empty if all is well.
        warnings: sentences about what the recipe may have asked for; they never weigh more than a warning.
        facts: numbers that were looked at, for people.
    """

    problems: Sequence[str] = ()
    facts: JsonMapping = field(default_factory=dict)
    warnings: Sequence[str] = ()

    @property
    def sentences(self) -> list[str]:
        """All that was found, problems first."""
        return [*self.problems, *self.warnings]

    @property
    def passed(self) -> bool:
        """Tell whether nothing was found."""
        return not self.sentences

    def weight(self, severity: Severity) -> Severity:
        """Return how much the finding weighs, given what the recipe says of the check."""
        return severity if self.problems else "warn"


def clock(stamp_ns: int) -> str:
    """Return a time as people read it: `2026-11-21T07:30:03.125Z (1763710203125000000)`."""
    text = datetime.fromtimestamp(stamp_ns // 1_000_000 / 1e3, UTC).isoformat(timespec="milliseconds")
    return f"{text.replace('+00:00', 'Z')} ({stamp_ns})"
