"""ROS 2 bag folders: SQLite or MCAP, split, compressed by file or by message.

Topics are those in `metadata.yaml`, and others in its files; these are read in order of time: it may list part 10 before 2.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import accumulate
from pathlib import Path, PurePosixPath

import yaml

from bagassets.base.errors import RecordingError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.recordings.damage import DamageError, begins_as_named, refuse_pointer
from bagassets.recordings.database_file import Database, serialization_problem
from bagassets.recordings.decompress import TooLargeError, decompress, decompress_file
from bagassets.recordings.journals import scratch_folder
from bagassets.recordings.mcap_file import McapFile
from bagassets.recordings.merge_topics import merge_topics
from bagassets.recordings.model import METADATA, Definition, RawMessage
from bagassets.recordings.recording import How, Recording
from bagassets.recordings.sizes import Sizes
from bagassets.recordings.topic import UNKNOWN, RefusedBytes, TopicSource, normalise_msgtype

_NEWEST_VERSION = 9
_MOST_METADATA_BYTES = 16_000_000
# The parser recurses into nested values; recorders write six levels.
_DEEPEST, _LONGEST_TEXT = 50, 1000
ZSTD = ".zstd"


class Rosbag2Recording(Recording):
    """A ROS 2 bag folder."""

    def __init__(self, path: Path, how: How) -> None:
        self._how = how
        self._stack = ExitStack()
        try:
            metadata, mode, files = self._described(path)
            self._compressed_messages = mode == "message"
            size = sum(file.stat().st_size for file in files if file.exists())
            self._sizes = Sizes(path, size, how.limits)
            self._files = self._opened(files, metadata, mode)
            topics = merge_topics(path, self._sources(metadata), how.message_definitions, how.limits)
            super().__init__(path, "ros2", topics)
        except BaseException:
            self._stack.close()
            raise

    def _described(self, path: Path) -> tuple[JsonMapping, str, list[Path]]:
        """Return the metadata, what is compressed, and the files."""
        metadata = read_metadata(path / METADATA)
        return metadata, compression_mode(metadata), _storage_files(path, metadata)

    def _opened(self, files: Sequence[Path], metadata: JsonMapping, mode: str) -> list[Database | McapFile]:
        """Open the files; which of them can be, a reader of damaged folders decides."""
        del metadata
        return [self._open(file, mode) for file in files]

    def _open(self, file: Path, mode: str) -> Database | McapFile:
        refuse_pointer(file)
        # Somebody may have unpacked it, and left the metadata as they were.
        if file.suffix != ZSTD and (mode != "file" or begins_as_named(file)):
            opened = self._reader(file)
            self._stack.callback(opened.close)
            return opened
        with scratch_folder(file, file.stat().st_size) as folder:
            plain = folder / file.stem
            self._unpack(file, plain)
            return self._open(plain, "none")  # which no longer needs its name

    def _unpack(self, file: Path, plain: Path) -> None:
        decompress_file(file, plain, self._sizes, self._how.on_read)

    def _reader(self, file: Path) -> Database | McapFile:
        if file.suffix == ".mcap":
            opened = McapFile(file, self._how.limits, self._how.on_read, self._sizes)
            opened.check = True
            return opened
        return Database(file, self._how.limits, self._how.on_read)

    def _sources(self, metadata: JsonMapping) -> list[TopicSource]:
        within = [file.sources() for file in self._files]
        definitions: dict[str, Definition] = {}
        for sources in within:
            in_file = {s.msgtype: s.definition for s in sources.values() if s.definition.text}
            definitions = in_file | definitions  # the first file's definition of a type counts
        listed = [
            TopicSource(
                _plain(topic["name"], "name"),
                msgtype := normalise_msgtype(_plain(topic["type"], "type")),
                int(_plain(entry["message_count"], "message_count")),
                definitions.get(msgtype, Definition("none", "")),
                "cdr",
                serialization_problem(
                    _plain(topic.get("serialization_format") or "", "serialization_format")
                ),
            )
            for entry in metadata["topics_with_message_count"]
            for topic in (entry["topic_metadata"],)
        ]
        return listed + list(_unlisted(self._files, within, listed))

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        for file in self.files:
            wanted = self._carrying(topics, file.sources())
            for number, log_time_ns, data in file.messages(wanted.keys()) if wanted else ():
                content = self._decompressed(wanted[number][0], log_time_ns, data)
                if content is not None:
                    yield RawMessage(*wanted[number], log_time_ns, content)

    def _decompressed(self, topic: str, time_ns: int, data: bytes | memoryview) -> bytes | memoryview | None:
        """Return a message; None if it is to be left out, as a reader of damaged folders may decide."""
        del topic, time_ns
        if not self._compressed_messages or isinstance(data, RefusedBytes):
            return data
        try:
            return decompress(bytes(data), "zstd", self._how.limits.message_bytes)
        except TooLargeError:
            return RefusedBytes()

    @property
    def files(self) -> tuple[Database | McapFile, ...]:
        """The open files in order of time; one that says no time stays behind the one that is listed before it."""
        starts = accumulate(self._files, lambda last, file: (file.span_ns() or (last,))[0], initial=0)
        pairs = sorted(zip([*starts][1:], self._files, strict=True), key=lambda one: one[0])
        return tuple(file for _, file in pairs)

    def close(self) -> None:
        """Close the files."""
        self._stack.close()


def _unlisted(
    files: Sequence[Database | McapFile],
    within: Sequence[Mapping[int, TopicSource]],
    listed: Sequence[TopicSource],
) -> Iterator[TopicSource]:
    """Yield what is in the files of a bag and not in its metadata, as if the recorder was killed: topics, and other types of one."""
    names = {source.topic for source in listed}
    pairs = {(source.topic, source.msgtype) for source in listed}
    for file, sources in zip(files, within, strict=True):
        new = {
            number: source
            for number, source in sources.items()
            if (source.topic, source.msgtype) not in pairs and source.msgtype != UNKNOWN
        }
        counts = file.counts() if new else {}
        for number, source in new.items():
            if source.topic in names:
                yield replace(source, count=0)  # the metadata have counted them
            elif counts.get(number):
                yield replace(source, count=counts[number])


def read_metadata(file: Path) -> JsonObject:
    """Return what the metadata file of a bag says.

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
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST:
                raise DamageError(f"its {METADATA} is nested too deeply")
        metadata = yaml.load(text, Loader=yaml.CSafeLoader)
    except yaml.YAMLError as err:
        if "nesting depth" in str(err):  # libyaml of PyYAML 6.0.4 has a limit of its own, and looks ahead
            raise DamageError(f"its {METADATA} is nested too deeply") from err
        mark = getattr(err, "problem_mark", None)
        line = "" if mark is None else f", line {mark.line + 1}"
        raise DamageError(f"its {METADATA} is not YAML{line}") from err
    metadata = metadata.get("rosbag2_bagfile_information") if isinstance(metadata, dict) else None
    if not isinstance(metadata, dict):
        raise DamageError(f"its {METADATA} does not describe a ROS 2 bag")
    missing = [name for name in ("topics_with_message_count", "relative_file_paths") if name not in metadata]
    if missing:
        raise DamageError(f"its {METADATA} lacks {missing[0]}")
    try:
        for entry in metadata["topics_with_message_count"]:
            for field in ("name", "type"):
                _plain(entry["topic_metadata"][field], field)
            int(_plain(entry["message_count"], "message_count"))
    except (KeyError, TypeError, ValueError) as err:
        raise DamageError(f"its {METADATA} does not describe its topics") from err
    version = metadata.get("version")
    if isinstance(version, int) and version > _NEWEST_VERSION:
        raise DamageError(f"its format version {version} is not supported")
    return metadata


def _plain(value: object, field: str) -> str:
    """Return a value of the metadata as text; parts of YAML may repeat each other, and would be endless when written out."""
    text = str(value) if isinstance(value, str | int | float | None) else None
    if text is None or len(text) > _LONGEST_TEXT:
        raise DamageError(
            f"its {METADATA} has a list or a long text as {field}, where a name or a number is expected"
        )
    return text


def compression_mode(metadata: JsonMapping) -> str:
    """Return what is compressed: `none`, `file` or `message`.

    Raises:
        DamageError: not by zstd.
    """
    mode = _plain(metadata.get("compression_mode") or "none", "compression_mode").lower()
    compression = _plain(metadata.get("compression_format") or "", "compression_format")
    if mode != "none" and compression != "zstd":
        raise DamageError(f"its compression '{compression}' is not supported")
    return mode


def named_files(path: Path, metadata: JsonMapping) -> list[Path]:
    """Return where the files of a bag are that its metadata name, unpacked if only that exists, or where they should be.

    Raises:
        DamageError: it names none.
    """
    names = metadata["relative_file_paths"]
    if not isinstance(names, list):
        raise DamageError(f"its {METADATA} does not list its files")
    return [
        _perhaps_unpacked(path / name)
        for name in dict.fromkeys(PurePosixPath(_plain(name, "relative_file_paths")).name for name in names)
    ]


def _perhaps_unpacked(file: Path) -> Path:
    if file.suffix != ZSTD or file.exists():
        return file
    plain = file.with_suffix("")
    return plain if plain.exists() else file


def _storage_files(path: Path, metadata: JsonMapping) -> list[Path]:
    """Return the files of a bag in the order of its metadata.

    The suffix of a file tells its kind: `storage_identifier` says the same, but some recorders leave it empty.
    """
    files = named_files(path, metadata)
    missing = [file.name for file in files if not file.exists()]
    if missing:
        others = [file.name for file in path.glob(f"*{Path(missing[0]).suffix}") if file not in files]
        renamed = f", or rename {others[0]} so, if that is it" if len(others) == len(missing) == 1 else ""
        raise RecordingError(
            f"{path}: {', '.join(missing[:3])} of its {METADATA} {'is' if len(missing) == 1 else 'are'} missing; copy "
            f"the whole folder again{renamed}."
        )
    for file in files:
        kind = Path(file.stem).suffix if file.suffix == ZSTD else file.suffix
        if kind not in {".db3", ".mcap"}:
            raise DamageError(f"the storage of {file.name} is neither SQLite (.db3) nor MCAP (.mcap)")
    return files
