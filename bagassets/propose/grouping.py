"""Which recordings one rig made: those whose sensor topics agree."""

import os.path
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from bagassets.propose.glance import Glance, merge_glances
from bagassets.propose.sensors import find_sensors, modality_of
from bagassets.recordings.globs import matches

__all__ = ["Group", "group_recordings", "match_globs"]

_ENOUGH_IN_COMMON = 0.5


@dataclass(frozen=True)
class Group:
    """Recordings of one rig.

    Attributes:
        recordings: their paths below the bag root, sorted.
        glance: what is known of them together.
    """

    recordings: tuple[str, ...]
    glance: Glance


def group_recordings(glances: Mapping[str, Glance]) -> tuple[list[Group], list[str]]:
    """Return the groups, the one with the most recordings first, and the recordings without a usable sensor.

    A recording joins a group if no sensor topic has another type there, and they share at least
    half of its sensor topics: one sensor may be missing without making another rig.

    Args:
        glances: path below the bag root -> what is known of the recording.
    """
    topics = {name: _sensor_topics(glance) for name, glance in glances.items()}
    bare = sorted(name for name, own in topics.items() if not own)
    members: list[list[str]] = []
    known: list[dict[str, str]] = []
    for name in sorted((name for name, own in topics.items() if own), key=lambda n: (-len(topics[n]), n)):
        own = topics[name]
        for group, theirs in zip(members, known, strict=True):
            shared = own.keys() & theirs.keys()
            if len(shared) >= _ENOUGH_IN_COMMON * len(own) and all(own[t] == theirs[t] for t in shared):
                group.append(name)
                theirs.update(own)
                break
        else:
            members.append([name])
            known.append(dict(own))
    groups = [
        Group(tuple(sorted(group)), merge_glances(glances[name] for name in sorted(group)))
        for group in members
    ]
    return sorted(groups, key=lambda group: (-len(group.recordings), group.recordings)), bare


def match_globs(recordings: Collection[str], others: Collection[str]) -> list[str]:
    """Return globs that match all of `recordings` and none of `others`, whole folders where possible."""
    if not others:
        return ["**"]
    globs: list[str] = []
    rest: list[str] = []
    for name in sorted(recordings):
        if any(matches(glob, name) for glob in globs):
            continue
        folder = next((f for f in _folders(name) if not any(o.startswith(f"{f}/") for o in others)), None)
        if folder is None:
            rest.append(name)
        else:
            globs.append(f"{_literal(folder)}/**")
    return sorted(globs + _compact(rest, others))


def _sensor_topics(glance: Glance) -> dict[str, str]:
    if not find_sensors(glance)[0]:
        return {}
    return {t.name: t.msgtype for t in glance.topics.values() if t.count > 0 and modality_of(t) is not None}


def _folders(name: str) -> list[str]:
    parts = name.split("/")[:-1]
    return ["/".join(parts[: n + 1]) for n in range(len(parts))]


def _compact(names: list[str], others: Collection[str]) -> list[str]:
    """Return one glob by common beginning if that is unambiguous, else the names themselves."""
    if len(names) > 1:
        common = os.path.commonprefix(names)  # noqa: RUF071  characters are meant
        folder, _, start = common.rpartition("/")
        # A prefix that ends inside a number would not match the next recording of the day.
        start = re.sub(r"\d+$", "", start)
        glob = f"{_literal(f'{folder}/{start}' if folder else start)}*"
        if (
            len(start) >= 3
            and all(matches(glob, n) for n in names)
            and not any(matches(glob, o) for o in others)
        ):
            return [glob]
    return [_literal(name) for name in names]


def _literal(name: str) -> str:
    """Return a glob that matches just this name."""
    return re.sub(r"([*?\[])", r"[\1]", name)
