"""What an asset of a recording is: one object, defined at the end of the asset's own module.

An asset sees the recipe only through `Asset.params`, which returns its parameters: a frozen dataclass in normal form.
Their digest over all rigs is part of Dagster's code version (see `bagassets.engine.recording_assets`). `Asset.use` narrows
the parameters to one recording: the topics, upstream artifacts, single upstream facts and files that an action reads,
from which the action's digest is computed. `Asset.make` gets just that. So the code version differs whenever an action
does; it may also differ when no action does, for example for a rig that made none of the recordings.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from functools import cache
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from pydantic import BaseModel

from bagassets.assets.boxes.files.find import LabelSet
from bagassets.assets.channel import ChannelExtractor
from bagassets.assets.face import Face
from bagassets.assets.quality.check import RecordingCheck
from bagassets.base.json_types import Json, JsonObject
from bagassets.base.plugins import Family
from bagassets.geometry.calibration import Calibration
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import Recipe, Rig
from bagassets.recipe.model_annotations import AnnotationFiles
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.model import Format
from bagassets.recordings.recording import Recording
from bagassets.store.action import Action, Step
from bagassets.store.artifact import Artifact, ArtifactWriter

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

C = TypeVar("C")
P = TypeVar("P")
U = TypeVar("U")
U_co = TypeVar("U_co", covariant=True)

Summary = JsonObject
"""Counts and other small facts that an artifact's manifest keeps, as JSON."""

# Metadata of the fields of parameters.
_OMITTED, _INLINED, _WITHOUT, _BY_DIGEST = "omitted", "inlined", "without", "by digest"


def omitted(default: object = None) -> Any:
    """Return a dataclass field that is left out of JSON while it has its default value.

    For fields that were added after actions had been recorded, and for those that only some recordings have: the
    digests of all other actions stay the same.
    """
    return field(default=default, metadata={_OMITTED: True})


def inlined(*, without: Collection[str] = ()) -> Any:
    """Return a dataclass field whose value is an object that is merged with the other fields in JSON.

    Later fields replace entries of the same name. The value may be None, which has no entries.

    Args:
        without: entries that are left out.
    """
    return field(metadata={_INLINED: True, _WITHOUT: frozenset(without)})


def by_digest(default: object = MISSING) -> Any:
    """Return a dataclass field that is left out of JSON, since the digest of its value is among `Use.inputs`.

    For the content or the paths of files beside the recipe or the recording.
    """
    return field(default=default, metadata={_BY_DIGEST: True})


def for_messages(default: object) -> Any:
    """Return a dataclass field that is left out of JSON, since it appears in messages only and shapes no byte."""
    return field(default=default, metadata={_BY_DIGEST: True})


def as_json(value: object) -> Json:
    """Return parameters as JSON: dataclasses and recipe models as objects, paths and sets as text and sorted lists.

    Raises:
        TypeError: a value cannot be converted.
    """
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return _object(value)
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return {str(key): as_json(item) for key, item in value.items()}
    if isinstance(value, set | frozenset):
        return sorted(as_json(item) for item in value)
    if isinstance(value, PurePath):
        return value.as_posix()
    if isinstance(value, Iterable):
        return [as_json(item) for item in value]
    raise TypeError(f"{type(value).__name__} cannot be a parameter")


def _object(value: "DataclassInstance") -> JsonObject:
    entries: JsonObject = {}
    for own in _shown_fields(type(value)):
        item = getattr(value, own.name)
        if own.metadata.get(_INLINED):
            inner = {} if item is None else as_json(item)
            entries |= {name: value for name, value in inner.items() if name not in own.metadata[_WITHOUT]}
        elif not (own.metadata.get(_OMITTED) and item == own.default):
            entries[own.name] = as_json(item)
    return entries


@cache
def _shown_fields(kind: "type[DataclassInstance]") -> "tuple[Field[Any], ...]":
    """Return the fields that JSON may show; every plan asks for them thousands of times."""
    return tuple(own for own in fields(kind) if not own.metadata.get(_BY_DIGEST))


@dataclass(frozen=True)
class Use(Generic[U_co]):
    """Everything that one action reads, known before it runs; its digest is computed from exactly this.

    Attributes:
        params: parameters from the recipe, and single upstream facts, that shape the result.
        topics: topics of the recording that are read; their content digests are part of the action.
        inputs: other inputs, name -> content digest.
    """

    params: U_co
    topics: tuple[str, ...] = ()
    inputs: Mapping[str, str] = field(default_factory=dict)


AnyUse = Use[Any]
"""A use, whatever its parameters are."""


def uses_of(channels: Mapping[str, C], use_of: Callable[[str, C], Use[U]]) -> dict[str, Use[U] | Exception]:
    """Return channel -> what its action reads, or why it cannot be made, which affects that channel only.

    Args:
        channels: channel -> its settings.
        use_of: returns what the action of one channel reads.
    """
    uses: dict[str, Use[U] | Exception] = {}
    for name, settings in channels.items():
        try:
            uses[name] = use_of(name, settings)
        except Exception as err:  # noqa: BLE001  (whatever it is, it costs no more than this channel)
            uses[name] = err
    return uses


class StoredFacts(Protocol):
    """Facts about a recording that the store alone can provide."""

    @property
    def inventory(self) -> Inventory:
        """Its topics and time span."""
        ...

    def artifact(self, asset: str) -> Artifact:
        """Return the artifact of an upstream asset.

        Raises:
            StoreError: it has not been made yet.
        """
        ...


class Facts(StoredFacts, Protocol):
    """Facts about a recording that are known before an action runs: from upstream assets and files beside it.

    Reading them does not open the recording. An asset may only ask for what it declares to read.
    """

    @property
    def key(self) -> str:
        """Partition key."""
        ...

    @property
    def format(self) -> Format:
        """The format in which the recording is read."""
        ...

    @property
    def digest(self) -> str:
        """Digest of the recording's content, the data version of `bag`."""
        ...

    @property
    def calibration(self) -> Calibration:
        """Content of `calibration.json`."""
        ...

    def channels(self, asset: str) -> Mapping[str, Artifact]:
        """Return channel -> artifact of an upstream asset that consists of channels."""
        ...

    def labels(self, sources: Iterable[AnnotationFiles]) -> Mapping[str, LabelSet]:
        """Return source -> label files that lie beside the recording."""
        ...

    def definitions(self, folders: Iterable[Path]) -> Mapping[str, str]:
        """Return name below its folder -> digest for each message definition file in `folders`."""
        ...

    def file(self, path: Path) -> bytes:
        """Return the content of a file that the recipe names.

        Raises:
            OSError: it cannot be read.
        """
        ...


class StoredInputs(StoredFacts, Protocol):
    """Inputs of a running action that the store alone can provide."""

    @property
    def trajectory(self) -> Trajectory:
        """`global_SE3_ego`, the content of `ego_poses`."""
        ...

    def messages(self, topics: tuple[str, ...]) -> AbstractContextManager[Recording]:
        """Open `topics` of the recording, from wherever they are cheapest to read; no others can be read."""
        ...


class Inputs(Facts, StoredInputs, Protocol):
    """The inputs of a running action."""

    @property
    def size(self) -> int:
        """Bytes of the recording's files."""
        ...

    def whole(self, *, salvaged: bool = False) -> AbstractContextManager[Recording]:
        """Open the whole recording; `salvaged` for what can be read of a damaged one."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Asset(Generic[P, U]):
    """An asset that every recording has, one artifact each.

    Attributes:
        name: name of the asset, and of the step of its actions; stable for ever.
        version: raised whenever the bytes of its artifacts change; a golden test guards it.
        libraries: distributions whose version shapes the bytes.
        title: one sentence that says what it is.
        description: its content and its files, for the web UI, where it follows the title.
        kinds: kinds that the web UI shows.
        face: what people are shown of its artifacts.
        reads: the upstream assets.
        waits_for: returns the names of those of `reads` that it needs under its parameters, for a recording with this
            inventory; the inventory is None while it is not known. Default: all.
        families: families of messages that decoder plug-ins may decode for it.
        enabled: returns whether recordings have it under a recipe.
        optional: True if no dataset but its own depends on it; its failures keep no recording out of the others.
        distribution: name and version of the package that it came from; "" for those of bagassets.
        params: returns everything of a recipe and one of its rigs that the asset may know.
        use: returns what its actions read of one recording, or the error that they fail with: by channel for an asset
            of channels, one for each channel that the recording has; under "" for any other asset.
        make: writes the artifact of an action and returns its summary.
        extract: for an asset of channels: turns the messages of a channel into its files. All channels share one
            pass over the recording; each gets its own topics.
        checks: checks of its artifacts, and of others derived from them.
        along: hidden assets that are made whenever it is made, since others will need them.
        spared: version -> returns whether it left the bytes of an action alone; such actions keep the version before, and their artifacts.
        changes: version -> what it does that the one before did not, as a verb phrase for builds after an upgrade.
        fallback: a use and the error that its action failed with -> what is tried then; None for nothing.
    """

    name: str
    version: int
    title: str
    kinds: frozenset[str]
    params: Callable[[Recipe, Rig], P]
    use: Callable[[P, Facts], Mapping[str, Use[U] | Exception]]
    make: "Callable[[Use[U], Inputs, ArtifactWriter], Summary] | None" = None
    extract: "Callable[[Use[U], Inputs, Recording, ArtifactWriter, Executor | None], ChannelExtractor] | None" = None
    description: str = ""
    face: Face = field(default_factory=Face)
    reads: "tuple[AnyAsset, ...]" = ()
    waits_for: Callable[[P, Inventory | None], frozenset[str]] | None = None
    libraries: tuple[str, ...] = ()
    families: tuple[Family, ...] = ()
    enabled: Callable[[Recipe], bool] = lambda _: True
    optional: bool = False
    checks: tuple[RecordingCheck, ...] = ()
    distribution: str = ""
    along: "tuple[AnyAsset, ...]" = ()
    spared: Mapping[int, Callable[[U], bool]] = field(default_factory=dict)
    changes: Mapping[int, str] = field(default_factory=dict)
    fallback: "Callable[[Use[U], str], Use[U] | None] | None" = None

    @property
    def step(self) -> Step:
        """The step of its actions."""
        return Step(self.name, self.version, self.libraries)

    @property
    def about(self) -> str:
        """Its title and description."""
        return f"{self.title}\n\n{self.description}" if self.description else self.title

    def needs(self, params: P, inventory: Inventory | None) -> frozenset[str]:
        """Return the names of the assets that must be made before it, under these parameters, for a recording."""
        if self.waits_for is not None:
            return self.waits_for(params, inventory)
        return frozenset(asset.name for asset in self.reads)

    def run(self, use: Use[U], inputs: Inputs, out: ArtifactWriter) -> Summary:
        """Write the artifact of an asset without channels."""
        if self.make is None:
            raise TypeError(f"{self.name} consists of channels")
        return self.make(use, inputs, out)

    def action(self, use: Use[U], inventory: Inventory | None) -> Action:
        """Return the action that reads `use`.

        Args:
            use: from `Asset.use`.
            inventory: has the digests of the recording's topics; None if it reads no topic.
        """
        topics = {} if inventory is None else inventory.digests(use.topics)
        inputs = {f"topic:{name}": digest for name, digest in topics.items()}
        version = self.version
        while (spares := self.spared.get(version)) is not None and spares(use.params):
            version -= 1
        step = replace(self.step, version=version)
        return step.action(as_json(use.params), {**inputs, **use.inputs})


AnyAsset = Asset[Any, Any]
"""An asset, whatever its parameters are, for lists of assets."""
