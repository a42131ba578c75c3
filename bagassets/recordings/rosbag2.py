"""ROS 2 bag folders: SQLite or MCAP, split, compressed by file or by message.

Topics are those in `metadata.yaml`, and files are read in its order.
"""

from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

import yaml

from bagassets.errors import RecordingError
from bagassets.json_types import JsonMapping, JsonObject
from bagassets.recipe.model import Limits
from bagassets.recordings.damage import DamageError, refuse_pointer
from bagassets.recordings.database_file import Database, serialization_problem
from bagassets.recordings.decompress import TooLargeError, decompress, decompress_file
from bagassets.recordings.mcap_file import McapFile
from bagassets.recordings.model import METADATA, Definition, OnRead, RawMessage
from bagassets.recordings.recording import Recording
from bagassets.recordings.topic import RefusedBytes, TopicSource, merge_topics, normalise_msgtype

__all__ = ["Rosbag2Recording"]

_NEWEST_VERSION = 9
_MOST_METADATA_BYTES = 16_000_000
# The parser recurses into nested values; recorders write six levels.
_DEEPEST = 50
_ZSTD = ".zstd"


class Rosbag2Recording(Recording):
    """A ROS 2 bag folder."""

    def __init__(
        self,
        path: Path,
        message_definitions: Sequence[Path],
        limits: Limits,
        on_read: OnRead | None = None,
    ) -> None:
        self._limits = limits
        self._on_read = on_read
        self._stack = ExitStack()
        try:
            facts = _metadata(path / METADATA)
            mode = _compression_mode(facts)
            self._compressed_messages = mode == "message"
            self._files = [
                self._open(file, compressed=mode == "file" or file.suffix == _ZSTD)
                for file in _storage_files(path, facts)
            ]
            super().__init__(
                path, "ros2", merge_topics(path, self._sources(facts), message_definitions, limits)
            )
        except BaseException:
            self._stack.close()
            raise

    def _open(self, file: Path, *, compressed: bool) -> "Database | McapFile":
        refuse_pointer(file)
        if compressed:
            folder = Path(self._stack.enter_context(TemporaryDirectory(prefix="bagassets-")))
            plain = folder / file.stem
            decompress_file(file, plain, self._limits.compression_ratio, self._on_read)
            file = plain
        if file.suffix == ".mcap":
            mcap = McapFile(file, self._limits, self._on_read)
            mcap.check = True
            self._stack.callback(mcap.close)
            return mcap
        database = Database(file, self._limits, self._on_read)
        self._stack.callback(database.close)
        return database

    def _sources(self, facts: JsonMapping) -> list[TopicSource]:
        definitions: dict[str, Definition] = {}
        for file in self._files:
            if isinstance(file, Database):
                in_file = file.definitions()
            else:
                in_file = {s.msgtype: s.definition for s in file.sources().values() if s.definition.text}
            definitions = in_file | definitions  # the first file's definition of a type counts
        return [
            TopicSource(
                str(topic["name"]),
                msgtype := normalise_msgtype(str(topic["type"])),
                int(entry["message_count"]),
                definitions.get(msgtype, Definition("none", "")),
                "cdr",
                serialization_problem(topic.get("serialization_format")),
            )
            for entry in facts["topics_with_message_count"]
            for topic in (entry["topic_metadata"],)
        ]

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        for file in self._files:
            if isinstance(file, Database):
                named = {number: (name, msgtype) for number, (name, msgtype, _) in file.topics().items()}
            else:
                named = {number: (s.topic, s.msgtype) for number, s in file.sources().items()}
            wanted = {
                number: self.topics[name]
                for number, (name, msgtype) in named.items()
                if name in topics and msgtype == self.topics[name].msgtype
            }
            for number, log_time_ns, data in file.messages(wanted.keys()) if wanted else ():
                info = wanted[number]
                yield RawMessage(info.name, info.msgtype, log_time_ns, self._decompressed(data))

    def _decompressed(self, data: bytes | memoryview) -> bytes | memoryview:
        if not self._compressed_messages or isinstance(data, RefusedBytes):
            return data
        try:
            return decompress(bytes(data), "zstd", self._limits.message_bytes)
        except TooLargeError:
            return RefusedBytes()

    def close(self) -> None:
        """Close the files."""
        self._stack.close()


def _metadata(file: Path) -> JsonObject:
    """Return the facts in the metadata file of a bag.

    Raises:
        DamageError: it is not the metadata of a ROS 2 bag.
    """
    with file.open("rb") as stream:
        text = stream.read(_MOST_METADATA_BYTES + 1)
    if len(text) > _MOST_METADATA_BYTES:
        raise DamageError(f"its {METADATA} has more than {_MOST_METADATA_BYTES} bytes")
    try:
        depth = 0
        for event in yaml.parse(text, Loader=yaml.CSafeLoader):
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
            if depth > _DEEPEST:
                raise DamageError(f"its {METADATA} is nested too deeply")
        facts = yaml.load(text, Loader=yaml.CSafeLoader)
    except yaml.YAMLError as err:
        if "nesting depth" in str(err):  # libyaml of PyYAML 6.0.4 has a limit of its own, and looks ahead
            raise DamageError(f"its {METADATA} is nested too deeply") from err
        mark = getattr(err, "problem_mark", None)
        line = "" if mark is None else f", line {mark.line + 1}"
        raise DamageError(f"its {METADATA} is not YAML{line}") from err
    facts = facts.get("rosbag2_bagfile_information") if isinstance(facts, dict) else None
    if not isinstance(facts, dict):
        raise DamageError(f"its {METADATA} does not describe a ROS 2 bag")
    missing = [name for name in ("topics_with_message_count", "relative_file_paths") if name not in facts]
    if missing:
        raise DamageError(f"its {METADATA} lacks {missing[0]}")
    version = facts.get("version")
    if isinstance(version, int) and version > _NEWEST_VERSION:
        raise DamageError(f"its format version {version} is not supported")
    return facts


def _compression_mode(facts: JsonMapping) -> str:
    mode = str(facts.get("compression_mode") or "none").lower()
    compression = str(facts.get("compression_format") or "")
    if mode != "none" and compression != "zstd":
        raise DamageError(f"its compression '{compression}' is not supported")
    return mode


def _storage_files(path: Path, facts: JsonMapping) -> list[Path]:
    """Return the files of a bag in the order of its metadata.

    The suffix of a file tells its kind: `storage_identifier` says the same, but some recorders leave it empty.
    """
    files = [path / PurePosixPath(str(name)).name for name in facts["relative_file_paths"]]
    missing = [file.name for file in files if not file.exists()]
    if missing:
        raise RecordingError(
            f"{path}: {', '.join(missing[:3])} of its {METADATA} {'is' if len(missing) == 1 else 'are'} missing; copy "
            "the whole folder again."
        )
    for file in files:
        kind = Path(file.stem).suffix if file.suffix == _ZSTD else file.suffix
        if kind not in {".db3", ".mcap"}:
            raise DamageError(f"the storage of {file.name} is neither SQLite (.db3) nor MCAP (.mcap)")
    return files
