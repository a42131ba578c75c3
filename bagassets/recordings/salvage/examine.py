"""What is wrong with one recording: read as builds do and, where that fails, as far as can be."""

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from struct import Struct
from tempfile import TemporaryDirectory
from typing import BinaryIO, Literal

from bagassets.base.alike import names_text
from bagassets.base.errors import RecordingError
from bagassets.base.json_types import JsonObject
from bagassets.recipe.model import Limits
from bagassets.recordings import unfinished
from bagassets.recordings.journals import journals_of
from bagassets.recordings.mcap_index import end_of as end_of_mcap
from bagassets.recordings.model import METADATA
from bagassets.recordings.open import open_recording
from bagassets.recordings.recording import Recording
from bagassets.recordings.rosbag1 import SummaryReader
from bagassets.recordings.rosbag2 import ZSTD
from bagassets.recordings.salvage.copy import write_copy
from bagassets.recordings.salvage.damage_map import DamageMap
from bagassets.recordings.salvage.folder import STORAGE
from bagassets.recordings.salvage.open import open_salvaged
from bagassets.recordings.series import whole_of

Verdict = Literal["sound", "mendable", "lost"]

# A copy takes every message, whatever builds would make of it.
_ANY = Limits(chunk_bytes=4_000_000_000, message_bytes=4_000_000_000, connections=10**9, topics=10**9)
BEHIND = "All of it can be read, but more bytes follow; other programs may refuse it."


@dataclass(frozen=True)
class Examined:
    """What was found.

    Attributes:
        path: the recording.
        verdict: `sound`; `mendable` if anything can be read; else `lost`.
        problem: what builds that refuse damaged recordings say of it; "" if it is sound.
        topics: topic -> type, and number of messages that can be read.
        damage: what is damaged; None if it is sound, or nothing can be read.
    """

    path: Path
    verdict: Verdict
    problem: str
    topics: Mapping[str, tuple[str, int]]
    damage: DamageMap | None

    def as_json(self) -> JsonObject:
        """Return it as JSON."""
        return {
            "path": str(self.path),
            "verdict": self.verdict,
            "problem": self.problem,
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
    lacks_metadata = path.is_dir() and not (path / METADATA).exists()
    if lacks_metadata:
        _refuse_folder_of_recordings(path)
    if path.suffix in unfinished.COMPRESSORS - {ZSTD} and (reason := unfinished.reason(path, path.stat())):
        raise RecordingError(f"{path}: {reason}, and ask about that.")
    behind = [*_behind_end(path)]
    try:
        if path.suffix == ZSTD:
            packed = "it is compressed with zstd, and builds read such files in ROS 2 bag folders only"
            raise RecordingError(f"{path}: {packed}.")  # noqa: TRY301  (as if that were tried)
        with open_recording(path) as recording:
            counts, missing = _read(recording)
            problem = ", ".join(f"{number} of {name}" for name, number in missing.items() if number > 0)
            if not problem:
                damage = DamageMap(tuple(behind), (), {}, counts.total()) if behind else None
                verdict: Verdict = "mendable" if behind else "sound"
                return Examined(path, verdict, BEHIND if behind else "", _topics(recording, counts), damage)
            problem = f"{path}: messages that its index announces are missing: {problem}."
    except RecordingError as err:
        if err.transient:
            raise
        problem = f"{path}: its {METADATA} is missing." if lacks_metadata else str(err)
    try:
        with open_salvaged(path) as recording:
            counts, missing = _read(recording)
            if recording.damage is not None and counts.total():
                for one in behind:
                    recording.damage.find(one)
                damage = recording.damage.map(missing, counts.total())
                return Examined(path, "mendable", problem, _topics(recording, counts), damage)
    except RecordingError as err:
        if err.transient:
            raise
    return Examined(path, "lost", problem, {}, None)


def _refuse_folder_of_recordings(folder: Path) -> None:
    """Raise RecordingError unless the files in a folder without metadata are one ROS 2 bag, by their names."""
    inside = [*folder.iterdir()]
    bags = {one.name for one in inside if (one / METADATA).is_file()}
    names = [one.name for one in inside if any(map(one.match, (*STORAGE, "*.bag", "*.bag.active")))]
    drives = {whole_of(name.removesuffix(ZSTD)) or name.removesuffix(ZSTD) for name in names}
    if bags or len(drives) != 1 or names[0].endswith((".bag", ".active")):
        recordings = sorted(bags.union(names))
        has = (
            f"but holds some: {names_text(recordings)}; name one of them" if recordings else "and holds none"
        )
        raise RecordingError(f"{folder}: this folder is no recording, {has}.")


def _read(recording: Recording) -> tuple[Counter[str], dict[str, int]]:
    """Return topic -> messages that can be read, and topic -> those that are announced beyond them."""
    counts: Counter[str] = Counter()
    recording.check_content()
    for message in recording.messages(list(recording.topics)):
        counts[message.topic] += 1
    return counts, {name: topic.count - counts[name] for name, topic in recording.topics.items()}


def _topics(recording: Recording, counts: Mapping[str, int]) -> dict[str, tuple[str, int]]:
    return {name: (topic.msgtype, counts.get(name, 0)) for name, topic in recording.topics.items()}


def _behind_end(path: Path) -> Iterator[str]:
    """Yield a clause about each file with bytes behind the recording's end, which no reader looks at, if its records tell where."""
    for one in sorted(path.iterdir()) if path.is_dir() else [path]:
        with suppress(Exception), one.open("rb") as file:  # whatever damaged bytes lead to
            first = file.readline(100)
            ends = {b"#ROSBAG": _end_of_bag, b"SQLite ": _end_of_database, b"\x89MCAP0\r": end_of_mcap}
            if (more := one.stat().st_size - ends[first[:7]](file)) > 0:
                yield f"{one.name}: behind the end of the recording are {more} more bytes, which are not read"


def _end_of_database(file: BinaryIO) -> int:
    file.seek(0)
    page_bytes, changes, pages, changes_then = Struct(">16xH6xII60xI").unpack(file.read(96))
    if changes != changes_then or not pages or journals_of([Path(file.name)]):
        raise ValueError(pages)  # the number of pages is an older one
    return int(65536 if page_bytes == 1 else page_bytes) * int(pages)


def _end_of_bag(file: BinaryIO) -> int:
    with closing(SummaryReader(Path(file.name), _ANY)) as bag:
        return bag.index_end


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
