"""Checking the bytes of recordings against their recorded digests, and naming the files and topics that changed."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

from bagassets.assets.inventory import INVENTORY
from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonObject
from bagassets.base.quantities import count_text
from bagassets.engine.execute import run_again
from bagassets.engine.graph import Graph
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.recordings.digest import combined_digest, hash_file, name_in, recording_stat, stat_files
from bagassets.recordings.digest_record import read_attribute
from bagassets.recordings.model import RecordingFiles
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store


@dataclass(frozen=True)
class ChangedFile:
    """A file whose content does not match its recorded digest.

    Attributes:
        path: the file.
        recorded: the recorded digest.
        actual: the digest of the content.
        touched: True if its size or time differs, too.
    """

    path: Path
    recorded: str
    actual: str
    touched: bool

    def __str__(self) -> str:
        how = (
            "written to since then"
            if self.touched
            else "with the same size and time, so it was edited in place, or its disk is failing"
        )
        return f"{self.path}: the digest on record is {self.recorded[:16]}, that of the content {self.actual[:16]}; {how}"


@dataclass(frozen=True)
class ChangedTopic:
    """A topic whose messages changed: the numbers of messages, None where the topic does not exist."""

    topic: str
    recorded: int | None
    actual: int | None

    def __str__(self) -> str:
        if self.recorded is None:
            return f"topic {self.topic} was not there"
        if self.actual is None:
            return f"topic {self.topic} is gone ({count_text(self.recorded, 'message')})"
        if self.recorded != self.actual:
            return f"topic {self.topic} has {count_text(self.actual, 'message')} instead of {self.recorded}"
        return f"topic {self.topic}: some of its {self.actual} messages changed"


@dataclass(frozen=True)
class CheckedRecording:
    """The result of checking all bytes of a recording.

    Attributes:
        key: partition key.
        size: bytes that were hashed.
        unrecorded: files without a recorded digest.
        files: files that changed.
        topics: topics that changed, if a file did.
        problem: why its files or topics could not be compared.
    """

    key: str
    size: int
    unrecorded: tuple[Path, ...] = ()
    files: tuple[ChangedFile, ...] = ()
    topics: tuple[ChangedTopic, ...] = ()
    problem: str | None = None

    @property
    def is_sound(self) -> bool:
        """True if every file could be read and matches its record."""
        return not self.files and self.problem is None

    def as_json(self) -> JsonObject:
        """Return the result as JSON."""
        return {
            "key": self.key,
            "unrecorded": [str(path) for path in self.unrecorded],
            "files": [vars(file) | {"path": str(file.path)} for file in self.files],
            "topics": [vars(topic) for topic in self.topics],
            "problem": self.problem,
        }


def check_recording(assets: RecordingAssets, recording: RecordingFiles) -> CheckedRecording:
    """Hash one recording and compare it with its record, which is in the index or stored with its files."""
    try:
        return _check(assets, recording)
    except BagAssetsError as err:
        return CheckedRecording(recording.key, 0, problem=str(err))


def _check(assets: RecordingAssets, recording: RecordingFiles) -> CheckedRecording:
    recorded: dict[str, str] = {}
    changed: list[ChangedFile] = []
    unrecorded: list[Path] = []
    size = 0
    for path, stat in stat_files(recording):
        size += stat.st_size
        actual = hash_file(path, stat)
        row = assets.index.row(path)
        digest = read_attribute(path) if row is None else row.digest
        if digest is None:
            unrecorded.append(path)
        elif digest != actual:
            is_same = read_attribute(path, stat) is not None if row is None else row.same_size_and_time(stat)
            changed.append(ChangedFile(path, digest, actual, not is_same))
        recorded[name_in(recording, path)] = digest or actual
    if not changed:
        return CheckedRecording(recording.key, size, tuple(unrecorded))
    try:
        topics = _changed_topics(assets, recording, combined_digest(recording, recorded))
        problem = None
    except BagAssetsError as err:
        topics, problem = (), f"its topics cannot be compared: {err}"
    return CheckedRecording(recording.key, size, tuple(unrecorded), tuple(changed), topics, problem)


def _changed_topics(
    assets: RecordingAssets, recording: RecordingFiles, recorded_digest: str
) -> tuple[ChangedTopic, ...]:
    """Return the topics whose digest differs from that in the inventory of the recorded content."""
    graph = Graph(assets, recording, recorded_digest, recording_stat(recording))
    inventory = graph.node(INVENTORY.name)
    if inventory.artifact is None:
        raise BagAssetsError("the store has no inventory of the recorded content, which was never built.")
    before = _topics(inventory.artifact)
    with tempfile.TemporaryDirectory() as folder:
        again = run_again(graph, [inventory], Store(Path(folder)), threads=1)[inventory.name]
        if isinstance(again, BagAssetsError):
            raise again
        now = _topics(again.artifact)
    nothing = (None, None)
    compared = {name: (before.get(name, nothing), now.get(name, nothing)) for name in sorted(before | now)}
    return tuple(
        ChangedTopic(name, old[1], new[1]) for name, (old, new) in compared.items() if old[0] != new[0]
    )


def _topics(inventory: Artifact) -> dict[str, tuple[str, int]]:
    """Return topic -> digest and number of its messages."""
    topics = inventory.read_json("inventory.json")["topics"]
    return {topic["name"]: (topic["digest"], topic["count"]) for topic in topics}
