"""Episodes in a joined dataset, and the files that they share."""

from collections.abc import Sequence
from dataclasses import dataclass

from bagassets.base.json_types import JsonMapping
from bagassets.formats.format import Member


@dataclass(frozen=True)
class Episode:
    """An episode in the dataset.

    Attributes:
        index: its number.
        first: number of its first frame.
        member: its recording.
        number: its number in the recording.
        offset: its first row in the recording's part.
        facts: from `episodes.json` of the part.
        task: number of its task.
    """

    index: int
    first: int
    member: Member
    number: int
    offset: int
    facts: JsonMapping
    task: int

    @property
    def length(self) -> int:
        """Number of its frames."""
        length: int = self.facts["length"]
        return length

    @property
    def name(self) -> str:
        """Its name among all."""
        return f"{self.member.part.key}/{self.number}"


@dataclass(frozen=True)
class File:
    """A file that several episodes share.

    Attributes:
        name: its path in the dataset.
        place: number of its chunk, and of the file in it.
        episodes: the episodes in it, in order.
    """

    name: str
    place: tuple[int, int]
    episodes: Sequence[Episode]
