"""A check of an asset: a rule is a function of the content of artifacts. An asset lists its own checks (`assets.asset.Asset.checks`)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bagassets.assets.quality.finding import Finding
from bagassets.recipe.model_checks import Checks, Severity

if TYPE_CHECKING:
    from bagassets.assets.quality.evidence import Evidence


@dataclass(frozen=True)
class RecordingCheck:
    """A check of an asset of each recording.

    Attributes:
        name: unique name, shown in Dagster.
        section: field of `checks` in the recipe with its severity and thresholds.
        description: what is true if it passes.
        fails_if: when it fails, in Markdown, for docs/checks.md.
        rule: evidence -> finding.
        quick: it reads counts, and stamps only if there is a finding. It takes a moment for thousands of recordings, so
            every build reports its findings.
    """

    name: str
    section: str
    description: str
    fails_if: str
    rule: "Callable[[Evidence], Finding]"
    quick: bool = False


def severity_of(checks: Checks, section: str) -> Severity:
    """Return the severity of a section's findings; `skip` if checks are disabled."""
    return getattr(checks, section).severity if checks.enabled else "skip"
