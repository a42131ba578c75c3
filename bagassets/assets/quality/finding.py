"""Findings of rules: sentences about problems, and the numbers behind them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from bagassets.base.json_types import JsonMapping
from bagassets.base.quantities import utc_text
from bagassets.recipe.model_checks import Severity


@dataclass(frozen=True)
class Finding:
    """The outcome of one rule.

    Attributes:
        problems: sentences, each naming its first offender; empty if all is well.
        warnings: sentences about results that the recipe may have asked for; at most a warning.
        facts: the numbers behind them, for display.
    """

    problems: Sequence[str] = ()
    facts: JsonMapping = field(default_factory=dict)
    warnings: Sequence[str] = ()

    @property
    def sentences(self) -> list[str]:
        """All sentences, problems first; warnings beside them say that they are no more than that."""
        return [*self.problems, *(f"warning: {one}" if self.problems else one for one in self.warnings)]

    @property
    def passed(self) -> bool:
        """Tell whether there are no problems or warnings."""
        return not self.sentences

    def weight(self, severity: Severity) -> Severity:
        """Return the severity of the finding, given the severity of the check in the recipe."""
        return severity if self.problems else "warn"


def counted(text: str, offenders: Sequence[str]) -> list[str]:
    """Return the sentence with the number of offenders and the first one, without a full stop; none without any.

    Args:
        text: with `{}` for the number; of two words as in `are|is`, the second is for a single offender.
        offenders: their names.
    """
    if not offenders:
        return []
    is_single = len(offenders) == 1
    words = re.sub(r"([\w']+)\|([\w']+)", r"\2" if is_single else r"\1", text).format(len(offenders))
    return [f"{words}{':' if is_single else ', the first is'} {offenders[0]}"]


def clock(stamp_ns: int) -> str:
    """Format a time: `2026-11-21T07:30:03.125Z (1763710203125000000)`."""
    return f"{utc_text(stamp_ns)} ({stamp_ns})"
