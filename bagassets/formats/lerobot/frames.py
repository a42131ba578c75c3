"""The frames of an episode: which values and images each of them gets, or why the episode is left out."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError
from bagassets.base.quantities import count_text
from bagassets.formats.lerobot.grid import Picked, Stamps, grid_ns, pick
from bagassets.formats.lerobot.ranges import Span
from bagassets.formats.lerobot.settings import MOST_S

LEAST_FRAMES = 2
COUNTED = ("dropped", "repeated", "held")


@dataclass(frozen=True)
class Rule:
    """The rule of a feature; see `lerobot.features` in the recipe."""

    at: str
    tolerance_s: float
    gap: str


@dataclass(frozen=True)
class Source:
    """A signal or a camera that a feature is made from.

    Attributes:
        feature: the feature.
        name: the signal or the camera.
        rule: how values are picked.
        stamps_ns: stamps of its values, strictly increasing, (M,), without gaps in them.
        values: (M, D) of a signal; None of a camera.
    """

    feature: str
    name: str
    rule: Rule
    stamps_ns: Stamps
    values: NDArray[np.float64] | None = None

    def __str__(self) -> str:
        return f"{self.feature} ({self.name})"

    @property
    def ends_episodes(self) -> bool:
        """True if an episode cannot outlast it by its rule alone."""
        return self.rule.gap == "leave_out" and self.rule.at != "hold"


@dataclass(frozen=True)
class Frames:
    """The frames of an episode.

    Attributes:
        times_ns: their times, (N,).
        picked: which of its values they get, for each source.
        counts: feature -> number, of values in the episode that no frame has (`dropped`), of frames with the value of the frame
            before (`repeated`), and of those with the latest value, since none was near (`held`). Where a gap ends the episode, of
            the frames that it would have had from there on (`cut`).
    """

    times_ns: Stamps
    picked: Sequence[Picked]
    counts: Mapping[str, Counter[str]]


def time_text(time_s: float) -> str:
    """Return a time since a recording began; stamps may be earlier."""
    return f"{abs(time_s):.3f} s{' before its first message' if time_s <= -0.0005 else ''}"


def whole_span(sources: Sequence[Source]) -> Span:
    """Return where the first source begins and the last one ends."""
    return Span(
        int(min(source.stamps_ns[0] for source in sources)),
        int(max(source.stamps_ns[-1] for source in sources)),
    )


def frames_of(
    span: Span, sources: Sequence[Source], fps: int, trim_s: float, least_s: float, start_ns: int
) -> Frames:
    """Return the frames of an episode.

    Args:
        span: where it is.
        sources: what its features are made from.
        fps: frames per second.
        trim_s: what it may lose at either end.
        least_s: shorter ones are left out.
        start_ns: where the recording begins, for errors.

    Raises:
        DecodeError: a rule is broken; a clause that names feature and time.
    """

    def at(time_ns: int) -> str:
        return time_text((time_ns - start_ns) / 1e9)

    latest = max(sources, key=lambda source: int(source.stamps_ns[0]))
    begins_ns = max(span.start_ns, int(latest.stamps_ns[0]))
    if begins_ns - span.start_ns > trim_s * 1e9:
        raise DecodeError(f"{latest} begins at {at(begins_ns)} only, more than {trim_s:g} s after it")
    ends_ns = span.end_ns
    if ending := [source for source in sources if source.ends_episodes]:
        first = min(ending, key=lambda source: int(source.stamps_ns[-1]))
        ends_ns = min(ends_ns, int(first.stamps_ns[-1]))
        if span.end_ns - ends_ns > trim_s * 1e9:
            raise DecodeError(f"{first} ends at {at(ends_ns)} already, more than {trim_s:g} s before it")
    times_ns = grid_ns(begins_ns, ends_ns, fps)
    picked: list[Picked] = []
    counts: dict[str, Counter[str]] = {what: Counter() for what in COUNTED}
    number = len(times_ns)
    held: dict[str, NDArray[np.bool_]] = {}
    for source in sources:
        one = pick(source.stamps_ns, times_ns, source.rule.at, round(source.rule.tolerance_s * 1e9))
        gaps = np.flatnonzero(~one.has_value)
        if len(gaps) and source.rule.gap == "hold":
            held[source.feature] = held.get(source.feature, False) | ~one.has_value
            one = one.held()
            gaps = np.flatnonzero(~one.has_value)
        if len(gaps) and source.rule.gap == "end":
            if gaps[0] < number:
                number = int(gaps[0])
                counts["cut"] = Counter({source.feature: len(times_ns) - number})
        elif len(gaps):
            raise DecodeError(_no_value(source, at(int(times_ns[gaps[0]])), fps))
        picked.append(one)
    if number < (least := max(LEAST_FRAMES, int(np.ceil(least_s * fps - 1e-6)))):  # 0.14 * 50 is 7.00...1
        raise DecodeError(f"it has {count_text(number, 'frame')}, and must have {least}")
    if number >= MOST_S * fps:
        raise DecodeError(
            f"it is {number / fps:.0f} s long, and a video ends before {MOST_S} s; set lerobot.episodes.max_length_s"
        )
    times_ns, picked = times_ns[:number], [one.cut(number) for one in picked]
    counts["held"] = +Counter({feature: int(those[:number].sum()) for feature, those in held.items()})
    for source, one in zip(sources, picked, strict=True):
        first, after = np.searchsorted(source.stamps_ns, [times_ns[0], times_ns[-1] + 1])
        within = np.arange(first, after)
        unused = len(np.setdiff1d(within, np.union1d(one.before, one.after[one.weight > 0])))
        for what, found in (("dropped", unused), ("repeated", one.repeated)):
            counts[what][source.feature] = max(counts[what][source.feature], found)
    return Frames(times_ns, picked, counts)


def _no_value(source: Source, at: str, fps: int) -> str:
    clause = f"{source} has no value within {source.rule.tolerance_s:.3g} s of its frame at {at}"
    period_s = float(np.median(np.diff(source.stamps_ns))) / 1e9 if len(source.stamps_ns) > 1 else 0.0
    if period_s > source.rule.tolerance_s:
        clause += f": it comes at {1 / period_s:.3g} Hz and fps is {fps}; lower fps, or raise its tolerance_s"
    return clause
