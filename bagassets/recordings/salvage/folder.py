"""ROS 2 bag folders of which the metadata, a file, or a part of one is damaged or missing."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonMapping
from bagassets.recordings.damage import DamageError, hole_reason, unreadable
from bagassets.recordings.database_file import Database
from bagassets.recordings.mcap_file import McapFile
from bagassets.recordings.model import METADATA
from bagassets.recordings.recording import How
from bagassets.recordings.rosbag2 import Rosbag2Recording, compression_mode, named_files, read_metadata
from bagassets.recordings.salvage.damage_map import END_UNKNOWN, Damage, Hole
from bagassets.recordings.salvage.database_pages import SalvagedDatabase, TopicRow
from bagassets.recordings.salvage.mcap_scan import SalvagedMcap
from bagassets.recordings.salvage.unpack import unpack_file

STORAGE = ("*.db3", "*.mcap", "*.db3.zstd", "*.mcap.zstd")
_NO_METADATA: JsonMapping = {"topics_with_message_count": []}


class SalvagedFolder(Rosbag2Recording):
    """A ROS 2 bag folder, for what can be read of it.

    Args:
        path: the folder.
        how: how it is opened.
        damage: takes what is found damaged.

    Raises:
        RecordingError: none of its files can be read.
    """

    def __init__(self, path: Path, how: How, damage: Damage) -> None:
        self._noted = damage
        super().__init__(path, how)

    def _described(self, path: Path) -> tuple[JsonMapping, str, list[Path]]:
        """Return the metadata, what is compressed, and the files; without metadata, those that are there."""
        try:
            metadata = read_metadata(path / METADATA)
            return metadata, compression_mode(metadata), named_files(path, metadata)
        except (BagAssetsError, DamageError, OSError) as err:
            self._noted.find(str(err) if isinstance(err, DamageError) else f"its {METADATA} cannot be read")
        self._noted.end_unknown(METADATA)
        files = [file for pattern in STORAGE for file in path.glob(pattern)]
        return _NO_METADATA, "none", sorted(files, key=_by_number)

    def _opened(self, files: Sequence[Path], metadata: JsonMapping, mode: str) -> list[Database | McapFile]:
        opened = [self._salvaged(file, metadata, mode) for file in files]
        found = [one for one in opened if not isinstance(one, BagAssetsError)]
        if not found:
            errors = (one for one in opened if isinstance(one, BagAssetsError))
            raise next(errors, DamageError("none of its files is there"))
        for one in found:
            if isinstance(one, SalvagedDatabase):
                self._name_topics(one, metadata, is_alone=len(found) == 1)
        if metadata is not _NO_METADATA:  # it says how many there were
            noted = self._noted
            noted.is_total_known = noted.is_listed = True
            noted.findings = {one: None for one in noted.findings if not one.endswith(END_UNKNOWN)}
        return found

    def _salvaged(self, file: Path, metadata: JsonMapping, mode: str) -> Database | McapFile | BagAssetsError:
        """Open one file; return why that cannot be, if so, which is noted."""
        try:
            return self._open(file, mode)
        except BagAssetsError as err:
            if err.transient:
                raise
            return self._lost(file, err, metadata)
        except Exception as err:  # noqa: BLE001  (whatever damaged bytes lead to)
            return self._lost(file, unreadable(file, err), metadata)

    def _unpack(self, file: Path, plain: Path) -> None:
        if problem := unpack_file(file, plain, self._sizes, self._how.on_read):
            size = file.stat().st_size
            self._noted.hole(Hole(file.name, size, size, problem), is_counted=False)

    def _reader(self, file: Path) -> Database | McapFile:
        if file.suffix == ".mcap":
            return SalvagedMcap(file, self._how.limits, self._how.on_read, self._noted, self._sizes)
        return SalvagedDatabase(file, self._how.limits, self._how.on_read, self._noted)

    def _lost(self, file: Path, err: BagAssetsError, metadata: JsonMapping) -> BagAssetsError:
        listed = [one for one in metadata.get("files") or [] if isinstance(one, dict)]
        number = next((one.get("message_count") for one in listed if one.get("path") == file.name), None)
        lost = {"": number} if isinstance(number, int) else None
        reason = hole_reason(file, err) if file.exists() else "the file is missing"
        size = file.stat().st_size if file.exists() else 0
        self._noted.hole(Hole(file.name, 0, size, reason, lost=lost), is_counted=False)
        return err

    def _name_topics(self, database: SalvagedDatabase, metadata: JsonMapping, *, is_alone: bool) -> None:
        """Give topics that have no row the name of the only topic in the metadata with so many messages."""
        counts, listed = database.counts(), metadata["topics_with_message_count"]
        unnamed = {number: count for number, count in counts.items() if number not in database.topics}
        for number, count in unnamed.items():
            alike = [entry["topic_metadata"] for entry in listed if entry["message_count"] == count]
            if len(alike) == 1 and Counter(unnamed.values())[count] == 1 and is_alone:
                name, msgtype, how = (
                    alike[0].get(one) or "" for one in ("name", "type", "serialization_format")
                )
                if all(isinstance(text, str) for text in (name, msgtype, how)):
                    database.topics[number] = TopicRow(name, msgtype, how, "")
        database.note_unnamed()

    def rows(self, file: SalvagedDatabase) -> Iterator[tuple[int, int, bytes | memoryview]]:
        """Yield topic id, log time and payload of the messages in one of the files, decompressed."""
        for number, log_time_ns, data in file.messages(file.topics):
            content = self._decompressed(file.topics[number].name, log_time_ns, data)
            if content is not None:
                yield number, log_time_ns, content

    def _decompressed(self, topic: str, time_ns: int, data: bytes | memoryview) -> bytes | memoryview | None:
        """Return a message, or None if it cannot be decompressed, which is noted."""
        try:
            return super()._decompressed(topic, time_ns, data)
        except Exception:  # noqa: BLE001  (as above)
            hole = Hole(METADATA, -1, -1, "messages cannot be decompressed", time_ns, time_ns)
            self._noted.cost(hole, topic)
            return None


def _by_number(file: Path) -> list[tuple[int, str]]:
    """Return what to sort parts by: their numbers as such."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", file.name)]
