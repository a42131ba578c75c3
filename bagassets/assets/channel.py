"""The interface of steps that turn one channel of a recording into files, and what they share.

Several extractors share one pass over the recording: it passes each message to the
extractors of its topic, in order of log time.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from bagassets.assets.face import Face, Loss, Table, counts_table, losses_of
from bagassets.base.errors import DecodeError
from bagassets.base.json_types import Json, JsonMapping, JsonObject
from bagassets.base.plugins import Family
from bagassets.decode.registry import AnyFamily, Decoder, advice, expected_types, find_decoder
from bagassets.recordings.model import RawMessage
from bagassets.store.artifact import Artifact

if TYPE_CHECKING:
    import pyarrow as pa
    from _typeshed import DataclassInstance

S = TypeVar("S", bound="DataclassInstance")
_OF_PACKETS = {"incomplete revolution", "position packet"}


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
    def main_reason(self) -> str:
        """The reason for which most were lost, the first of several; at least one was."""
        return max(self.lost, key=lambda reason: self.lost[reason])

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


def require_decoder(name: str, topic: str, msgtype: str, family: Family, *others: AnyFamily) -> Decoder:
    """Return the decoder of a channel's messages by their type, before any of them is read.

    Args:
        name: canonical channel.
        topic: topic of its messages.
        msgtype: type of its messages, `pkg/msg/Type`.
        family: family of decoders for the channel.
        others: further families that may decode it.

    Raises:
        DecodeError: none of the families has a decoder for messages of this type.
        PluginError: several decoder plug-ins claim the type.
    """
    for one in (family, *others):
        decoder = find_decoder(one, msgtype)
        if decoder is not None:
            return decoder
    raise DecodeError(
        f"{name} ({topic}): carries {msgtype}, expected {expected_types(family)}; {advice(family, msgtype)}"
    )


def settings_of(kind: type[S], given: Mapping[str, Any]) -> S:
    """Return settings from fields of the recipe, which have the same names."""
    return kind(**{own.name: given[own.name] for own in fields(kind)})


def counted_in_channel(counts: JsonMapping) -> str:
    """Return `message` or, by counts (merged, lost), `packet` where revolutions are made of packets: only those are merged."""
    return "packet" if counts.get("merged") or _OF_PACKETS & counts.get("lost", {}).keys() else "message"


def channel_face(files: str, columns: "pa.Schema") -> Face:
    """Return the face of an asset of channels.

    Args:
        files: what the files of its channels are called, in the plural.
        columns: of the index of a channel.
    """
    return Face(columns=columns, shown=_shown, counts={files: written}, losses=losses)


def _shown(artifact: Artifact) -> Mapping[str, Json | Table]:
    summary = dict(artifact.summary())
    channels = summary.pop("channels")
    named = {f"{name} ({counted_in_channel(counts)}s)": counts for name, counts in channels.items()}
    # Of all channels together: Dagster plots numbers, and no tables.
    lost = sum(sum(counts.get("lost", {}).values()) for counts in channels.values())
    written = sum(counts["written"] for counts in channels.values())
    return {"written": written, "lost": lost, "channels": counts_table(named, "channel"), **summary}


def written(summary: JsonMapping) -> int | None:
    """Return how many files of channels there are, or rows of signals; None if the summary does not say."""
    channels = summary.get("channels")
    return None if channels is None else sum(counts["written"] for counts in channels.values())


def losses(summary: JsonMapping) -> Iterator[Loss]:
    """Yield the losses of channels or signals."""
    for channel, counts in summary.get("channels", {}).items():
        yield from losses_of(channel, counts, counted_in_channel(counts))
