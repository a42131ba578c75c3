"""Which recordings are the parts of one drive: what their names, topics and times say.

Recorders split long drives into `STEM_0`, `STEM_1`, …; `rosbag record` gives each part a date of its own. Other people number
their drives the same way, so names alone say nothing, and what is not sure is a question to the user.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

from bagassets.base.alike import names_text

_NUMBERED = re.compile(r"(?s)(.+)_([0-9]{1,6})(\.bag|\.mcap|\.db3)")
_DATED = re.compile(r"(?s)(.*?)_?[0-9]{4}(?:-[0-9]{2}){5}")
_SECOND_NS = 1_000_000_000
# Threads of a recorder hand over messages late, so parts may overlap a little.
_MOST_OVERLAP_NS = _SECOND_NS
_LEAST_PAUSE_NS = 2 * _SECOND_NS
_PERIODS = 3
# Drives so near in time show the same place and the same objects, whether they are one or not.
_NEAR_NS = 60 * _SECOND_NS


class PartFacts(NamedTuple):
    """What tells whether a file goes on where another ends.

    Attributes:
        topics: topic -> type.
        latched: topics whose messages hold until the next one, so that later parts need not have any.
        start_ns: log time of its first message.
        end_ns: log time of its last message.
        period_ns: the longest of the median periods of its topics, 0 if no topic has one; None where it was not looked for.
    """

    topics: Mapping[str, str]
    latched: Sequence[str]
    start_ns: int
    end_ns: int
    period_ns: int | None = None


class Part(NamedTuple):
    """A file that may be part of a series: name and number, and its facts or why there are none."""

    name: str
    number: int
    facts: PartFacts | str


class Candidate(NamedTuple):
    """Files whose names fit a series.

    Attributes:
        whole: path of the whole drive, below the bag root.
        numbers: path of each file below the bag root -> its number, in order.
    """

    whole: str
    numbers: dict[str, int]


class Verdict(NamedTuple):
    """What is to be done with files whose names fit a series: nothing, unless one of these says something else.

    Attributes:
        parts: names of the files that are one drive, in order.
        why: why they may not be one drive, so that the user has to say.
        near: in that case, groups of names that must not lie in different splits.
    """

    parts: tuple[str, ...] = ()
    why: str = ""
    near: tuple[tuple[str, ...], ...] = ()


def candidates(paths: Iterable[str]) -> Iterator[Candidate]:
    """Yield the groups of files whose names fit a series, from paths below the bag root."""
    numbered: dict[tuple[str, str], list[tuple[int, str]]] = {}
    for path in paths:
        if found := _NUMBERED.fullmatch(path):
            stem, number, suffix = found.groups()
            numbered.setdefault((stem, suffix), []).append((int(number), path))
    groups: dict[tuple[str, bool, str], list[tuple[int, str]]] = {}
    for (stem, suffix), files in sorted(numbered.items()):  # by date, where recorders wrote it into names
        groups.setdefault((*_undated(stem), suffix), []).extend(sorted(files))
    for (_, is_dated, _), files in groups.items():
        for run in _runs(files) if is_dated else [files]:
            missing = run[-1][0] - run[0][0] + 1 - len({number for number, _ in run})
            # Where most numbers are missing, they count something else, such as seconds.
            if len(run) > 1 and missing < len(run):
                yield Candidate(_NUMBERED.sub(r"\1\3", run[0][1]), {path: number for number, path in run})


def _undated(stem: str) -> tuple[str, bool]:
    """Return a path without the date at its end, and whether there was one."""
    folder, slash, name = stem.rpartition("/")
    dated = _DATED.fullmatch(name)
    return (stem, False) if dated is None else (f"{folder}{slash}{dated[1]}", True)


def whole_of(path: str) -> str | None:
    """Return the path of the whole drive that a file is a part of, by its name; None if it can be no part."""
    found = _NUMBERED.fullmatch(path)
    return None if found is None else found[1] + found[3]


def _runs(files: Sequence[tuple[int, str]]) -> Iterator[Sequence[tuple[int, str]]]:
    """Yield runs of files with ascending numbers; the dates of `rosbag record` tell several drives apart."""
    begins = [n for n in range(1, len(files)) if files[n][0] <= files[n - 1][0]]
    for begin, end in pairwise([0, *begins, len(files)]):
        yield files[begin:end]


def judge(parts: Sequence[Part]) -> Verdict:
    """Return whether files, in the order of their numbers, are one drive.

    One that cannot be read ends the drive if it is the last: it may be still in the making.
    """
    readable = [(part.name, part.facts) for part in parts if isinstance(part.facts, PartFacts)]
    if len(readable) < 2:
        return Verdict()
    while isinstance(parts[-1].facts, str):
        parts = parts[:-1]
    reasons = [f"{part.name} cannot be read ({part.facts})" for part in parts if isinstance(part.facts, str)]
    reasons += filter(None, [odd_number([part.number for part in parts])])
    reasons += [reason for one, other in pairwise(readable) if (reason := _compare(*one, *other))]
    if not reasons:
        return Verdict(tuple(name for name, _ in readable))
    groups = _near(readable)
    return Verdict((), reasons[0], groups) if groups else Verdict()


def odd_number(numbers: Iterable[int]) -> str:
    """Return which of the numbers of parts, in order, is missing or there twice; "" if none is."""
    for one, other in pairwise(numbers):
        if other != one + 1:
            return f"number {one} is there twice" if other == one else f"number {one + 1} is missing"
    return ""


def periods_matter(one: PartFacts, other: PartFacts) -> bool:
    """Tell whether periods decide if a part goes on where the one before it ends: none is longer than its part."""
    longest_ns = max(one.end_ns - one.start_ns, other.end_ns - other.start_ns)
    return _LEAST_PAUSE_NS < other.start_ns - one.end_ns <= _PERIODS * longest_ns


def _near(readable: Sequence[tuple[str, PartFacts]]) -> tuple[tuple[str, ...], ...]:
    """Return groups of files, each of which is near in time to others of its group, whatever their numbers."""
    apart_ns = max(_NEAR_NS, *(_PERIODS * (facts.period_ns or 0) for _, facts in readable))
    groups: list[list[str]] = []
    end_ns = None
    for name, facts in sorted(readable, key=lambda one: one[1].start_ns):
        if end_ns is None or facts.start_ns > end_ns + apart_ns:
            groups.append([])
        groups[-1].append(name)
        end_ns = facts.end_ns if end_ns is None else max(end_ns, facts.end_ns)
    return tuple(tuple(name for name, _ in readable if name in group) for group in groups if len(group) > 1)


def _compare(before: str, one: PartFacts, name: str, other: PartFacts) -> str:
    """Return why a part may not go on where the one before it ends; "" if it does."""
    pause_ns = other.start_ns - one.end_ns
    most_ns = max(_LEAST_PAUSE_NS, _PERIODS * max(one.period_ns or 0, other.period_ns or 0))
    if pause_ns > most_ns:
        return f"{name} begins {pause_ns / 1e9:.1f} s after {before} ends"
    if pause_ns < -_MOST_OVERLAP_NS or other.start_ns <= one.start_ns:
        return f"{name} begins {-pause_ns / 1e9:.1f} s before {before} ends"
    if one.topics != other.topics:
        differ = one.topics.items() ^ other.topics.items()
        topics = sorted({topic for topic, _ in differ}.difference(one.latched, other.latched))
        if topics:
            return f"{before} and {name} differ in topic {names_text(topics, 1)}"
    return ""
