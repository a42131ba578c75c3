"""Topics and times of files whose names fit a series, from their indexes alone, and remembered.

A sensor looks for recordings every few seconds, so a file is looked into once as long as it stays as it is: this process
remembers what it saw, and the project's cache file does so for the next one.
"""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path

from bagassets.freshness.cache import Cache, Changes
from bagassets.freshness.fingerprints import PlanNeeded
from bagassets.recipe.model import Limits
from bagassets.recordings.damage import refuse_pointer, unreadable
from bagassets.recordings.journals import journals_of
from bagassets.recordings.model import RecordingFiles
from bagassets.recordings.series import PartFacts
from bagassets.recordings.topic import normalise_msgtype

__all__ = ["facts_of_parts", "part_facts"]

_KIND = "series 1"
# Fewer messages may be events, of which the rate says nothing.
_REGULAR = 10
# Times of so many messages show the periods of a database, which has no counts.
_SAMPLE = 2000

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
    unread: dict[str, str] = {}
    fresh = _unseen(seen, parts)
    if fresh:
        seen.update(_load(state, group))
        fresh = _unseen(seen, fresh)
    for part in fresh:
        try:
            seen[part.relative] = (part.size, part.mtime_ns, part_facts(part.path))
        except OSError as err:  # what is wrong now may be right next time, with the same size and time
            unread[part.relative] = err.strerror or str(err)
    if len(fresh) > len(unread) and state is not None and state.is_dir():
        changes = Changes()
        changes.put(_KIND, group, json.dumps(seen).encode())
        Cache(state).write(changes)
    return [unread.get(part.relative) or seen[part.relative][2] for part in parts]


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
    none = (-1, 0, "")
    return [part for part in parts if seen.get(part.relative, none)[:2] != (part.size, part.mtime_ns)]


def _load(state: Path | None, group: str) -> _Seen:
    """Return what another process saw."""
    if state is None:
        return {}
    try:
        (text,) = Cache(state).get(_KIND, group)
    except PlanNeeded:
        return {}
    return {
        path: (size, mtime_ns, facts if isinstance(facts, str) else PartFacts(*facts))
        for path, (size, mtime_ns, facts) in json.loads(text).items()
    }


# --- formats -----------------------------------------------------------------------------


def _of_bag(path: Path) -> PartFacts | str:
    """Read the index at the end of a bag; the chunks, and the index of each, are not touched."""
    from bagassets.recordings.rosbag1 import read_summary  # noqa: PLC0415

    connections, numbers, start_ns, end_ns = read_summary(path, Limits())
    topics = {one.topic: one.msgtype for one in connections}
    latched = [one.topic for one in connections if getattr(one.ext, "latching", 0)]
    counts: Counter[str] = Counter()
    for one in connections:
        counts[one.topic] += numbers[one.id]
    return _facts(topics, latched, (start_ns, end_ns) if numbers else None, counts)


def _of_mcap(path: Path) -> PartFacts | str:
    from mcap.reader import make_reader  # noqa: PLC0415  (most folders have no series)

    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    if summary is None or summary.statistics is None:
        return "it has no summary"
    numbers, channels = summary.statistics, summary.channels.values()
    schemas = {number: schema.name for number, schema in summary.schemas.items()}
    topics = {one.topic: schemas.get(one.schema_id, "unknown") for one in channels}
    latched = [one.topic for one in channels if _is_latched(one.metadata.get("offered_qos_profiles", ""))]
    counts: Counter[str] = Counter()
    for one in channels:
        counts[one.topic] += numbers.channel_message_counts.get(one.id, 0)
    span_ns = (numbers.message_start_time, numbers.message_end_time) if numbers.message_count else None
    return _facts(topics, latched, span_ns, counts)


def _of_database(path: Path) -> PartFacts | str:
    from bagassets.recordings.database_file import Database  # noqa: PLC0415

    if journals_of([path]):  # to apply it takes a copy, and while a recorder writes, one at each look
        return "a recorder left its log beside it"
    with closing(Database(path, Limits())) as database:
        named = {number: (one.topic, one.msgtype) for number, one in database.sources().items()}
        first = database.first_times(_SAMPLE)
        span_ns, qos = database.span_ns(), database.offered_qos()
    latched = [named[number][0] for number, text in qos.items() if _is_latched(text)]
    counts = Counter(named[number][0] for number, _ in first if number in named)
    return _facts(dict(named.values()), latched, span_ns, counts, first[-1][1] - first[0][1] if first else 0)


def _facts(
    topics: Mapping[str, str],
    latched: Sequence[str],
    span_ns: tuple[int, int] | None,
    counts: Mapping[str, int],
    counted_ns: int | None = None,
) -> PartFacts | str:
    """Return facts; `counts` are of messages within `counted_ns`, by default the whole time."""
    if span_ns is None:
        return "it has no messages"
    start_ns, end_ns = span_ns
    normal = {topic: normalise_msgtype(msgtype) for topic, msgtype in topics.items()}
    static = [topic for topic in topics if topic.rpartition("/")[2] == "tf_static"]
    least = min((count for count in counts.values() if count >= _REGULAR), default=0)
    counted_ns = end_ns - start_ns if counted_ns is None else counted_ns
    period_ns = counted_ns // (least - 1) if least else 0
    return PartFacts(normal, sorted({*latched, *static}), start_ns, end_ns, period_ns)


def _is_latched(qos: str) -> bool:
    """Tell whether offered QoS profiles are transient local: 1 in older recordings, a word in newer ones."""
    return "durability: 1" in qos or "durability: transient_local" in qos
