"""What people are shown of an asset: plain data, which the web UI, the report and the table of a build show each in its way."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from bagassets.base.json_types import Json, JsonMapping
from bagassets.store.artifact import Artifact

if TYPE_CHECKING:
    import pyarrow as pa


class Table(NamedTuple):
    """A table: the names of its columns, and rows of texts and numbers."""

    header: Sequence[str]
    rows: Sequence[Sequence[object]]


class Loss(NamedTuple):
    """What was lost of one channel or topic for one reason.

    Attributes:
        source: channel or topic.
        reason: why, as a clause.
        number: how many were lost.
        unit: what they are, in the singular, such as `message`.
    """

    source: str
    reason: str
    number: int
    unit: str = "message"


def losses_of(source: str, counts: JsonMapping, unit: str = "message") -> list[Loss]:
    """Return what was lost of a source, by its `Counts` as JSON."""
    return [Loss(source, reason, number, unit) for reason, number in counts.get("lost", {}).items()]


class Picture(NamedTuple):
    """A picture in an artifact: a name, a title, the file, and a small one of a few kilobytes."""

    name: str
    title: str
    large: str
    small: str


@dataclass(frozen=True, kw_only=True)
class Face:
    """What people are shown of an asset; without any of it, the summaries of its artifacts.

    Attributes:
        columns: of the table that an artifact holds.
        shown: artifact -> what the web UI shows of it, by name: what people look for first comes first.
        counts: what is counted, in the plural, such as `images` -> summary -> their number, or None if that does not say
            it. Each is a column in the table of a build and in the report, which adds them up.
        losses: summary -> what was lost.
        pictures: artifact -> its pictures.
        thumbnail: file with a very small picture of the recording.
        heading: of its column where there is little space; default: the last word of its name.
        operation: name of the operation that makes it, in runs on record; default: `make_<name>`.
    """

    columns: "pa.Schema | None" = None
    shown: "Callable[[Artifact], Mapping[str, Json | Table]]" = Artifact.summary
    counts: Mapping[str, Callable[[JsonMapping], int | None]] = field(default_factory=dict)
    losses: Callable[[JsonMapping], Iterable[Loss]] = lambda _: ()
    pictures: Callable[[Artifact], Sequence[Picture]] = lambda _: ()
    thumbnail: str | None = None
    heading: str = ""
    operation: str = ""


def counts_table(counts: Mapping[str, JsonMapping], name: str) -> Table:
    """Return a table of what was read of each channel or topic, written, merged, and lost for which reasons.

    Args:
        counts: channel or topic -> its `Counts`, as JSON.
        name: heading of the first column.
    """
    rows = []
    for key, entry in sorted(counts.items()):
        lost = ", ".join(f"{number} {reason}" for reason, number in sorted(entry.get("lost", {}).items()))
        rows.append((key, entry["read"], entry["written"], entry.get("merged", 0), lost or "none"))
    return Table((name, "read", "written", "merged", "lost"), rows)
