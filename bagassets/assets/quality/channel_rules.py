"""Rules about extracted channels: each has files, and not too many messages were lost."""

from collections.abc import Callable, Mapping

from bagassets.assets.channel import counted_in_channel
from bagassets.assets.quality.finding import Finding
from bagassets.base.json_types import JsonMapping
from bagassets.base.quantities import count_text
from bagassets.recipe.model_base import Clock

_DUPLICATE = "duplicate stamp"
# Reasons that are not clauses, as texts after `because`; messages of errors are clauses.
_BECAUSE = {
    _DUPLICATE: "of duplicate stamps",
    "repeated stamp": "of repeated stamps",
    "zero stamp": "their header stamps are zero",
    "incomplete revolution": "they belong to incomplete revolutions",
    "position packet": "they are position packets",
    "no point in it": "they hold no points",
    "no ego pose to deskew with": "there is no ego pose to deskew them with",
    "no ego pose to compensate with": "there is no ego pose to compensate their velocities with",
}


def channels_complete(channels: JsonMapping, max_lost: float, clock_of: Callable[[str], Clock]) -> Finding:
    """Check the counts of the channels of one asset.

    Args:
        channels: content of `channels.json`: channel -> `counts` (read, written, merged, lost).
        max_lost: share of a channel's messages that may be lost.
        clock_of: channel -> its clock.
    """
    problems = []
    lost: dict[str, int] = {}
    for name, entry in sorted(channels.items()):
        counts = entry["counts"]
        number = sum(counts["lost"].values())
        if number:
            lost[name] = number
        reason = max(sorted(counts["lost"]), key=counts["lost"].__getitem__, default="")
        if counts["read"] != counts["written"] + counts["merged"] + number:
            problems.append(
                f"{name}: {_read(counts)}, but {counts['written']} written, "
                f"{counts['merged']} merged and {number} lost"
            )
        elif not counts["written"]:
            problems.append(f"{name}: {_read(counts)}, but no file was written{_why(reason, counts['lost'])}")
        elif number > max_lost * counts["read"]:
            problems.append(
                f"{name}: {number} of {counts['read']} {counted_in_channel(counts)}s ({number / counts['read']:.0%}) "
                f"{'was' if number == 1 else 'were'} lost{_why(reason, counts['lost'])}. {_advice(name, reason, clock_of(name))}"
            )
    written = {name: entry["counts"]["written"] for name, entry in sorted(channels.items())}
    return Finding(problems, {"files": written, "lost": lost})


def _read(counts: JsonMapping) -> str:
    number = counts["read"]
    return f"{count_text(number, counted_in_channel(counts))} {'was' if number == 1 else 'were'} read"


def _why(reason: str, lost: Mapping[str, int]) -> str:
    """Return why messages were lost, as the end of a sentence: for one reason, or most often for this one."""
    because = f" because {_BECAUSE.get(reason, reason)}" if lost else ""
    return because if len(lost) < 2 else f", most often ({count_text(lost[reason], 'time')}){because}"


def _advice(name: str, reason: str, clock: Clock) -> str:
    """Return what to do about messages of a channel lost for a reason."""
    field = f"for this channel (rigs[].channels.{name}.clock)"
    if reason == _DUPLICATE and clock == "header":
        return (
            f"If these are separate readings, `clock: log` tells them apart by their log times: {field}, while others keep their "
            "stamps, or for all (clock), as where a simulation was restarted"
        )
    if reason == _DUPLICATE:
        return (
            "They have the same log times; if their header stamps differ, use `clock: header` "
            f"{field}; other channels keep their stamps"
        )
    return "If that is acceptable, raise limits.reported_losses in the recipe; else repair the recording or remove the channel"
