"""What is wrong with one recording: read as builds do and, where that fails, as far as can be."""

from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO, Literal

from mcap.opcode import Opcode
from mcap.stream_reader import MAGIC_SIZE
from rosbags.rosbag1.reader import Header, RecordType

from bagassets.base.errors import RecordingError
from bagassets.base.json_types import JsonObject
from bagassets.recipe.model import Limits
from bagassets.recordings.mcap_chunk import RECORD_HEADER
from bagassets.recordings.open import open_recording
from bagassets.recordings.recording import Recording
from bagassets.recordings.rosbag1 import SIZE
from bagassets.recordings.rosbag2 import ZSTD
from bagassets.recordings.salvage.copy import write_copy
from bagassets.recordings.salvage.damage_map import DamageMap
from bagassets.recordings.salvage.open import open_salvaged

Verdict = Literal["sound", "mendable", "lost"]

# A copy takes every message, whatever builds would make of it.
_ANY = Limits(chunk_bytes=4_000_000_000, message_bytes=4_000_000_000, connections=10**9, topics=10**9)


@dataclass(frozen=True)
class Examined:
    """What was found.

    Attributes:
        path: the recording.
        verdict: `sound`; `mendable` if anything can be read; else `lost`.
        problem: what builds that refuse damaged recordings say of it; "" if it is sound.
        topics: topic -> type, and number of messages that can be read.
        damage: what is damaged; None if it is sound, or nothing can be read.
        remark: a clause about what no reader looks at, and so costs nothing; "" if there is nothing.
    """

    path: Path
    verdict: Verdict
    problem: str
    topics: Mapping[str, tuple[str, int]]
    damage: DamageMap | None
    remark: str = ""

    def as_json(self) -> JsonObject:
        """Return it as JSON."""
        return {
            "path": str(self.path),
            "verdict": self.verdict,
            "problem": self.problem,
            "remark": self.remark,
            "topics": {
                name: {"type": kind, "messages": number} for name, (kind, number) in self.topics.items()
            },
            "damage": None
            if self.damage is None
            else {**self.damage.as_json(), "complete": self.damage.is_complete},
        }


def examine(path: Path) -> Examined:
    """Read a recording, and say what is wrong with it.

    Raises:
        RecordingError: nothing is there, or there is no space for what reading it takes.
    """
    path = path.absolute()
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder.")
    behind = 0 if path.is_dir() else _bytes_behind_end(path)
    remark = (
        f"{path.name}: behind the end of the recording are {behind} more bytes, which are not read"
        if behind
        else ""
    )
    try:
        if path.suffix == ZSTD:
            packed = "it is packed by zstd, and builds read such files in ROS 2 bag folders only"
            raise RecordingError(f"{path}: {packed}.")  # noqa: TRY301  (as if that were tried)
        with open_recording(path) as recording:
            counts, missing = _read(recording)
            problem = ", ".join(f"{number} of {name}" for name, number in missing.items() if number > 0)
            if not problem:
                return Examined(path, "sound", "", _topics(recording, counts), None, remark)
            problem = f"{path}: messages that its index announces are missing: {problem}."
    except RecordingError as err:
        if err.transient:
            raise
        problem = str(err)
    try:
        with open_salvaged(path) as recording:
            counts, missing = _read(recording)
            if recording.damage is not None and counts.total():
                damage = recording.damage.map(missing, counts.total())
                return Examined(path, "mendable", problem, _topics(recording, counts), damage, remark)
    except RecordingError as err:
        if err.transient:
            raise
    return Examined(path, "lost", problem, {}, None, remark)


def _bytes_behind_end(path: Path) -> int:
    """Return how many bytes follow the end of a ROS 1 bag or an MCAP, which no reader looks at; 0 if its records do not tell."""
    with suppress(Exception), path.open("rb") as file:  # whatever damaged bytes lead to
        first = file.readline(100)
        end = _end_of_bag(file) if first.startswith(b"#ROSBAG") else _end_of_mcap(file)
        return max(path.stat().st_size - end, 0)
    return 0


def _end_of_bag(file: BinaryIO) -> int:
    header = Header.read(file, RecordType.BAGHEADER)
    if not (index := header.get_uint64("index_pos")):
        raise ValueError(index)
    file.seek(index)
    for _ in range(header.get_uint32("conn_count") + header.get_uint32("chunk_count")):
        op = Header.read(file).get_uint8("op")
        if op not in {RecordType.CONNECTION, RecordType.CHUNK_INFO}:
            raise ValueError(op)
        (size,) = SIZE.unpack(file.read(SIZE.size))
        file.seek(size, 1)
    return file.tell()


def _end_of_mcap(file: BinaryIO) -> int:
    file.seek(MAGIC_SIZE)
    opcode = 0
    while opcode != Opcode.FOOTER:
        opcode, length = RECORD_HEADER.unpack(file.read(RECORD_HEADER.size))
        file.seek(length, 1)
    return file.tell() + MAGIC_SIZE


def _read(recording: Recording) -> tuple[Counter[str], dict[str, int]]:
    """Return topic -> messages that can be read, and topic -> those that are announced beyond them."""
    counts: Counter[str] = Counter()
    recording.check_content()
    for message in recording.messages(list(recording.topics)):
        counts[message.topic] += 1
    return counts, {name: topic.count - counts[name] for name, topic in recording.topics.items()}


def _topics(recording: Recording, counts: Mapping[str, int]) -> dict[str, tuple[str, int]]:
    return {name: (topic.msgtype, counts.get(name, 0)) for name, topic in recording.topics.items()}


def mend(path: Path, copy: Path) -> int:
    """Write a copy of what can be read of a recording, which appears whole; return the number of messages.

    Raises:
        RecordingError: the copy has the name of another format, or cannot be written.
    """
    path, copy = path.absolute(), copy.absolute()
    with open_salvaged(path, (), _ANY) as recording:
        suffix = {"ros1": ".bag", "mcap": ".mcap"}.get(recording.format, "")
        if (copy.suffix if copy.suffix in {".bag", ".mcap", ".db3"} else "") != suffix:
            kind = f"a file whose name ends in {suffix}" if suffix else "a folder, a ROS 2 bag"
            raise RecordingError(f"{copy}: the copy of {path.name} is {kind}; name it so.")
        try:
            with TemporaryDirectory(prefix=".bagassets-", dir=copy.parent) as folder:
                made = Path(folder) / copy.name
                number = write_copy(recording, made)
                made.rename(copy)
        except OSError as err:
            raise RecordingError(f"{copy}: cannot be written ({err.strerror}).") from err
    return number
