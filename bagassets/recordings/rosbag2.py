"""ROS 2 bag folders: SQLite or MCAP, split, compressed by file or by message.

What `metadata.yaml` says of topics counts, and the files are read in its order.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from bagassets.errors import RecordingError
from bagassets.recipe.model import Limits
from bagassets.recordings.damage import DamageError, refuse_pointer
from bagassets.recordings.database_file import Database, serialization_problem
from bagassets.recordings.mcap_file import McapFile
from bagassets.recordings.model import Definition, RawMessage
from bagassets.recordings.recording import Recording
from bagassets.recordings.topic import RefusedBytes, TopicSource, merge_topics, normalise_msgtype
from bagassets.recordings.unpack import TooLargeError, unpack, unpack_file

__all__ = ["Rosbag2Recording"]

METADATA = "metadata.yaml"
_NEWEST_VERSION = 9
_MOST_METADATA_BYTES = 16_000_000
# The parser calls itself for what lies in what; files of recorders nest six levels.
_DEEPEST = 50
_ZSTD = ".zstd"


class Rosbag2Recording(Recording):
    """A ROS 2 bag folder."""

    def __init__(self, path: Path, message_definitions: Sequence[Path], limits: Limits) -> None:
        self._limits = limits
        self._stack = ExitStack()
        try:
            facts = _metadata(path / METADATA)
            mode = _compression_mode(facts)
            self._packed_messages = mode == "message"
            self._files = [
                self._open(file, packed=mode == "file" or file.suffix == _ZSTD)
                for file in _storage_files(path, facts)
            ]
            super().__init__(
                path, "ros2", merge_topics(path, self._sources(facts), message_definitions, limits)
            )
        except BaseException:
            self._stack.close()
            raise

    def _open(self, file: Path, *, packed: bool) -> "Database | McapFile":
        refuse_pointer(file)
        if packed:
            folder = Path(self._stack.enter_context(TemporaryDirectory(prefix="bagassets-")))
            unpacked = folder / file.stem
            unpack_file(file, unpacked, self._limits.compression_ratio)
            file = unpacked
        if file.suffix == ".mcap":
            mcap = McapFile(file, self._limits)
            mcap.check = True
            self._stack.callback(mcap.close)
            return mcap
        database = Database(file, self._limits)
        self._stack.callback(database.close)
        return database

    def _sources(self, facts: Mapping[str, Any]) -> list[TopicSource]:
        definitions: dict[str, Definition] = {}
        for file in self._files:
            if isinstance(file, Database):
                found = file.definitions()
            else:
                found = {s.msgtype: s.definition for s in file.sources().values() if s.definition.text}
            definitions = found | definitions  # those of the first file count
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
                yield RawMessage(info.name, info.msgtype, log_time_ns, self._unpacked(data))

    def _unpacked(self, data: bytes | memoryview) -> bytes | memoryview:
        if not self._packed_messages or isinstance(data, RefusedBytes):
            return data
        try:
            return unpack(bytes(data), "zstd", self._limits.message_bytes)
        except TooLargeError:
            return RefusedBytes()

    def close(self) -> None:
        """Close the files."""
        self._stack.close()


def _metadata(file: Path) -> dict[str, Any]:
    """Return what a metadata file says of its bag.

    Raises:
        DamageError: it is not one of a ROS 2 bag.
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
        mark = getattr(err, "problem_mark", None)
        line = "" if mark is None else f", line {mark.line + 1}"
        raise DamageError(f"its {METADATA} is no YAML{line}") from err
    facts = facts.get("rosbag2_bagfile_information") if isinstance(facts, dict) else None
    if not isinstance(facts, dict):
        raise DamageError(f"its {METADATA} says nothing of a ROS 2 bag")
    missing = [name for name in ("topics_with_message_count", "relative_file_paths") if name not in facts]
    if missing:
        raise DamageError(f"its {METADATA} lacks {missing[0]}")
    version = facts.get("version")
    if isinstance(version, int) and version > _NEWEST_VERSION:
        raise DamageError(f"its format version {version} is not supported")
    return facts


def _compression_mode(facts: Mapping[str, Any]) -> str:
    mode = str(facts.get("compression_mode") or "none").lower()
    packing = str(facts.get("compression_format") or "")
    if mode != "none" and packing != "zstd":
        raise DamageError(f"its compression '{packing}' is not supported")
    return mode


def _storage_files(path: Path, facts: Mapping[str, Any]) -> list[Path]:
    """Return the files of a bag in the order of its metadata.

    They are told by their suffix: `storage_identifier` says the same, and some recorders leave it empty.
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
