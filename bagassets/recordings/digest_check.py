"""Comparing digests on record with the content of files."""

from collections.abc import Iterator
from dataclasses import dataclass
from os import stat_result
from pathlib import Path
from typing import Literal

from bagassets.recordings.digest import hash_file, stat_files
from bagassets.recordings.digest_record import DigestIndex, read_attribute
from bagassets.recordings.model import RecordingFiles

__all__ = ["Disagreement", "check_digests", "disagreements"]


@dataclass(frozen=True)
class Disagreement:
    """A digest on record that does not match the content of its file.

    Attributes:
        path: the file.
        where: `attribute` or `index`.
        recorded: the digest on record.
        actual: the digest of the content.
    """

    path: Path
    where: Literal["attribute", "index"]
    recorded: str
    actual: str

    def __str__(self) -> str:
        return (
            f"{self.path}: the digest on record ({self.where}, for this size and time) is {self.recorded[:16]}, that of "
            f"the content {self.actual[:16]}; the file was edited in place or its disk is failing. Compare it with its "
            "source, then accept it with `bagassets digest --rehash`."
        )


def check_digests(recording: RecordingFiles, index: DigestIndex | None) -> Iterator[Disagreement]:
    """Hash all files of a recording, and yield each digest on record that should match but does not.

    Records for another size or mtime are no disagreement: nobody trusts them.

    Raises:
        RecordingError: a file cannot be read.
        ChangedWhileReadError: a file changed while it was hashed.
    """
    for path, stat in stat_files(recording):
        yield from disagreements(path, stat, hash_file(path, stat), index)


def disagreements(
    path: Path, stat: stat_result, actual: str, index: DigestIndex | None
) -> Iterator[Disagreement]:
    """Yield each digest on record for a file with this status that is not the actual one."""
    attribute = read_attribute(path, stat)
    if attribute is not None and attribute != actual:
        yield Disagreement(path, "attribute", attribute, actual)
    indexed = None if index is None else index.get(path, stat)
    if indexed is not None and indexed != actual:
        yield Disagreement(path, "index", indexed, actual)
