"""Topics and times of files whose names fit a series: from their indexes alone, and kept in the project's cache file."""

import json
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bagassets.base.cache import Cache, Changes
from bagassets.base.errors import BagAssetsError, DiskError
from bagassets.base.fingerprints import PlanNeeded
from bagassets.recipe.model import Bags, Limits
from bagassets.recordings.damage import refuse_pointer, unreadable
from bagassets.recordings.database_file import Database
from bagassets.recordings.mcap_file import McapFile
from bagassets.recordings.merge_topics import latched_topics
from bagassets.recordings.model import RecordingFiles
from bagassets.recordings.rosbag1 import IndexReader, SummaryReader
from bagassets.recordings.series import PartFacts, periods_matter

_KIND = "series 2"
# Fewer messages may be events, of which periods say nothing.
_REGULAR = 10
# The limits of the recipe are for whoever reads messages; an index is read whatever they are.
_ANY = Limits(chunk_bytes=4_000_000_000, compression_ratio=10**9, connections=10**9)


class ForNow(str):
    """Why a file cannot be read at the moment: next time it may be, with the same size and time."""

    __slots__ = ()


_Facts = PartFacts | ForNow | str


def facts_of_parts(parts: Sequence[RecordingFiles], bags: Bags) -> list[_Facts]:
    """Return topics and times of each file, or why they cannot be read; files are opened if they are new or have changed.

    Args:
        parts: recordings of one file each, of one folder and format.
        bags: of the recipe; the cache file is in the state folder of its project, if there is one.
    """
    group, kind = str(parts[0].path), _KIND if bags.recover == "refuse" else f"{_KIND}, {bags.recover}"
    seen = _load(bags.state, kind, group)
    facts: list[_Facts] = []
    for part in parts:
        size, mtime_ns, known = seen.get(part.relative, (-1, 0, ""))
        is_known = (size, mtime_ns) == (part.size, part.mtime_ns)
        facts.append(known if is_known else _settled_facts(part, bags))
    readable = [(number, one) for number, one in enumerate(facts) if isinstance(one, PartFacts)]
    for pair in pairwise(readable):
        for number, one in pair if periods_matter(pair[0][1], pair[1][1]) else ():
            if facts[number] is one and one.period_ns is None:
                facts[number] = _tried(parts[number].path, partial(_with_period, one))
    now = {
        part.relative: (part.size, part.mtime_ns, one)
        for part, one in zip(parts, facts, strict=True)
        if not isinstance(one, ForNow)
    }
    if now != seen and bags.state is not None and bags.state.is_dir():
        changes = Changes()
        changes.put(kind, group, json.dumps(now).encode())
        Cache(bags.state).write(changes)
    return facts


def _load(state: Path | None, kind: str, group: str) -> dict[str, tuple[int, int, _Facts]]:
    """Return path -> size, mtime (ns) and facts, as they were written last."""
    try:
        (text,) = Cache(state).get(kind, group) if state is not None else (b"{}",)
    except PlanNeeded:
        return {}
    return {
        path: (size, mtime_ns, facts if isinstance(facts, str) else PartFacts(*facts))
        for path, (size, mtime_ns, facts) in json.loads(text).items()
    }


def _settled_facts(part: RecordingFiles, bags: Bags) -> _Facts:
    """Return the facts of a file; while it is being written, it may be readable next time.

    While a log grows beside a database, each look would copy both.
    """
    is_settled = not 0 <= time.time() - part.mtime_ns / 1e9 < bags.settle_s
    if len(part.files) > 1 and not is_settled:
        return ForNow("its recorder may be at work")
    facts = part_facts(part.path)
    if isinstance(facts, str) and not isinstance(facts, ForNow) and is_settled and bags.recover != "refuse":
        salvaged = _tried(part.path, partial(_salvaged_facts, everything=bags.recover == "all"))
        facts = salvaged if isinstance(salvaged, PartFacts) else facts
    return ForNow(facts) if isinstance(facts, str) and not is_settled else facts


def part_facts(path: Path) -> _Facts:
    """Return topics and times of a file, or a clause that says why they cannot be read."""
    return _tried(path, _facts)


def _tried(path: Path, look: Callable[[Path], _Facts]) -> _Facts:
    try:
        refuse_pointer(path)
        return look(path)
    except OSError as err:
        return ForNow(err.strerror or err)
    except BagAssetsError as err:
        reason = str(err).removeprefix(f"{path}: ").rstrip(".")
        return ForNow(reason) if err.transient else reason
    except Exception as err:  # noqa: BLE001  (whatever the libraries raise on damaged bytes)
        try:
            refused = unreadable(path, err)
        except DiskError as failing:
            return ForNow(str(failing))
        return str(refused).rpartition(": it cannot be read (")[2].partition(");")[0]


def _facts(path: Path) -> _Facts:
    with closing(_opened(path, SummaryReader)) as file:
        sources, span_ns = file.sources().values(), file.span_ns()
    if span_ns is None:
        return "it has no messages"
    return PartFacts({one.topic: one.msgtype for one in sources}, latched_topics(sources), *span_ns)


def _salvaged_facts(path: Path, *, everything: bool) -> _Facts:
    """Return the facts of a damaged file, if builds will use what can be read of it."""
    from bagassets.recordings.salvage.open import open_salvaged  # noqa: PLC0415  (few are damaged)

    with open_salvaged(path) as opened:
        sources, span_ns, damage = (
            [one.source for one in opened.topics.values()],
            opened.span_ns(),
            opened.damage,
        )
    if span_ns is None or damage is None or not (everything or not damage.holes):
        return "it is damaged"
    topics = {one.topic: one.msgtype for one in sources}
    return PartFacts(topics, latched_topics(sources), *span_ns, period_ns=0)


def _with_period(facts: PartFacts, path: Path) -> PartFacts:
    """Return facts with the longest of the median periods of topics."""
    with closing(_opened(path, IndexReader)) as file:
        sources, times = file.sources(), file.log_times()
    of_topics: dict[str, list[NDArray[np.int64]]] = {}
    for number in times.keys() & sources.keys():
        of_topics.setdefault(sources[number].topic, []).append(times[number])
    together = [np.sort(np.concatenate(of_topics[topic])) for topic in of_topics.keys() - facts.latched]
    periods = [int(np.median(np.diff(one))) for one in together if len(one) >= _REGULAR]
    return facts._replace(period_ns=max(periods, default=0))


def _opened(path: Path, reader: type[IndexReader]) -> IndexReader | McapFile | Database:
    """Open a file, of a bag as much as this reader reads."""
    if path.suffix == ".mcap":
        return McapFile(path, _ANY, search=False)
    if path.suffix == ".db3":
        return Database(path, _ANY)
    return reader(path, _ANY)
