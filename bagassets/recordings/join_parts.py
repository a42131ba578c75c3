"""Joining files into series: as the recipe says, and where it says nothing, as far as their names and content are sure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from operator import attrgetter
from pathlib import Path, PurePosixPath

from bagassets.base.quantities import count_text
from bagassets.recipe.model import Bags
from bagassets.recordings.model import RecordingFiles
from bagassets.recordings.series import Candidate, Part, Verdict, candidates, judge, odd_number

FOR_NOW = "cannot be read for now"
"""Says of a part why its series is left out at the moment."""

_NO_PARTS = "bags.series says that it is one drive, but there are not two numbered files of it; correct its name there"
_NAME_TAKEN = "bags.series has a drive of this name, of which this file is no part; rename the file or the drive, or list the file there as a part"

_AS_IT_IS = attrgetter("relative", "size", "mtime_ns")

# `bags.recover` and first file -> path, size and time of each file, and what was decided: sensors look at the same files every few seconds.
_judged: dict[str, tuple[list[tuple[str, int, int]], Verdict]] = {}


@dataclass
class Joined:
    """Recordings below the bag root, with series in place of their parts.

    Attributes:
        recordings: path below the bag root -> recording.
        asked: path of a whole drive -> the question whether some files are its parts, or all of them.
        near: path of a recording -> path of the whole drive in question; those of one lie in one split.
        broken: path of a series that lacks parts -> what to do.
        left_out: path and reason of recordings that belong to a broken one.
    """

    recordings: dict[str, RecordingFiles]
    asked: dict[str, str] = field(default_factory=dict)
    near: dict[str, str] = field(default_factory=dict)
    broken: dict[str, str] = field(default_factory=dict)
    left_out: list[tuple[str, str]] = field(default_factory=list)


def join_parts(bags: Bags, recordings: Sequence[RecordingFiles], key_of: Callable[[str], str]) -> Joined:
    """Join the parts of series.

    Args:
        bags: has the user's answers.
        recordings: what was found, each file for itself.
        key_of: returns the partition key for a path below the bag root.
    """
    joined = Joined({recording.relative: recording for recording in recordings})
    for name, given in bags.series.items():
        if not isinstance(given, bool):
            _join_named(joined, bags.root, name, tuple(dict.fromkeys(given)), key_of)
    files = (path for path, one in joined.recordings.items() if one.files[0] is one.path)
    for candidate in list(candidates(files)):
        answer = bags.series.get(candidate.whole, bags.series.get(_without_suffix(candidate.whole)))
        verdict, for_now = _verdict(joined, bags, candidate, answer)
        if verdict.parts:
            _join(joined, candidate.whole, verdict.parts, key_of)
            if odd := odd_number(candidate.numbers.values()) if answer else "":
                joined.asked[candidate.whole] = (
                    f"{_shown(candidate)}: one drive, as bags.series says, but {odd}; correct that, or list the files there if they "
                    "are all."
                )
        elif verdict.why and for_now:  # drives that were one do not fall apart while a part is being replaced
            _leave_out(
                joined, bags.root, candidate.whole, list(candidate.numbers), for_now, "; look again later"
            )
        elif verdict.why:
            joined.asked[candidate.whole] = _question(candidate, verdict.why, is_listed=bool(answer))
            joined.near |= {path: candidate.whole for group in verdict.near for path in group}
    wholes = {path for path, one in joined.recordings.items() if one.parts}
    wholes |= {_without_suffix(path) for path in wholes}
    joined.left_out += [
        (name, _NO_PARTS) for name, given in bags.series.items() if given is True and name not in wholes
    ]
    return joined


def _verdict(
    joined: Joined, bags: Bags, candidate: Candidate, answer: bool | Sequence[str] | None
) -> tuple[Verdict, str]:
    """Return what is to be done with files, and which one before the last cannot be read at the moment; "" if they all can."""
    whole, numbers = candidate
    if isinstance(answer, bool):
        return Verdict(tuple(numbers)) if answer else Verdict(), ""
    files = [joined.recordings[path] for path in numbers]
    as_it_is, for_now = list(map(_AS_IT_IS, files)), ""
    known_as = f"{bags.recover} {files[0].path}"
    before, verdict = _judged.get(known_as, ([], Verdict()))
    if before != as_it_is:
        from bagassets.recordings.part_facts import ForNow, facts_of_parts  # noqa: PLC0415  (most folders have no series)

        facts = facts_of_parts(files, bags)
        verdict = judge([Part(*named, one) for named, one in zip(numbers.items(), facts, strict=True)])
        looked = zip(list(numbers)[:-1], facts, strict=False)
        for_now = next((f"{path} {FOR_NOW} ({one})" for path, one in looked if isinstance(one, ForNow)), "")
        if not any(isinstance(one, ForNow) for one in facts):
            _judged[known_as] = as_it_is, verdict
    if verdict.parts and answer:
        return Verdict((), f"the list of {whole} is without them", ((whole, *verdict.parts),)), ""
    if verdict.parts and whole in joined.recordings:
        why = f"{whole} lies beside them, and is left out if they are one"
        return Verdict((), why, ((whole, *verdict.parts),)), ""
    return verdict, "" if answer or whole in joined.recordings else for_now


def _without_suffix(path: str) -> str:
    return str(PurePosixPath(path).with_suffix(""))


def _join_named(
    joined: Joined, root: Path, name: str, files: Sequence[str], key_of: Callable[[str], str]
) -> None:
    """Join the files that the recipe names; without one of them, nothing is made of the others."""
    suffix = PurePosixPath(files[0]).suffix
    whole = name if name.endswith(suffix) else name + suffix
    found = [path for path in files if path in joined.recordings]
    if missing := [path for path in files if path not in joined.recordings]:
        more = f" and {count_text(len(missing) - 1, 'more part')}" if missing[1:] else ""
        problem = f"{missing[0]}{more} of bags.series cannot be found"
    elif odd := [path for path in found if PurePosixPath(path).suffix != suffix or not suffix]:
        problem = f"{odd[0]} of bags.series is no file of the format of {files[0]}"
    else:
        _join(joined, whole, files, key_of)
        return
    _leave_out(joined, root, whole, found, problem, "; copy it there, or correct bags.series")


def _leave_out(
    joined: Joined, root: Path, whole: str, paths: Sequence[str], problem: str, advice: str
) -> None:
    for path in paths:
        del joined.recordings[path]
        joined.left_out.append((path, f"part of {whole}, of which {problem}"))
    joined.left_out.append((whole, f"{problem}{advice}"))
    joined.broken[whole] = f"{root / whole}: {problem}{advice}."


def _join(joined: Joined, whole: str, paths: Sequence[str], key_of: Callable[[str], str]) -> None:
    parts = tuple(map(joined.recordings.pop, paths))
    root = parts[0].path.parents[parts[0].relative.count("/")]
    if whole in joined.recordings:
        joined.left_out.append((whole, _NAME_TAKEN))
    joined.recordings[whole] = RecordingFiles(
        key_of(whole),
        whole,
        root / whole,
        parts[0].format,
        tuple(chain.from_iterable(map(attrgetter("files"), parts))),
        sum(map(attrgetter("size"), parts)),
        max(map(attrgetter("mtime_ns"), parts)),
        parts,
        tuple(chain.from_iterable(map(attrgetter("seen"), parts))),
    )


def _question(candidate: Candidate, why: str, *, is_listed: bool) -> str:
    whole = candidate.whole
    say = (
        f"List them with {whole} or as another drive"
        if is_listed
        else f"Say `{whole}: true` (one) or `false`"
    )
    return (
        f"{_shown(candidate)}: parts of one drive, or drives of their own? {why}. {say} in bags.series; until then they are "
        "apart, in one split."
    )


def _shown(candidate: Candidate) -> str:
    names = list(candidate.numbers)
    return " and ".join(names) if len(names) == 2 else f"{names[0]} to {names[-1]} ({len(names)} files)"
