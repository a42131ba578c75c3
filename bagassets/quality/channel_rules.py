"""Rules about extracted channels: every one has files, and not too many messages were lost."""

from collections.abc import Mapping
from typing import Any

from bagassets.quality.finding import Finding
from bagassets.recipe.model_checks import ChannelsCheck

__all__ = ["channels_complete"]


def channels_complete(channels: Mapping[str, Any], check: ChannelsCheck) -> Finding:
    """Check the counts of the channels of one asset.

    Args:
        channels: content of `channels.json`: channel -> `counts` (read, written, merged, lost).
        check: thresholds.
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
        elif number > check.max_lost * counts["read"]:
            reason = max(sorted(counts["lost"]), key=lambda text: counts["lost"][text])
            problems.append(
                f"{name}: {number} of {counts['read']} messages were lost, most often because {reason}; "
                f"a share of {check.max_lost:g} is accepted"
            )
    written = {name: entry["counts"]["written"] for name, entry in sorted(channels.items())}
    return Finding(problems, {"files": written, "lost": lost})
