"""What a dataset format is: one object that says what a dataset is made from, and how it is assembled and read.

A format is a Python package that defines one `Format`. Everything that all datasets need is shared: linking, swapping,
locks, duplicates, splits, and `verify`, `diff`, `restore` and `gc` (`bagassets.formats.assembly` and its neighbours).

On disk, a dataset has one folder that is swapped as a whole, so that readers see the old dataset or the new one. Files of
recordings are links to artifacts. A format puts them in one of three places:

- in the swapped folder, under any names: they are linked again with it;
- in one folder per recording, which appears and disappears whole, and whose name changes with its content
  (`UnitFolders`);
- elsewhere below the output, under names that change with their content (`LooseFiles`).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from bagassets.assets.asset import AnyAsset
from bagassets.assets.quality.finding import Finding
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.engine.plan import Plan
from bagassets.engine.splits import SplitShare
from bagassets.formats.json_files import TABLE, Frame
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_base import DatasetSettings
from bagassets.recipe.model_datasets import NamedDataset
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store

FACTS = "facts.json"
"""File of a recording's part: a JSON object with all that the format needs to know without reading the rest."""

S = TypeVar("S", bound=DatasetSettings)
Facts = JsonMapping
Samples = Mapping[str, Mapping[str, Mapping[str, str]]]
"""Scene -> sample -> part of it (its images, its poses) -> digest."""


@dataclass(frozen=True)
class Part:
    """A recording that may enter a dataset.

    Attributes:
        key: partition key.
        content: digest of the recording's content; recordings with equal content enter once.
        artifact: digest of the artifact that the dataset is made from.
    """

    key: str
    content: str
    artifact: str


class Link(NamedTuple):
    """A link from a dataset to a file in the store.

    Attributes:
        name: path below the swapped folder or, if the format defines `places`, below the output.
        artifact: digest of the file's artifact.
        file: its name in the artifact.
    """

    name: str
    artifact: str
    file: str


@dataclass(frozen=True)
class Entry:
    """A recording in a dataset as its lock describes it: enough to know which files are linked.

    Attributes:
        part: the recording.
        artifact: its part.
        split: its split.
        number: its position among all recordings in the order of their keys, from 0.
        row: its entry in the lock, with the values of `Format.row`.
    """

    part: Part
    artifact: Artifact
    split: str
    number: int
    row: Facts


@dataclass(frozen=True)
class Member(Entry):
    """A recording from which a dataset is assembled.

    Attributes:
        facts: content of `facts.json` of its part.
    """

    facts: Facts


@dataclass(frozen=True)
class Joined:
    """The result of `Format.join`.

    Attributes:
        files: file in the folder -> digest; equal digests mean equal datasets.
        facts: numbers and texts about the dataset, shown to users.
        beside: file below the output, outside the folder -> content, which does not depend on the recordings.
    """

    files: Mapping[str, str]
    facts: Facts = field(default_factory=dict)
    beside: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class ByGroups(Generic[S]):
    """A way to join that joins again only groups of recordings with changes, and copies the rows of the others.

    What a recording adds to files depends on nothing but the recording, its split and the settings.

    Attributes:
        files: settings and names of the splits -> the files that have rows of recordings.
        rows: settings, one of these files, a recording -> its rows there, as of `json_files.rows_text`.
        facts: the recordings of a group, settings -> what `frame` and `finish` have to know of them, as JSON.
        frame: one of the files, facts of all groups in order, shares -> what stands around its rows.
        finish: facts of all groups in order, settings, shares, file -> number of rows -> the other files.
    """

    files: Callable[[S, Sequence[str]], Sequence[str]]
    rows: Callable[[S, str, "Member"], bytes]
    facts: Callable[[Sequence["Member"], S], JsonObject]
    finish: Callable[[Sequence[Facts], S, Sequence[SplitShare], Mapping[str, int]], "Finished"]
    frame: Callable[[str, Sequence[Facts], Sequence[SplitShare]], Frame] = lambda *_: TABLE


@dataclass(frozen=True)
class Finished:
    """The result of `ByGroups.finish`.

    Attributes:
        files: file in the folder -> content.
        facts: see `Joined`.
        beside: see `Joined`.
    """

    files: Mapping[str, bytes]
    facts: Facts = field(default_factory=dict)
    beside: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class Kept:
    """Joined files of the dataset on disk that are as they were published, for formats that join large ones.

    Attributes:
        folder: the folder that is swapped.
        digests: file in it -> digest.
    """

    folder: Path = Path()
    digests: Mapping[str, str] = field(default_factory=dict)

    def path(self, name: str) -> Path:
        """Return the path of a file."""
        return self.folder / name


@dataclass(frozen=True)
class UnitFolders:
    """Links of a format with one folder per recording.

    Attributes:
        folder: folder below the output that contains the folders of recordings.
        name: name of the folder of a recording.
    """

    folder: str
    name: Callable[[Entry], str]

    def unit(self, entry: Entry) -> str:
        """Return the folder of a recording below the output."""
        return f"{self.folder}/{self.name(entry)}"


@dataclass(frozen=True)
class LooseFiles:
    """Links of a format that share folders; several versions of a dataset may share the links.

    Attributes:
        named_in: a swapped folder, old or new -> all links that its files name; none for any other folder.
        recording_of: name of a link -> key of its recording; None for any other file.
    """

    named_in: Callable[[Path], Iterable[str]]
    recording_of: Callable[[str], str | None]


@dataclass(frozen=True)
class Selection:
    """The part of the whole dataset that a named dataset takes.

    Attributes:
        parts: recordings in it, with their whole part or with one made from some of their scenes.
        skipped: recordings that are not in it at all -> reason.
        left_out: reason why scenes are not in it -> number of scenes.
    """

    parts: Sequence[Part]
    skipped: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class DatasetCheck:
    """A check of a finished dataset.

    Attributes:
        name: unique among the checks of the format; shown in Dagster.
        section: field of `checks` in the recipe with its severity.
        description: what is true of the dataset if it passes.
    """

    name: str
    section: str
    description: str


@dataclass(frozen=True)
class Format(Generic[S]):
    """A dataset format.

    Attributes:
        name: name of the format, and of its section in recipes and locks; the asset is `<name>_dataset`.
        version: raised whenever the bytes of a dataset change for the same parts.
        description: what the dataset is, for the web UI.
        kinds: tags of the asset in the web UI.
        settings: model of its section in the recipe.
        part: the asset of each recording from which the dataset is made; its artifact has a `facts.json`.
        join: writes the joined files of all recordings into an empty folder. Members come in the order of their keys,
            shares in the order of the splits' names. Or `ByGroups`, where a change is not to cost more the more recordings
            there are; such a format has `places`.
        links: the files of one recording.
        counts: facts of a recording -> what the dataset gets from it (`scenes`, in the plural) -> number.
        row: facts of a recording -> further values for its entry in the lock: small ones that `links` needs.
        duration_s: facts of a recording -> the duration that counts for the shares of the splits.
        folder: settings -> name of the swapped folder below the output.
        fills_split: facts of a recording -> whether it adds anything to the dataset; recordings that do not are dealt to
            splits after the others. None: all do.
        why_empty: facts of all recordings, recipe and its file -> why the dataset has nothing of them, and the way out, as the end of a
            sentence; "" if only that its settings leave nothing.
        named_by: fields of the settings that decide where the dataset is.
        places: where links are; None: in the swapped folder.
        folders: folders below the output that exist even if empty.
        samples: part -> its samples, for `dataset diff`; None if the format has none.
        select: selects the parts of a named dataset; None if the format has no named datasets.
        assets: assets of recordings that the format adds, its part among them unless bagassets has it.
        checks: checks of the finished dataset.
        check: settings and names of `checks` -> name -> finding. A format that joins `ByGroups` also gets what is on record
            of the dataset, if it is.
        distribution: name and version of the package that adds it; "" for formats of bagassets.
        rejoin: `join` that may link files from the dataset on disk, which other recordings did not change, instead of
            writing them again; what comes out must be the same. None: there is nothing to gain.
        misfits: recording -> facts, of all that are to be joined -> why some cannot be, as clauses; they are left out. None: all
            recordings fit.
    """

    name: str
    version: int
    description: str
    kinds: AbstractSet[str]
    settings: type[S]
    part: str
    join: Callable[[Sequence[Member], S, Sequence[SplitShare], Path], Joined] | ByGroups[S]
    links: Callable[[Entry], Iterator[Link]]
    counts: Callable[[Facts], Mapping[str, int]]
    duration_s: Callable[[Facts], float]
    folder: Callable[[S], str]
    row: Callable[[Facts], Facts] = lambda _facts: {}
    fills_split: Callable[[Facts], bool] | None = None
    why_empty: Callable[[Sequence[Facts], Recipe, Path], str] = lambda _facts, _recipe, _file: ""
    named_by: Sequence[str] = ("output",)
    places: UnitFolders | LooseFiles | None = None
    folders: Sequence[str] = ()
    samples: Callable[[Artifact], Samples] | None = None
    select: Callable[[Recipe, Store, Plan, Sequence[Part], NamedDataset], Selection] | None = None
    assets: Sequence[AnyAsset] = ()
    checks: Sequence[DatasetCheck] = ()
    check: Callable[..., Mapping[str, Finding]] | None = None
    distribution: str = ""
    rejoin: Callable[[Sequence[Member], S, Sequence[SplitShare], Path, Kept], Joined] | None = None
    misfits: Callable[[Mapping[str, Facts]], Mapping[str, str]] | None = None

    @property
    def asset(self) -> str:
        """Name of the dataset's asset in Dagster."""
        return f"{self.name}_dataset"

    @property
    def section(self) -> str:
        """Section of the recipe with its settings."""
        return f"formats.{self.name}" if self.distribution else self.name


AnyFormat = Format[Any]
"""A format with any model of settings."""
