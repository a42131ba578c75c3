"""A typed view of `inventory.json`: what one recording holds, topic by topic.

Steps plan from this view without opening the recording. It is made by
`bagassets.assets.inventory` and read back with `Inventory.from_json`.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Literal, Self

from bagassets.base.errors import RecordingError
from bagassets.base.json_types import JsonMapping
from bagassets.base.quantities import count_text
from bagassets.recordings.model import Definition, Format, Serialization
from bagassets.recordings.rewinds import Rewind
from bagassets.recordings.salvage.damage_map import DamageMap

Daylight = Literal["day", "night", "twilight"]
_DAY_S = 86_400.0


@dataclass(frozen=True, slots=True)
class Gap:
    """A pause of a topic, more than five times its median period.

    Attributes:
        start_ns: log time of the message before the pause.
        duration_s: time until the next message.
    """

    start_ns: int
    duration_s: float


@dataclass(frozen=True, slots=True)
class HeaderOffset:
    """Log time minus header stamp, in seconds, over the messages of a topic."""

    min: float
    median: float
    max: float


@dataclass(frozen=True, slots=True)
class GnssFix:
    """One GNSS fix: WGS84 degrees, ellipsoidal height in metres (null if not finite), header stamp."""

    lat: float
    lon: float
    alt: float | None
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class TopicRecord:
    """One topic of a recording.

    Attributes:
        name: topic as recorded.
        msgtype: normalised type, `pkg/msg/Type`.
        count: number of messages.
        bytes: their total serialized size.
        digest: BLAKE3 of the type and of (log time, payload) of each message in order.
        first_ns: log time of the first message; None if there are none.
        last_ns: log time of the last message; None if there are none.
        first_stamp_ns: smallest header stamp; None if the type has no header.
        last_stamp_ns: largest header stamp; None if the type has no header.
        rate_hz: messages per second of log time; None for fewer than two.
        max_gap_s: longest time between two messages; None for fewer than two.
        gaps: the first few pauses longer than five median periods.
        gap_count: number of such pauses.
        header_offset_s: log time minus header stamp; None without header.
        unordered_stamps: messages whose header stamp is smaller than the one before.
        frame_ids: the first few distinct frames, without leading slash.
        serialization: how messages are encoded: `ros1`, `cdr`, or what the file says.
        packed: its messages are kept in `messages.parquet`.
        problem: why its messages cannot be decoded; None if they can.
        definition: what its messages are decoded with.
        first_unordered_ns: the first header stamp that is smaller than the one before; None if there is none.
        period_ns: median time between two header stamps, of log times if the type has none; None for fewer than two.
        video: codec of the video that it carries although its type is one of images; None if it carries these.
    """

    name: str
    msgtype: str
    count: int
    bytes: int
    digest: str
    first_ns: int | None
    last_ns: int | None
    first_stamp_ns: int | None
    last_stamp_ns: int | None
    rate_hz: float | None
    max_gap_s: float | None
    gaps: tuple[Gap, ...]
    gap_count: int
    header_offset_s: HeaderOffset | None
    unordered_stamps: int
    frame_ids: tuple[str, ...]
    serialization: Serialization
    packed: bool
    problem: str | None
    definition: Definition
    first_unordered_ns: int | None = None
    period_ns: int | None = None
    video: str | None = None

    @classmethod
    def from_json(cls, value: JsonMapping) -> Self:
        """Return the record in one entry of `topics`."""
        fields = dict(value)
        offset = fields.pop("header_offset_s")
        return cls(
            msgtype=fields.pop("type"),
            gaps=tuple(Gap(**gap) for gap in fields.pop("gaps")),
            header_offset_s=None if offset is None else HeaderOffset(**offset),
            frame_ids=tuple(fields.pop("frame_ids")),
            definition=Definition(**fields.pop("definition")),
            **fields,
        )

    @property
    def starts_at_zero(self) -> bool:
        """Tell whether header stamps go on from 0, as in a simulation; those that are not set at first jump by decades."""
        offset = self.header_offset_s
        goes_on = self.first_stamp_ns == 0 != self.last_stamp_ns and not self.unordered_stamps
        return goes_on and offset is not None and offset.max - offset.min < _DAY_S

    @property
    def span_ns(self) -> int:
        """Log time from the first to the last message; 0 if there are fewer than two."""
        return 0 if self.first_ns is None or self.last_ns is None else self.last_ns - self.first_ns


@dataclass(frozen=True)
class Inventory:
    """What one recording holds.

    Attributes:
        format: ros1, ros2 or mcap.
        size: bytes of its files.
        start_ns: smallest log time; None if the recording is empty.
        end_ns: largest log time; None if the recording is empty.
        topics: name -> record, sorted by name.
        gnss: first and last valid fix of the recording; None without GNSS.
        daylight: by the elevation of the sun at the first fix; None without GNSS.
        notes: sentences about what is unusual, for people.
        damage: what is damaged, if it was read all the same.
        rewind: where log times go back in the order in which it was written; None if they do not.
    """

    format: Format
    size: int
    start_ns: int | None
    end_ns: int | None
    topics: Mapping[str, TopicRecord]
    gnss: tuple[GnssFix, GnssFix] | None
    daylight: Daylight | None
    notes: tuple[str, ...]
    damage: DamageMap | None = None
    rewind: Rewind | None = None

    @classmethod
    def from_json(cls, value: JsonMapping) -> Self:
        """Return the view of the content of `inventory.json`."""
        gnss = value["gnss"]
        topics = {entry["name"]: TopicRecord.from_json(entry) for entry in value["topics"]}
        return cls(
            format=value["format"],
            size=value["size"],
            start_ns=value["start_ns"],
            end_ns=value["end_ns"],
            topics=MappingProxyType(dict(sorted(topics.items()))),
            gnss=None if gnss is None else (GnssFix(**gnss["first"]), GnssFix(**gnss["last"])),
            daylight=value["daylight"],
            notes=tuple(value["notes"]),
            damage=DamageMap.from_json(value["damage"]) if "damage" in value else None,
            rewind=Rewind(**value["rewind"]) if "rewind" in value else None,
        )

    @property
    def span_ns(self) -> int:
        """Log time from the first to the last message; 0 for an empty recording."""
        return 0 if self.start_ns is None or self.end_ns is None else self.end_ns - self.start_ns

    @property
    def duration_s(self) -> float:
        """Span in seconds."""
        return self.span_ns / 1e9

    def topic(self, name: str) -> TopicRecord:
        """Return one topic.

        Raises:
            RecordingError: the recording has no such topic; the message names similar ones.
        """
        try:
            return self.topics[name]
        except KeyError:
            raise RecordingError(f"topic {name} is not in the recording{self._hint(name)}.") from None

    def has(self, name: str) -> bool:
        """Tell whether the recording has at least one message on a topic."""
        return name in self.topics and self.topics[name].count > 0

    def has_readable(self, name: str) -> bool:
        """Tell whether the recording has at least one message on a topic, and can decode it."""
        return self.has(name) and self.topics[name].problem is None

    def digests(self, topics: Collection[str]) -> dict[str, str]:
        """Return topic -> content digest; a topic that is not in the recording is left out.

        A step's action is keyed by these: a topic that appears, vanishes or changes re-keys it.
        """
        return {name: self.topics[name].digest for name in sorted(set(topics)) if name in self.topics}

    def of_type(self, *msgtypes: str) -> tuple[TopicRecord, ...]:
        """Return the topics of the given types, sorted by name."""
        return tuple(record for record in self.topics.values() if record.msgtype in msgtypes)

    def unpacked(self, topics: Iterable[str]) -> tuple[str, ...]:
        """Return those of `topics` that must be read from the recording itself."""
        return tuple(name for name in topics if name in self.topics and not self.topics[name].packed)

    @cached_property
    def definitions(self) -> dict[str, Definition]:
        """Type -> definition, over all topics."""
        return {record.msgtype: record.definition for record in self.topics.values()}

    def _hint(self, name: str) -> str:
        tail = name.rstrip("/").rsplit("/", 1)[-1].lower()
        alike = [known for known in self.topics if tail and tail in known.lower()]
        if alike:
            return f"; did you mean {' or '.join(alike[:3])}? Correct the recipe"
        return f"; it has {count_text(len(self.topics), 'topic')}, see `bagassets inspect`"
