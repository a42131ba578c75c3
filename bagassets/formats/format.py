"""What a dataset format is: one object that says what a dataset is made from, and how it is put together and read.

A format is a folder of Python that ends in a `Format`. What every dataset needs is not in it but shared: linking,
exchanging, locks, duplicates, splits, and `verify`, `diff`, `restore` and `gc` (`bagassets.formats.assembly` and the
modules beside it).

On disk a dataset has one folder that is exchanged whole, so that readers see the old dataset or the new one. Files of
recordings are links to artifacts. A format has them in one of three places:

- in the folder that is exchanged, under any names: they are linked anew with it;
- in a folder of their recording, which appears and goes whole, and whose name changes with its content (`UnitFolders`);
- elsewhere below the output, under names that change with their content (`LooseFiles`).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from bagassets.assets.asset import AnyAsset
from bagassets.build.plan import Plan
from bagassets.json_types import JsonMapping
from bagassets.quality.finding import Finding
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_base import DatasetSettings
from bagassets.recipe.model_datasets import NamedDataset
from bagassets.splits import SplitShare
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store

__all__ = [
    "FACTS",
    "AnyFormat",
    "Entry",
    "Format",
    "Joined",
    "Link",
    "LooseFiles",
    "Member",
    "Part",
    "Samples",
    "Selection",
    "UnitFolders",
]

FACTS = "facts.json"
"""File of a recording's part: a JSON object with what the format wants to know of it, without reading the rest."""

S = TypeVar("S", bound=DatasetSettings)
Facts = JsonMapping
Samples = Mapping[str, Mapping[str, Mapping[str, str]]]
"""Scene -> sample -> what belongs to it (its images, its poses) -> digest."""


@dataclass(frozen=True)
class Part:
    """A recording that may enter a dataset.

    Attributes:
        key: partition key.
        content: digest of the recording's content; equal content enters once.
        artifact: digest of what the dataset is made from.
    """

    key: str
    content: str
    artifact: str


class Link(NamedTuple):
    """A file of a dataset that is linked from the store.

    Attributes:
        name: where it lies below the folder that is exchanged; of formats that say `places`, below the output.
        artifact: digest of the artifact that it is a file of.
        file: its name there.
    """

    name: str
    artifact: str
    file: str


@dataclass(frozen=True)
class Entry:
    """A recording in a dataset, as its lock tells: enough to say which files are linked.

    Attributes:
        part: the recording.
        artifact: its part.
        split: the split that it belongs to.
        number: its place among all, which are in the order of their keys; from 0.
        row: what the lock says of it, made by `Format.row`.
    """

    part: Part
    artifact: Artifact
    split: str
    number: int
    row: Facts


@dataclass(frozen=True)
class Member(Entry):
    """A recording that a dataset is put together from.

    Attributes:
        facts: content of `facts.json` of its part.
    """

    facts: Facts


@dataclass(frozen=True)
class Joined:
    """What `Format.join` wrote.

    Attributes:
        files: file in the folder -> digest; equal files mean equal datasets.
        facts: what people are told about the dataset.
        beside: file below the output, outside the folder -> its content, the same whatever the recordings.
    """

    files: Mapping[str, str]
    facts: Facts = field(default_factory=dict)
    beside: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class UnitFolders:
    """Links of a format whose recordings have a folder each.

    Attributes:
        folder: below the output; each folder in it is that of a recording.
        name: name of the folder of a recording.
    """

    folder: str
    name: Callable[[Entry], str]

    def unit(self, entry: Entry) -> str:
        """Return the folder of a recording below the output."""
        return f"{self.folder}/{self.name(entry)}"


@dataclass(frozen=True)
class LooseFiles:
    """Links of a format that lie in folders together; several versions of a dataset may share them.

    Attributes:
        named_in: folder that was or will be exchanged -> all links that its files name; none if it is no such folder.
        recording_of: name of a link -> key of its recording; None if it is no link.
    """

    named_in: Callable[[Path], Iterable[str]]
    recording_of: Callable[[str], str | None]


@dataclass(frozen=True)
class Selection:
    """What a named dataset takes of the whole one.

    Attributes:
        parts: recordings whose whole part belongs to it, or with a part of some of their scenes.
        skipped: recordings of which nothing belongs to it -> why.
        left_out: why scenes do not belong to it -> their number.
    """

    parts: Sequence[Part]
    skipped: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class DatasetCheck:
    """A check of a finished dataset.

    Attributes:
        name: unique among the checks of the format; shown in Dagster.
        section: field of the recipe's `checks` with its severity.
        description: what holds if it passes.
    """

    name: str
    section: str
    description: str


def _nothing(_: Facts) -> Facts:
    return {}


@dataclass(frozen=True)
class Format(Generic[S]):
    """A dataset format.

    Attributes:
        name: of the format, of its section in the recipe and in locks; the asset is `<name>_dataset`.
        version: raised whenever the bytes of a dataset change for the same parts.
        description: what the dataset is, for the web UI.
        kinds: tags of the asset in the web UI.
        settings: model of its section in the recipe.
        part: asset of each recording that the dataset is made from; its artifact has a `facts.json`.
        join: writes the files of all recordings together into an empty folder. The members are in the order of
            their keys, the shares in that of the splits.
        links: the files of one recording.
        counts: facts of a recording -> what it gives the dataset, in the plural -> how many.
        row: facts of a recording -> what the lock tells of it besides: small values that `links` needs.
        duration_s: facts of a recording -> time that counts for the shares of the splits.
        folder: settings -> name of the folder below the output that is exchanged.
        fills_split: facts of a recording -> whether it gives this dataset anything; those that give nothing are dealt
            to splits after the others. None: all do.
        named_by: fields of the settings that say where the dataset lies.
        places: where links lie; None: in the folder that is exchanged.
        folders: folders below the output that are there even if empty.
        samples: part -> its samples, for `dataset diff`; None if the format does not tell them apart.
        select: chooses what a named dataset takes of the parts; None if there are no named datasets of the format.
        assets: assets of recordings that it brings, the part among them, unless bagassets has them.
        checks: checks of the finished dataset.
        check: output and settings of a dataset -> check -> what it found, of those of `checks` that are asked for.
        distribution: name and version of the package that it came from; "" for those of bagassets.
    """

    name: str
    version: int
    description: str
    kinds: AbstractSet[str]
    settings: type[S]
    part: str
    join: Callable[[Sequence[Member], S, Sequence[SplitShare], Path], Joined]
    links: Callable[[Entry], Iterator[Link]]
    counts: Callable[[Facts], Mapping[str, int]]
    duration_s: Callable[[Facts], float]
    folder: Callable[[S], str]
    row: Callable[[Facts], Facts] = _nothing
    fills_split: Callable[[Facts], bool] | None = None
    named_by: Sequence[str] = ("output",)
    places: UnitFolders | LooseFiles | None = None
    folders: Sequence[str] = ()
    samples: Callable[[Artifact], Samples] | None = None
    select: Callable[[Recipe, Store, Plan, Sequence[Part], NamedDataset], Selection] | None = None
    assets: Sequence[AnyAsset] = ()
    checks: Sequence[DatasetCheck] = ()
    check: Callable[[S, AbstractSet[str]], Mapping[str, Finding]] | None = None
    distribution: str = ""

    @property
    def asset(self) -> str:
        """Name of the dataset's asset in Dagster."""
        return f"{self.name}_dataset"

    @property
    def section(self) -> str:
        """Where the recipe has its settings."""
        return f"formats.{self.name}" if self.distribution else self.name

    def link_path(self, output: Path, folder: Path, link: Link) -> Path:
        """Return where a link lies.

        Args:
            output: of the dataset.
            folder: the folder below it that is exchanged.
            link: one of `links`.
        """
        return (folder if self.places is None else output) / link.name


AnyFormat = Format[Any]
"""A format, whatever the model of its section is."""
