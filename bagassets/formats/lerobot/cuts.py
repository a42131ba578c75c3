"""Where episodes are in a recording: all of it, or as messages, a signal or a file of time ranges say."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError
from bagassets.decode.numeric_fields import members_of
from bagassets.formats.lerobot.ranges import Span
from bagassets.recordings.recording import Recording

NO_MESSAGES = "has no messages"
_MOST_HEARD, _LONGEST_HEARD = 3, 60


class Said(NamedTuple):
    """A value of a message's field.

    Attributes:
        log_time_ns: when the message was logged.
        value: the value.
    """

    log_time_ns: int
    value: object


def said(recording: Recording, topic: str, field: str | tuple[str, ...]) -> list[Said]:
    """Return the values of a field, or of the first of several that a message has, in the messages of a topic; without it, None.

    Raises:
        DecodeError: a message cannot be decoded.
    """
    found = list[Said]()
    for message in recording.messages([topic]):
        try:
            decoded = recording.decode(message)
        except DecodeError as err:
            why = f"{topic}, message {len(found) + 1}: {err}"
            raise DecodeError(f"{why}; name another topic in lerobot, or repair the recording.") from err
        values = (_value(decoded, path) for path in _paths(field))
        found.append(Said(message.log_time_ns, next((value for value in values if value is not None), None)))
    return found


def _value(value: object, path: str) -> object:
    for name in path.split("."):
        value = getattr(value, name, None)
    return value


def _paths(field: str | tuple[str, ...]) -> tuple[str, ...]:
    return (field,) if isinstance(field, str) else field


def why_unsaid(recording: Recording, topic: str, field: str | tuple[str, ...], texts: Sequence[Said]) -> str:
    """Return why messages say nothing, as a clause; "" if one does."""
    if not texts:
        return f"{topic} {NO_MESSAGES}"
    if any(one.value is not None for one in texts):
        return ""
    there = ", ".join(members_of(recording.decode(next(recording.messages([topic])))))
    paths = " or ".join(_paths(field))
    return f"no message of {topic} has a field {paths}; they have {there or 'none'}: correct `field`"


def heard(events: Sequence[Said]) -> str:
    """Return what messages say, for errors: up to three of the values, in order."""
    values = list(dict.fromkeys(_cut(repr(one.value)) for one in events))
    return ", ".join(values[:_MOST_HEARD]) + (" and others" if len(values) > _MOST_HEARD else "")


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST_HEARD else f"{text[:_LONGEST_HEARD]}…"


def by_events(
    events: Sequence[Said], start: Sequence[object], end: Sequence[object], last_ns: int
) -> list[Span]:
    """Return the episodes that messages begin and end; the last one may end with the recording, at `last_ns`.

    Args:
        events: the messages, in order of log time.
        start: values that begin an episode; empty if each message does.
        end: values that end one.
        last_ns: where the recording ends.
    """
    spans: list[Span] = []
    begun: int | None = None
    for time_ns, value in events:
        begins = not start or _is_one_of(value, start)
        if begun is not None and (begins or _is_one_of(value, end)):
            spans.append(Span(begun, time_ns - 1))
            begun = None
        if begins:
            begun = time_ns
    return spans if begun is None else [*spans, Span(begun, last_ns)]


def _is_one_of(value: object, others: Sequence[object]) -> bool:
    # 1 is not True here: a recipe says what it means.
    return any(value == other and isinstance(value, bool) == isinstance(other, bool) for other in others)


def by_signal(stamps_ns: NDArray[np.int64], values: NDArray[np.float64]) -> list[Span]:
    """Return the episodes during which a signal, (M,), is not zero; a gap in it (NaN) ends one."""
    on = np.concatenate([[False], np.nan_to_num(values, nan=0.0) != 0, [False]])
    begins, ends = (np.flatnonzero(change) for change in (on[1:] & ~on[:-1], ~on[1:] & on[:-1]))
    spans = []
    for first, after in zip(begins.tolist(), ends.tolist(), strict=True):
        end_ns = stamps_ns[after] - 1 if after < len(stamps_ns) else stamps_ns[-1]
        spans.append(Span(int(stamps_ns[first]), int(end_ns)))
    return spans


@dataclass(frozen=True)
class TaskTexts:
    """The task as messages say it.

    Attributes:
        texts: the messages, in order of log time.
        start_ns: where the recording begins, for errors.
        why_none: why none of them says it; "" if one does.
    """

    texts: Sequence[Said]
    start_ns: int
    why_none: str = ""

    def of(self, span: Span) -> str:
        """Return the task of an episode: the latest text before its first frame, or the first one in it.

        Raises:
            DecodeError: there is none, or it changes during the episode.
        """
        before = [one for one in self.texts if one.log_time_ns <= span.start_ns]
        within = [one for one in self.texts if span.start_ns < one.log_time_ns <= span.end_ns]
        told = [*before[-1:], *within]
        if not told or not isinstance(told[0].value, str) or not told[0].value.strip():
            raise DecodeError(self.why_none or "no message says its task")
        other = next((one for one in told if one.value != told[0].value), None)
        if other is not None:
            at_s = (other.log_time_ns - self.start_ns) / 1e9
            raise DecodeError(f"its task changes at {at_s:.3f} s, from {told[0].value!r} to {other.value!r}")
        return told[0].value.strip()


def pieces(span: Span, max_length_s: float | None, fps: int) -> Iterator[Span]:
    """Yield an episode in pieces of at most this length, each of whole frames; itself if it is not longer."""
    if max_length_s is None:
        yield span
        return
    frames = max(1, int(max_length_s * fps + 1e-6))  # 4.1 * 30 is 122.99...
    first = 0
    while (start_ns := span.start_ns + first * 1_000_000_000 // fps) <= span.end_ns:
        first += frames
        yield Span(start_ns, min(span.end_ns, span.start_ns + first * 1_000_000_000 // fps - 1), span.task)
