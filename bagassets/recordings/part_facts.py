"""Topics and times of files whose names fit a series, from their indexes alone, and remembered.

A sensor looks for recordings every few seconds, so a file is looked into once as long as it stays as it is: this process
remembers what it saw, and the project's cache file does so for the next one.
"""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from bagassets.freshness.cache import Cache, Changes
from bagassets.freshness.fingerprints import PlanNeeded
from bagassets.recordings.damage import refuse_pointer, unreadable
from bagassets.recordings.model import RecordingFiles
from bagassets.recordings.series import PartFacts

__all__ = ["facts_of_parts", "part_facts"]

_KIND = "series 1"
# Fewer messages may be events, of which the rate says nothing.
_REGULAR = 10
# Times of so many messages show the periods of a database, which has no counts.
_SAMPLE = 2000
_NO_MESSAGES = "it has no messages"

_Seen = dict[str, tuple[int, int, PartFacts | str]]  # path -> size, mtime (ns), what was seen
_seen: dict[str, _Seen] = {}


def facts_of_parts(parts: Sequence[RecordingFiles], state: Path | None) -> list[PartFacts | str]:
    """Return topics and times of each file, or why they cannot be read.

    Args:
        parts: recordings of one file each, of one folder and format.
        state: state folder of the project, whose cache file remembers them; None if there is no project.
    """
    group = str(parts[0].path)
    seen = _seen.setdefault(group, {})
    fresh = _unseen(seen, parts)
    if fresh and state is not None:
        seen.update(_load(state, group))
        fresh = _unseen(seen, fresh)
    unread: dict[str, str] = {}
    for part in fresh:
        try:
            seen[part.relative] = (part.size, part.mtime_ns, part_facts(part.path))
        except OSError as err:  # what is wrong now may be right next time, with the same size and time
            unread[part.relative] = err.strerror or str(err)
    if len(fresh) > len(unread) and state is not None and state.is_dir():
        changes = Changes()
        changes.put(_KIND, group, json.dumps(_as_json(seen)).encode())
        Cache(state).write(changes)
    return [unread[part.relative] if part.relative in unread else seen[part.relative][2] for part in parts]


def part_facts(path: Path) -> PartFacts | str:
    """Return topics and times of a file, or a clause that says why they cannot be read.

    Raises:
        OSError: the file cannot be opened or read at the moment.
    """
    readers: dict[str, Callable[[Path], PartFacts | str]] = {
        ".bag": _of_bag,
        ".mcap": _of_mcap,
        ".db3": _of_database,
    }
    try:
        refuse_pointer(path)
        return readers[path.suffix](path)
    except OSError:
        raise
    except Exception as err:  # noqa: BLE001  (whatever the libraries raise on damaged bytes)
        sentence = str(unreadable(path, err))
        return sentence.rpartition(": it cannot be read (")[2].partition(");")[0]


def _unseen(seen: _Seen, parts: Sequence[RecordingFiles]) -> list[RecordingFiles]:
    """Return the parts that were not looked into as they are."""
    before = ((part, seen.get(part.relative, (-1, 0, ""))) for part in parts)
    return [part for part, (size, mtime_ns, _) in before if part.size != size or part.mtime_ns != mtime_ns]


# --- formats -----------------------------------------------------------------------------


def _of_bag(path: Path) -> PartFacts | str:
    """Read the index at the end of a bag; the chunks, and the index of each, are not touched."""
    from bagassets.recordings.rosbag1 import read_summary  # noqa: PLC0415  (most folders have no series)

    start_ns, end_ns, connections = read_summary(path)
    if not connections:
        return _NO_MESSAGES
    counts: dict[str, int] = {}
    for one in connections:
        counts[one.topic] = counts.get(one.topic, 0) + one.messages
    latched = (one.topic for one in connections if one.latched)
    return _facts({one.topic: one.msgtype for one in connections}, latched, start_ns, end_ns, counts)


def _of_mcap(path: Path) -> PartFacts | str:
    from mcap.reader import make_reader  # noqa: PLC0415

    from bagassets.recordings.topic import normalise_msgtype  # noqa: PLC0415

    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    if summary is None or summary.statistics is None:
        return "it has no summary"
    numbers = summary.statistics
    if not numbers.message_count:
        return _NO_MESSAGES
    channels = summary.channels.values()
    types = {one.topic: schema.name for one in channels if (schema := summary.schemas.get(one.schema_id))}
    counts: dict[str, int] = {}
    for one in channels:
        counts[one.topic] = counts.get(one.topic, 0) + numbers.channel_message_counts.get(one.id, 0)
    latched = (one.topic for one in channels if _is_latched(one.metadata.get("offered_qos_profiles", "")))
    return _facts(
        {topic: normalise_msgtype(name) for topic, name in types.items()},
        latched,
        numbers.message_start_time,
        numbers.message_end_time,
        counts,
    )


def _of_database(path: Path) -> PartFacts | str:
    from bagassets.recipe.model import Limits  # noqa: PLC0415
    from bagassets.recordings.database_file import Database  # noqa: PLC0415

    with closing(Database(path, Limits())) as database:
        topics = {number: (name, msgtype) for number, (name, msgtype, _) in database.topics().items()}
        first = database.first_times(_SAMPLE)
        span_ns, qos = database.span_ns(), database.offered_qos()
    if span_ns is None:
        return _NO_MESSAGES
    latched = (topics[number][0] for number, text in qos.items() if number in topics and _is_latched(text))
    counts: dict[str, int] = {}
    for number, _ in first:
        if number in topics:
            counts[topics[number][0]] = counts.get(topics[number][0], 0) + 1
    sampled_ns = first[-1][1] - first[0][1]
    return _facts(dict(topics.values()), latched, *span_ns, counts, sampled_ns)


def _facts(
    topics: Mapping[str, str],
    latched: Iterable[str],
    start_ns: int,
    end_ns: int,
    counts: Mapping[str, int],
    counted_ns: int | None = None,
) -> PartFacts:
    """Return facts; `counts` are of messages within `counted_ns`, by default the whole time."""
    least = min((count for count in counts.values() if count >= _REGULAR), default=0)
    counted_ns = end_ns - start_ns if counted_ns is None else counted_ns
    static = (topic for topic in topics if topic.rpartition("/")[2] == "tf_static")
    period_ns = counted_ns // (least - 1) if least else 0
    return PartFacts(topics, frozenset((*latched, *static)), start_ns, end_ns, period_ns)


def _is_latched(qos: str) -> bool:
    """Tell whether offered QoS profiles are transient local: 1 in older recordings, a word in newer ones."""
    return "durability: 1" in qos or "durability: transient_local" in qos


# --- the cache file ----------------------------------------------------------------------


def _load(state: Path, group: str) -> _Seen:
    try:
        (text,) = Cache(state).get(_KIND, group)
    except PlanNeeded:
        return {}
    kept = json.loads(text)
    shared: list[tuple[Mapping[str, str], frozenset[str]]] = [
        (topics, frozenset(latched)) for topics, latched in kept["topics"]
    ]
    return {
        name: (size, mtime_ns, facts if isinstance(facts, str) else PartFacts(*shared[facts[0]], *facts[1:]))
        for name, size, mtime_ns, facts in kept["parts"]
    }


def _as_json(seen: _Seen) -> dict[str, Any]:
    """Return what was seen as JSON; parts have the same topics, which are written once."""
    topics: list[Any] = []
    parts = []
    for name, (size, mtime_ns, facts) in seen.items():
        row: object = facts
        if isinstance(facts, PartFacts):
            shared = [dict(facts.topics), sorted(facts.latched)]
            if shared not in topics:
                topics.append(shared)
            row = [topics.index(shared), facts.start_ns, facts.end_ns, facts.period_ns]
        parts.append([name, size, mtime_ns, row])
    return {"topics": topics, "parts": parts}
