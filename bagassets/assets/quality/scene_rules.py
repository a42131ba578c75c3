"""Rules about scenes: a recording that takes part has at least one, and its samples have all channels."""

from collections.abc import Callable, Mapping
from math import floor

import numpy as np

from bagassets.assets.quality.finding import Finding
from bagassets.assets.timeline.keyframes import Stamps
from bagassets.base.json_types import JsonMapping
from bagassets.base.quantities import count_text, utc_text

# Number of channels named in one sentence.
_MOST_CHANNELS = 3
# A channel starts late or stops early only if more than this many of its periods are missing: a slow one may not be due.
_MISSING_PERIODS = 2

StampsOf = Callable[[str], Stamps]


def scenes_made(
    facts: JsonMapping, stamps_of: StampsOf, min_length_s: float, max_lost: float = 1.0
) -> Finding:
    """Check that a recording has a scene, and say why not; then, that nearly all of its time is in one.

    Args:
        facts: content of `facts.json` of the step `nuscenes_tables`.
        stamps_of: channel -> (N,) stamps of its readings in nanoseconds; called only if needed.
        min_length_s: least length of a scene, from the recipe.
        max_lost: share of its time that may be in stretches too short for a scene, or without the reference.
    """
    counts = facts["counts"]
    numbers = {name: counts[name] for name in ("scenes", "samples", "remainder_s", "dropped_keyframes")}
    if not counts["scenes"]:
        return Finding([f"it has no scene: {_reason(facts, stamps_of, min_length_s)}"], numbers)
    problems = _without_reference(facts, stamps_of, max_lost)
    left_s = counts["remainder_s"]
    begin_ns, end_ns = counts["channels"][facts["reference"]]["span_ns"] if left_s else (0, 0)
    if left_s > max_lost * (end_ns - begin_ns) / 1e9:
        length_s = _longest_s(counts)
        what = f"{left_s:g} s are in no scene, since scenes.min_length_s ({min_length_s:g}) is longer than"
        stretches = "that stretch" if length_s == left_s else f"those stretches, up to {length_s:g} s long"
        problems.append(f"{what} {stretches}; set it to {enough_s(length_s):g} for a scene more")
    return Finding(problems, numbers)


def _without_reference(facts: JsonMapping, stamps_of: StampsOf, max_lost: float) -> list[str]:
    """Say when the channel that decides about keyframes starts late or stops early, if more than a share of the time lacks it."""
    name, channels = facts["reference"], facts["counts"]["channels"]
    spans = {channel: counts["span_ns"] for channel, counts in channels.items() if counts["span_ns"]}
    begins_ns, ends_ns = min(span[0] for span in spans.values()), max(span[1] for span in spans.values())
    first_ns, last_ns = spans[name]
    before_ns, after_ns, most_ns = first_ns - begins_ns, ends_ns - last_ns, max_lost * (ends_ns - begins_ns)
    if before_ns + after_ns <= most_ns or max(before_ns, after_ns) <= _silence_ns(stamps_of(name)):
        return []
    when = [f"starts {_moment(first_ns, begins_ns)}"] * (before_ns > most_ns / 2)
    when += [f"stops {_moment(last_ns, begins_ns)}"] * (after_ns > most_ns / 2)
    longest = max(spans, key=lambda channel: spans[channel][1] - spans[channel][0])
    what = f"{(before_ns + after_ns) / 1e9:.1f} of {(ends_ns - begins_ns) / 1e9:.1f} s are in no scene, since {name}"
    what += f", which decides where keyframes are, {' and '.join(when)}"
    return [f"{what}; to use them, set `reference: {longest}` and `missing: allow` under scenes"]


def too_short_s(facts: JsonMapping) -> float | None:
    """Return the length of a recording that is too short for a scene; None if it has one, or lacks it for another reason."""
    counts = facts["counts"]
    if counts["scenes"] or counts["dropped_keyframes"]:
        return None
    has_poses = not counts["channels"][facts["reference"]].get("without_pose")
    return _longest_s(counts) if counts["remainder_s"] or has_poses else None


def _longest_s(counts: JsonMapping) -> float:
    """Return the longest time that is too short for a scene: of stretches between pauses, if there are several."""
    return float(counts.get("longest_remainder_s", counts["remainder_s"]))


def enough_s(length_s: float) -> float:
    """Return the value of scenes.min_length_s that gives a recording of that length, rounded to milliseconds, a scene."""
    return max(0.0, floor(100 * (length_s - 0.001)) / 100)


def _reason(facts: JsonMapping, stamps_of: StampsOf, min_length_s: float) -> str:
    counts, reference = facts["counts"], facts["reference"]
    if counts["dropped_keyframes"]:
        return _dropped(facts, stamps_of)
    if counts["remainder_s"]:
        length_s = _longest_s(counts)
        longest = " (the longest stretch between pauses)" if "longest_remainder_s" in counts else ""
        limit = f"scenes.min_length_s ({min_length_s:g})"
        return f"its {length_s:g} s are shorter than {limit}{longest}; set that to {enough_s(length_s):g} for a scene"
    if counts["channels"][reference].get("without_pose"):
        return f"the readings of {reference} have no ego pose"
    return (
        f"{reference} has too few readings for one of scenes.min_length_s ({min_length_s:g}); set that to 0 for a scene "
        "of a single reading"
    )


def keyframes_complete(facts: JsonMapping, stamps_of: StampsOf) -> Finding:
    """Check that no keyframe was dropped because a channel is missing, and that no sample lacks a channel.

    Channels without any reading in the recording are reported by `channels_present`.

    Args:
        facts: content of `facts.json` of the step `nuscenes_tables`.
        stamps_of: channel -> (N,) stamps of its readings in nanoseconds; called only if needed.
    """
    counts = facts["counts"]
    dropped, lacking = counts["dropped_keyframes"], counts["lacking_samples"]
    numbers = {
        "samples": counts["samples"],
        "dropped_keyframes": dropped,
        "samples_lacking_a_channel": lacking,
        "lacking_at_keyframes": {name: short["keyframes"] for name, short, _ in _shortages(facts)},
    }
    problems = [_dropped(facts, stamps_of)] if dropped and counts["scenes"] else []
    if lacking:
        problems.append(
            f"{lacking} of {counts['samples']} samples {'lacks' if lacking == 1 else 'lack'} a channel, as scenes.missing allows: {_channels(facts, stamps_of)}"
        )
    return Finding(problems, numbers)


def _dropped(facts: JsonMapping, stamps_of: StampsOf) -> str:
    counts = facts["counts"]
    number, of = counts["dropped_keyframes"], counts["dropped_keyframes"] + counts["samples"]
    return (
        f"{number} of {of} keyframes {'was' if number == 1 else 'were'} dropped, where a channel has no reading within "
        f"{facts['tolerance_s']:g} s (scenes.tolerance_s): {_channels(facts, stamps_of)}; raise scenes.tolerance_s, lower "
        "scenes.keyframe_hz, or keep samples that lack a channel with `missing: allow` under scenes"
    )


def _shortages(facts: JsonMapping) -> list[tuple[str, Mapping[str, int], list[int]]]:
    """Return channel, counts and span of the channels that lack readings at keyframes, the worst first."""
    lacking = [
        (name, counts["lacking_at_keyframes"], counts["span_ns"])
        for name, counts in sorted(facts["counts"]["channels"].items())
        if counts["lacking_at_keyframes"]["keyframes"]
    ]
    return sorted(lacking, key=lambda entry: -entry[1]["keyframes"])


def _channels(facts: JsonMapping, stamps_of: StampsOf) -> str:
    """Describe which channels lack readings at how many keyframes, and when they start late or stop early."""
    spans = [counts["span_ns"] for counts in facts["counts"]["channels"].values() if counts["span_ns"]]
    begins_ns = min((span[0] for span in spans), default=0)
    ends_ns = max((span[1] for span in spans), default=0)
    shortages = _shortages(facts)
    clauses = []
    for name, short, span in shortages[:_MOST_CHANNELS]:
        ends = []
        if short["before_first"] and span[0] - begins_ns > _silence_ns(stamps_of(name)):
            ends.append(f"{short['before_first']} before it starts {_moment(span[0], begins_ns)}")
        if short["after_last"] and ends_ns - span[1] > _silence_ns(stamps_of(name)):
            ends.append(f"{short['after_last']} after it stops {_moment(span[1], begins_ns)}")
        number = count_text(short["keyframes"], "keyframe")
        clauses.append(f"{name} at {number}" + (f" ({', '.join(ends)})" if ends else ""))
    more = len(shortages) - len(clauses)
    return ", ".join(clauses) + (f" and {count_text(more, 'more channel')}" if more > 0 else "")


def _silence_ns(stamps_ns: Stamps) -> float:
    """Return how long a channel may be silent at the start or end of a recording: a few of its median periods."""
    return _MISSING_PERIODS * float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0


def _moment(stamp_ns: int, begins_ns: int) -> str:
    return f"at {(stamp_ns - begins_ns) / 1e9:.1f} s, {utc_text(stamp_ns)}"
