"""Rules about extracted channels: every one has files, and not too many messages were lost."""

from collections.abc import Mapping
from typing import Any

from bagassets.quality.finding import Finding
from bagassets.recipe.model_base import Clock

__all__ = ["channels_complete"]

_DUPLICATE = "duplicate stamp"


def channels_complete(channels: Mapping[str, Any], max_lost: float, clock: Clock) -> Finding:
    """Check the counts of the channels of one asset.

    Args:
        channels: content of `channels.json`: channel -> `counts` (read, written, merged, lost).
        max_lost: share of a channel's messages whose loss is no finding.
        clock: which time of a message counts.
    """
    problems = []
    lost: dict[str, int] = {}
    for name, entry in sorted(channels.items()):
        counts = entry["counts"]
        number = sum(counts["lost"].values())
        if number:
            lost[name] = number
        if counts["read"] != counts["written"] + counts["merged"] + number:
            problems.append(
                f"{name}: {counts['read']} messages were read, but {counts['written']} written, "
                f"{counts['merged']} merged and {number} lost"
            )
        elif not counts["written"]:
            problems.append(f"{name}: {counts['read']} messages became no file")
        elif number > max_lost * counts["read"]:
            reason = max(sorted(counts["lost"]), key=lambda text: counts["lost"][text])
            problems.append(
                f"{name}: {number} of {counts['read']} messages ({number / counts['read']:.0%}) were lost, "
                f"{counts['lost'][reason]} of them because: {reason}. {_way_out(reason, clock)}"
            )
    written = {name: entry["counts"]["written"] for name, entry in sorted(channels.items())}
    return Finding(problems, {"files": written, "lost": lost})


def _way_out(reason: str, clock: Clock) -> str:
    """Return what to do about messages that were lost for a reason."""
    if reason == _DUPLICATE and clock == "header":
        return "If these are readings of their own, `clock: log` in the recipe tells them apart by when they were logged"
    if reason == _DUPLICATE:
        return "They were logged in the same microsecond; if their header stamps differ, use `clock: header` in the recipe"
    return "If that is acceptable, raise limits.reported_losses in the recipe; else mend the recording or remove the channel"
