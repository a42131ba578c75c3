"""Artifacts: immutable folders of files, named by the digest of their manifest."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bagassets.base import files
from bagassets.base.disk_errors import disk_advice, disk_fails
from bagassets.base.errors import StoreError
from bagassets.base.json_types import Json, JsonObject
from bagassets.store.canonical import canonical_json, digest_bytes

if TYPE_CHECKING:
    import pyarrow as pa

MANIFEST = "manifest.json"


@contextmanager
def writing(path: files.AnyPath, what: str = "cannot be written") -> Iterator[None]:
    """Raise a `StoreError` about a path of the store if what is done inside fails."""
    try:
        yield
    except OSError as err:
        raise StoreError(f"{path}: {what} ({err.strerror}); {disk_advice(err)}.") from err


@dataclass(frozen=True, slots=True)
class FileEntry:
    """One file of an artifact."""

    path: str
    size: int
    digest: str


@dataclass(frozen=True)
class Artifact:
    """A finished artifact.

    Attributes:
        digest: digest of its manifest; its name, and the data version in Dagster.
        folder: its folder in the store.
    """

    digest: str
    folder: Path

    @property
    def files(self) -> Path:
        """Folder of the artifact's files."""
        return self.folder / "files"

    def path(self, relative: str) -> Path:
        """Return the path of one file."""
        # Datasets ask for hundreds of thousands: one path made from text costs half of two that are joined.
        return Path(f"{self.folder}/files/{relative}")

    def manifest(self) -> JsonObject:
        """Return the manifest: `files` (path, size, digest) and `summary` (counts of the step)."""
        try:
            manifest: JsonObject = json.loads((self.folder / MANIFEST).read_bytes())
        except (OSError, ValueError) as err:
            raise StoreError(
                f"{self.folder}: the manifest of this artifact cannot be read ({err}); {disk_advice(err, 'build again to heal the store')}."
            ) from err
        return manifest

    def entries(self) -> list[FileEntry]:
        """Return the files that belong to the artifact."""
        return [FileEntry(**entry) for entry in self.manifest()["files"]]

    def summary(self) -> JsonObject:
        """Return what the step reported: counts and other small facts."""
        summary: JsonObject = self.manifest()["summary"]
        return summary

    def read_json(self, relative: str) -> Json:
        """Return the content of a JSON file.

        Raises:
            StoreError: the file is gone or damaged.
        """
        try:
            return json.loads(self.path(relative).read_bytes())
        except (OSError, ValueError) as err:
            raise self._damaged(relative, err) from err

    def read_table(self, relative: str, columns: list[str] | None = None) -> "pa.Table":
        """Return the content of a Parquet file.

        Raises:
            StoreError: the file is gone or damaged.
        """
        import pyarrow as pa  # noqa: PLC0415  (0.2 s, not paid by commands that read no table)
        import pyarrow.parquet as pq  # noqa: PLC0415

        try:
            # Twice as fast as `read_table`, which is made for data sets of many files. Most tables are so small that threads and
            # reading ahead cost more time than they save.
            # Given the path, it would first look for a file system that knows it.
            file = pq.ParquetFile(pa.memory_map(str(self.path(relative))), pre_buffer=False)
            return file.read(columns, use_threads=False)
        except (OSError, pa.ArrowInvalid) as err:
            raise self._damaged(relative, err) from err

    def _damaged(self, relative: str, err: Exception) -> StoreError:
        reason = str(err).splitlines()[0] if str(err) else type(err).__name__
        advice = disk_advice(err, "remove the artifact with `bagassets verify`, then build again")
        state = "cannot be read" if disk_fails(err) else "is gone or damaged"
        return StoreError(f"{self.path(relative)}: this file of the store {state} ({reason}); {advice}.")


class ArtifactWriter:
    """Writes the files of an artifact that is being made; safe to use from several threads.

    Every file goes through `write`, which computes its digest.
    """

    def __init__(self, folder: Path) -> None:
        self._files = folder / "files"
        self._folder = folder
        self._entries: dict[str, FileEntry] = {}
        self._made = {str(self._files)}
        self._lock = threading.Lock()
        files.make_folder(self._files, new=True)

    @property
    def scratch(self) -> Path:
        """A folder on the store's disk for unnamed temporary files: a file with a name would stay in the artifact."""
        return self._folder

    def write(self, relative: str, data: bytes | memoryview) -> FileEntry:
        """Write one file.

        Raises:
            StoreError: the name was used before, or the file cannot be written.
        """
        entry = FileEntry(relative, len(data), digest_bytes(data))
        path = f"{self._files}/{relative}"
        with self._lock:
            if relative in self._entries:
                raise StoreError(f"{relative}: written twice into one artifact; this is a bug of the step.")
            self._entries[relative] = entry
        with writing(path):
            if (parent := path.rpartition("/")[0]) not in self._made:
                files.make_folder(parent)
                self._made.add(parent)
            files.write(path, data, new=True, mode=0o444)  # read-only, since datasets have hard links to it
        return entry

    def write_json(self, relative: str, value: object, *, indent: int | None = 1) -> FileEntry:
        """Write a JSON file with sorted keys."""
        text = json.dumps(value, sort_keys=True, indent=indent, ensure_ascii=False, allow_nan=False)
        return self.write(relative, (text + "\n").encode())

    def write_table(self, relative: str, table: "pa.Table") -> FileEntry:
        """Write a Parquet file, zstd-compressed, the same bytes for the same table."""
        import pyarrow as pa  # noqa: PLC0415  (0.2 s, not paid by commands that write no table)
        import pyarrow.parquet as pq  # noqa: PLC0415

        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd", store_schema=False)
        return self.write(relative, memoryview(sink.getvalue()))

    def finish(self, summary: JsonObject) -> str:
        """Write the manifest and return the digest of the artifact."""
        entries = [self._entries[name] for name in sorted(self._entries)]
        rows = [{"path": e.path, "size": e.size, "digest": e.digest} for e in entries]
        manifest = canonical_json({"files": rows, "summary": summary})
        with writing(self._folder):
            files.write(self._folder / MANIFEST, manifest)
            for name in (self._files, self._folder):
                name.chmod(0o755)
        return digest_bytes(manifest)
