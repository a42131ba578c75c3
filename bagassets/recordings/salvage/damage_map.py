"""The damage map of a recording: which bytes could not be read, when that was, and which messages are lost."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import NamedTuple, Self

from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.base.quantities import count_text

VERSION = 2
"""Of what salvage reads of a damaged recording, in the keys of such recordings alone; raise it if that changes."""

END_UNKNOWN = "nothing says where it ended"
CUT = "it is cut off"
NO_INDEX = "it has no index, as if its recorder had been stopped"
MOST_HOLES = 200  # of noise there may be millions; the rest is counted in the last one


@dataclass(slots=True)
class Hole:
    """A part of a file that cannot be read.

    Attributes:
        file: name of the file.
        begin: first byte.
        end: byte after the last one; that of a file that was cut is its length.
        reason: why, as a clause.
        start_ns: log time before which nothing is missing; None if unknown.
        end_ns: log time after which nothing is missing; None if unknown.
        lost: topic -> messages, "" for those of which the topic is unknown; None if their number is unknown, too.
    """

    file: str
    begin: int
    end: int
    reason: str
    start_ns: int | None = None
    end_ns: int | None = None
    lost: dict[str, int] | None = None


class Damage:
    """What is found damaged in a recording, noted by its readers while they scan and read; passes may repeat it."""

    def __init__(self) -> None:
        self.holes: dict[tuple[str, int], Hole] = {}
        self.findings: dict[str, None] = {}
        self.is_total_known = True
        # Whether all topics are counted elsewhere, those in holes of unknown topics included.
        self.is_listed = False

    def find(self, finding: str) -> None:
        """Note something that costs no message."""
        self.findings[finding] = None

    def end_unknown(self, file: str) -> None:
        """Note that nothing tells how many messages there were."""
        self.is_total_known = False
        self.find(f"{file}: {END_UNKNOWN}")

    def hole(self, hole: Hole, *, is_counted: bool = True) -> None:
        """Note a hole; one at the same place is replaced. Unless `is_counted`, nothing tells how many messages it cost."""
        self.is_total_known &= is_counted
        place = hole.file, hole.begin
        if place in self.holes or len(self.holes) < MOST_HOLES:
            self.holes[place] = hole
        else:
            *_, last = self.holes.values()
            last.end, last.lost, last.end_ns = max(last.end, hole.end), None, None
            last.reason = "there and from there on it is damaged in more places than are listed"

    def cost(self, hole: Hole, topic: str) -> None:
        """Count a message that a hole has cost."""
        self.hole(hole := self.holes.get((hole.file, hole.begin), hole))
        hole.lost = {**(hole.lost or {}), topic: (hole.lost or {}).get(topic, 0) + 1}

    def map(self, lost: Mapping[str, int], read: int) -> "DamageMap":
        """Return the map after a whole pass.

        Args:
            lost: topic -> messages that were announced and not read.
            read: number of messages that were read.
        """
        holes = tuple(sorted(self.holes.values(), key=lambda hole: (hole.file, hole.begin)))
        known = dict(sorted((topic, number) for topic, number in lost.items() if number > 0))
        unnamed = 0 if self.is_listed else sum((hole.lost or {}).get("", 0) for hole in holes)
        known |= {"": unnamed} if unnamed else {}
        return DamageMap(tuple(self.findings), holes, known, read, is_total_known=self.is_total_known)


@dataclass(frozen=True)
class DamageMap:
    """What is damaged in a recording, as its inventory holds it.

    Attributes:
        findings: clauses about what costs no message, such as a missing index.
        holes: parts that cannot be read.
        lost: topic -> messages that are known to be lost; "" for those of unknown topics.
        read: number of messages that were read.
        is_total_known: `read` and `lost` are all messages there ever were.
    """

    findings: tuple[str, ...]
    holes: tuple[Hole, ...]
    lost: Mapping[str, int] = field(default_factory=dict)
    read: int = 0
    is_total_known: bool = True

    @property
    def is_complete(self) -> bool:
        """Every record is whole to the last byte, and no count is contradicted."""
        return not self.holes and not self.lost

    def as_json(self) -> JsonObject:
        """Return it as JSON."""
        return asdict(self)

    @classmethod
    def from_json(cls, value: JsonMapping) -> Self:
        """Return what `as_json` gave."""
        holes = tuple(Hole(**hole) for hole in value["holes"])
        findings, lost = tuple(value["findings"]), dict(value["lost"])
        return cls(findings, holes, lost, value["read"], is_total_known=value["is_total_known"])

    def share(self) -> str:
        """Return a clause that says how many messages were read, and of how many."""
        lost = sum(self.lost.values())
        if self.is_total_known:
            return f"{self.read} of {count_text(self.read + lost, 'message')} can be read"
        least = f", at least {lost} are lost" if lost else ""
        return f"{count_text(self.read, 'message')} can be read{least}; how many there were is not known"

    def sentences(self) -> Iterator[str]:
        """Yield a sentence for each finding and hole, and one about all losses."""
        yield from (f"{finding}." for finding in self.findings)
        for hole in self.holes:
            lost = "" if hole.lost is None else f"; lost: {losses_text(hole.lost)}"
            yield f"{hole.file}: bytes {hole.begin} to {hole.end}: {hole.reason}{lost}."
        yield f"{self.share()}{f'; lost: {losses_text(self.lost)}' if self.lost else ''}."


def losses_text(lost: Mapping[str, int]) -> str:
    """Return topics and numbers of lost messages as text."""
    return (
        ", ".join(f"{number} of {topic or 'unknown topics'}" for topic, number in sorted(lost.items()))
        or "nothing"
    )


class Extent(NamedTuple):
    """A part of a file that was read: where it begins, and its first and last log time."""

    begin: int
    first_ns: int
    last_ns: int


def times_around(extents: Iterable[Extent], begin: int, end: int) -> tuple[int | None, int | None]:
    """Return the latest log time before a hole, and the earliest one after it; None where nothing is."""
    found = list(extents)
    before = [one.last_ns for one in found if one.begin < begin]
    after = [one.first_ns for one in found if one.begin >= end]
    return max(before, default=None), min(after, default=None)
