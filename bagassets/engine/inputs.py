"""The inputs of one recording's actions: the facts that they are planned from, and what they run on.

Files that steps read besides the recordings count, too: the recipe names them, or they lie beside a recording.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from bagassets.assets.boxes.files.find import LabelSet, find_labels, label_paths
from bagassets.assets.contents import Contents
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.selection import choose_rig
from bagassets.base.errors import StoreError
from bagassets.engine.source import MessageSource
from bagassets.recipe.model import LidarChannel, Recipe
from bagassets.recipe.model_annotations import AnnotationFiles
from bagassets.recordings.model import Format, RecordingFiles
from bagassets.recordings.pack import PackedRecording
from bagassets.recordings.recording import Recording
from bagassets.store.artifact import Artifact
from bagassets.store.canonical import digest_file
from bagassets.store.store import Store


class RecordingInputs(Contents):
    """The artifacts of one recording as they become known, and facts read from them; see `assets.asset.Inputs`.

    Args:
        store: where artifacts are.
        recording: its files.
        digest: its content digest.
        source: opens its topics.
        recorded: asset -> current artifact, for assets that are not made here.
    """

    def __init__(
        self,
        store: Store,
        recording: RecordingFiles,
        digest: str,
        source: MessageSource,
        recorded: Mapping[str, Artifact] | None = None,
    ) -> None:
        self.digest = digest
        self._store = store
        self._recording = recording
        self._source = source
        self._artifacts = dict(recorded or {})
        self._channels: dict[str, dict[str, Artifact]] = {}

    def add(self, asset: str, artifact: Artifact) -> None:
        """Add the artifact of an asset."""
        self._artifacts[asset] = artifact
        self._channels.pop(asset, None)

    @property
    def key(self) -> str:
        """Partition key."""
        return self._recording.key

    @property
    def format(self) -> Format:
        """The format in which it is read."""
        return self._recording.format

    @property
    def size(self) -> int:
        """Bytes of its files."""
        return self._recording.size

    def artifact(self, asset: str) -> Artifact:
        """Return the artifact of an asset.

        Raises:
            StoreError: the asset has not been made.
        """
        try:
            return self._artifacts[asset]
        except KeyError:
            raise not_materialized(self.key, asset) from None

    def channels(self, asset: str) -> dict[str, Artifact]:
        """Return channel -> artifact of `frames` or `sweeps`."""
        if asset not in self._channels:
            channels = self.artifact(asset).read_json("channels.json")
            self._channels[asset] = {
                name: self._store.artifact(entry["artifact"]) for name, entry in channels.items()
            }
        return self._channels[asset]

    def labels(self, sources: Iterable[AnnotationFiles]) -> dict[str, LabelSet]:
        """Return source -> label files that lie beside the recording."""
        return find_labels(sources, self._recording)

    def definitions(self, folders: Iterable[Path]) -> dict[str, str]:
        """Return `msg:<name below its folder>` -> digest for each message definition file in `folders`."""
        return {
            f"msg:{path.relative_to(folder).as_posix()}": digest_file(path)
            for folder in folders
            for path in sorted(folder.rglob("*.msg"))
        }

    def file(self, path: Path) -> bytes:
        """Return the content of a file that the recipe names."""
        return path.read_bytes()

    def whole(self, *, salvaged: bool = False) -> AbstractContextManager[Recording]:
        """Open the whole recording; `salvaged` for what can be read of a damaged one, as its inventory was."""
        inventory = self.inventory if INVENTORY.name in self._artifacts else None
        return self._source.whole(inventory, salvaged=salvaged)

    @contextmanager
    def messages(self, topics: tuple[str, ...]) -> Iterator[Recording]:
        """Open `topics` of the recording, from the pack in its inventory if it has them all."""
        if self.inventory.unpacked(topics):
            with self._source.whole(self.inventory) as recording:
                yield recording.restrict(topics)
        else:
            yield PackedRecording(self.inventory, self.pack, self._source.limits).restrict(topics)


def not_materialized(key: str, asset: str, why: str | None = None) -> StoreError:
    """Return the error that an asset of a recording has not been made, and why it could not be when that was last tried."""
    tried = "" if why is None else f" When that was last tried, it failed: {why}"
    return StoreError(
        f"{key}: {asset} is not materialized for this recording; materialize {asset} first.{tried}"
    )


def named_files(recipe: Recipe) -> tuple[list[Path], list[Path]]:
    """Return the URDF, calibration and metadata files, those of formats, and the folders of message definitions that a recipe names, whether or not they exist."""
    files = [rig.urdf for rig in recipe.rigs if rig.urdf is not None]
    channels = [channel for rig in recipe.rigs for channel in rig.channels.values()]
    files += [one.file for channel in channels for one in channel.calibration_files.values()]
    files += [one.metadata for one in channels if isinstance(one, LidarChannel) and one.metadata is not None]
    files += [file for settings in recipe.dataset_settings.values() for file in settings.files_read]
    return list(dict.fromkeys(files)), list(recipe.bags.message_definitions)


def files_beside(recipe: Recipe, recording: RecordingFiles) -> list[Path]:
    """Return the paths of a recording's label files, and the paths where some might appear."""
    if not any(rig.annotation_files for rig in recipe.rigs):
        return []
    rig = choose_rig(recipe, *recording.names)
    return [] if rig is None else label_paths(rig, recording)
