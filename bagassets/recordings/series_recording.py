"""A drive in several files, read as one recording: parts follow each other, and where they overlap, messages are merged."""

import heapq
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path

from bagassets.errors import RecordingError
from bagassets.recipe.model import Limits
from bagassets.recordings.model import Format, RawMessage
from bagassets.recordings.part_facts import part_facts
from bagassets.recordings.recording import Recording
from bagassets.recordings.series import PartFacts
from bagassets.recordings.topic import TopicSource, merge_topics
from bagassets.store.canonical import digest_bytes

__all__ = ["SeriesRecording"]

# Recorders repeat latched messages before anything else that they write to a new file.
_HEAD_NS = 1_000_000_000


class SeriesRecording(Recording):
    """The parts of a drive.

    A part is open only while its messages are due, so that there may be thousands. Latched messages that a recorder repeated
    at the beginning of a part count once: whoever reads all parts has them already.

    Args:
        path: where the whole drive would be.
        file_format: of the parts.
        parts: the files, in any order: messages are read in order of log time.
        open_part: opens one.
        message_definitions: folders of `.msg` files.
        limits: of the recipe.

    Raises:
        RecordingError: a part cannot be read.
    """

    def __init__(
        self,
        path: Path,
        file_format: Format,
        parts: Sequence[Path],
        open_part: Callable[[Path], Recording],
        message_definitions: Sequence[Path],
        limits: Limits,
    ) -> None:
        self._open_part = open_part
        self._checks_content = False
        self._parts: list[tuple[int, int, Path]] = []
        self._latched: set[str] = set()
        sources: list[TopicSource] = []
        for number, part in enumerate(parts):
            with open_part(part) as opened:
                sources += [topic.source for topic in opened.topics.values()]
            facts = _facts(part)
            if isinstance(facts, PartFacts):
                self._parts.append((facts.start_ns, number, part))
                self._latched.update(facts.latched)
            elif any(topic.count for topic in opened.topics.values()):
                raise RecordingError(f"{part}: it cannot be read as a part of {path.name} ({facts}).")
        self._parts.sort()
        super().__init__(path, file_format, merge_topics(path, sources, message_definitions, limits))

    def check_content(self) -> None:
        """Verify checksums in all parts."""
        self._checks_content = True

    def _guarded(self, topics: Collection[str]) -> Iterator[RawMessage]:
        return self._read(topics)  # the parts check each message, and name themselves

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        seen: dict[str, set[str]] = {topic: set() for topic in self._latched.intersection(topics)}
        self.repeated.clear()
        waiting = list(reversed(self._parts))
        reading: list[tuple[int, int, RawMessage, Iterator[RawMessage]]] = []
        while waiting or reading:
            while waiting and (not reading or waiting[-1][0] <= reading[0][0]):
                start_ns, number, part = waiting.pop()
                _push(reading, number, self._of_part(part, topics, seen, start_ns))
            if not reading:
                return
            time_ns, number, message, stream = heapq.heappop(reading)
            due_ns = min([*(one[0] for one in reading), *(one[0] for one in waiting[-1:])], default=None)
            while True:
                yield message
                following = next(stream, None)
                if following is None:
                    break
                message, time_ns = following, following.log_time_ns
                if due_ns is not None and time_ns >= due_ns:
                    heapq.heappush(reading, (time_ns, number, message, stream))
                    break

    def _of_part(
        self, path: Path, topics: Collection[str], seen: dict[str, set[str]], start_ns: int
    ) -> Iterator[RawMessage]:
        """Yield the messages of a part, without those that the recorder repeated."""
        is_first = path == self._parts[0][2]
        types = {topic: self.topics[topic].msgtype for topic in topics}
        with self._open_part(path) as part:
            if self._checks_content:
                part.check_content()
            for message in part.messages([topic for topic in topics if topic in part.topics]):
                topic = message.topic
                if topic in seen:
                    digest = digest_bytes(bytes(message.data))
                    is_head = not is_first and message.log_time_ns <= start_ns + _HEAD_NS
                    if is_head and digest in seen[topic]:
                        self.repeated[topic] += 1
                        continue
                    seen[topic].add(digest)
                yield message if message.msgtype == types[topic] else message._replace(msgtype=types[topic])

    def close(self) -> None:
        """Do nothing: parts are open during reads only."""


def _facts(part: Path) -> PartFacts | str:
    try:
        return part_facts(part)
    except OSError as err:
        return err.strerror or str(err)


def _push(
    reading: list[tuple[int, int, RawMessage, Iterator[RawMessage]]],
    number: int,
    stream: Iterator[RawMessage],
) -> None:
    first = next(stream, None)
    if first is not None:
        heapq.heappush(reading, (first.log_time_ns, number, first, stream))
