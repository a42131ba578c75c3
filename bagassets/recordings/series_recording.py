"""A drive in several files, read as one recording: parts follow each other, and where they overlap, messages are merged."""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from operator import attrgetter
from pathlib import Path

from bagassets.base.errors import RecordingError
from bagassets.recordings.merge_topics import latched_topics, merge_topics
from bagassets.recordings.model import RawMessage, RecordingFiles
from bagassets.recordings.recording import How, Recording, merged
from bagassets.recordings.rewinds import Rewind
from bagassets.recordings.topic import TopicSource
from bagassets.store.canonical import digest_bytes

# Recorders repeat latched messages before anything else that they write to a new file.
_HEAD_NS = 1_000_000_000
# The indexes of so many parts are read once, those of others whenever their messages are due: there may be thousands.
_KEPT_OPEN = 32


class SeriesRecording(Recording):
    """The parts of a drive.

    Latched messages that a recorder repeated at the beginning of a part count once: whoever reads all parts has them already.

    Args:
        recording: the whole drive.
        parts: those of its files that can be read, in any order: messages are read in order of log time.
        open_part: opens one.
        how: how they are opened.

    Raises:
        RecordingError: a part cannot be read.
    """

    def __init__(
        self,
        recording: RecordingFiles,
        parts: Sequence[Path],
        open_part: Callable[[Path], Recording],
        how: How,
    ) -> None:
        self._open_part = open_part
        self._checks_content = False
        self._stack = ExitStack()
        self._kept: dict[Path, Recording] = {}
        self._parts: list[tuple[int, int, Path]] = []
        try:
            sources = [one for number, part in enumerate(parts) for one in self._taken_in(number, part)]
            self._parts.sort()
            self._latched = latched_topics(sources)
            path = recording.path
            topics = merge_topics(path, sources, how.message_definitions, how.limits)
            super().__init__(path, recording.format, topics)
        except BaseException:
            self.close()
            raise

    def _taken_in(self, number: int, part: Path) -> list[TopicSource]:
        """Note when a part begins, and return its topics."""
        with self._opened(part) as opened:
            sources, span_ns = [topic.source for topic in opened.topics.values()], opened.span_ns()
        if span_ns is not None:
            self._parts.append((span_ns[0], number, part))
        elif any(source.count for source in sources):
            raise RecordingError(
                f"{part}: it cannot be read as a part of a drive, as it does not say when it begins; have it written again with "
                "its summary, such as by `mcap recover`."
            )
        return sources

    def _opened(self, part: Path) -> AbstractContextManager[Recording]:
        if part not in self._kept:
            opened = self._open_part(part)
            if len(self._kept) == _KEPT_OPEN:
                return opened
            self._kept[part] = self._stack.enter_context(opened)
        return nullcontext(self._kept[part])

    def check_content(self) -> None:
        """Verify checksums in all parts."""
        self._checks_content = True

    def _guarded(self, topics: Collection[str]) -> Iterator[RawMessage]:
        return self._read(topics)  # the parts check each message, and name themselves

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        seen: dict[str, set[str]] = {topic: set() for topic in topics if topic in self._latched}
        self.repeated.clear()
        streams = [
            (start_ns, number, self._of_part(part, topics, seen, start_ns))
            for start_ns, number, part in self._parts
        ]
        yield from merged(streams, attrgetter("log_time_ns"))

    def _of_part(
        self, path: Path, topics: Collection[str], seen: dict[str, set[str]], start_ns: int
    ) -> Iterator[RawMessage]:
        """Yield the messages of a part, without those that the recorder repeated."""
        is_first = path == self._parts[0][2]
        with self._opened(path) as part:
            if self._checks_content:
                part.check_content()
            within = [topic for topic in topics if topic in part.topics]
            others = {topic for topic in within if part.topics[topic].msgtype != self.topics[topic].msgtype}
            if not seen and not others:
                yield from part.messages(within)
                return
            for message in part.messages(within):
                topic = message.topic
                if topic in seen:
                    digest = digest_bytes(bytes(message.data))
                    is_head = not is_first and message.log_time_ns <= start_ns + _HEAD_NS
                    if is_head and digest in seen[topic]:
                        self.repeated[topic] += 1
                        continue
                    seen[topic].add(digest)
                if topic in others:
                    named = message._replace(msgtype=self.topics[topic].type_of(message.msgtype))
                    yield self._checked(named, len(message.data))
                else:
                    yield message

    def rewind(self) -> Rewind | None:
        """Return where log times go back in the order in which one of its parts was written."""
        for _, _, path in self._parts:
            with self._opened(path) as part:
                if (found := part.rewind()) is not None:
                    return found
        return None

    def close(self) -> None:
        """Close the parts."""
        self._stack.close()
