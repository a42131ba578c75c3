"""The interface of steps that turn one channel of a recording into files.

Several extractors share one pass over the recording: it passes each message to the
extractors of its topic, in order of log time.
"""

from dataclasses import dataclass, field
from typing import Protocol

from bagassets.json_types import JsonObject
from bagassets.recordings.model import RawMessage

__all__ = ["ChannelExtractor", "Counts"]


@dataclass
class Counts:
    """Counts of one channel's messages: read = written + merged + sum of lost."""

    read: int = 0
    written: int = 0
    merged: int = 0
    lost: dict[str, int] = field(default_factory=dict)

    def lose(self, reason: str, number: int = 1) -> None:
        """Count lost messages by their reason."""
        self.lost[reason] = self.lost.get(reason, 0) + number

    @property
    def balanced(self) -> bool:
        """True if every message that was read is accounted for."""
        return self.read == self.written + self.merged + sum(self.lost.values())

    def as_json(self) -> JsonObject:
        """Return the counts as JSON."""
        return {"read": self.read, "written": self.written, "merged": self.merged, "lost": dict(self.lost)}


class ChannelExtractor(Protocol):
    """Turns the messages of one channel into files of one artifact."""

    topics: tuple[str, ...]

    def add(self, message: RawMessage) -> None:
        """Take the next message; `message.data` is only valid during the call."""
        ...

    def finish(self) -> JsonObject:
        """Write what is pending and the index; return the summary (with `counts`).

        Raises:
            LossLimitError: more messages were lost than the recipe allows, or counts do not add up.
        """
        ...
