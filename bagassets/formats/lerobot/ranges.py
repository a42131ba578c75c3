"""The file of time ranges that says where episodes are: a CSV with a row for each."""

import csv
import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from bagassets.base.errors import DatasetError

_SECONDS, _STAMPS = ("start_s", "end_s"), ("start_ns", "end_ns")


class Span(NamedTuple):
    """An episode as it is asked for.

    Attributes:
        start_ns: its first stamp.
        end_ns: its last.
        task: its task; None if whatever says where it is does not say that.
    """

    start_ns: int
    end_ns: int
    task: str | None = None


def by_file(content: bytes, path: Path, key: str, start_ns: int) -> list[Span]:
    """Return the episodes that a file of time ranges has for a recording, by their beginnings.

    Args:
        content: of the file.
        path: for errors.
        key: the recording.
        start_ns: where it begins.

    Raises:
        DatasetError: the file lacks a column, or a row of the recording has no times.
    """
    names, rows = _rows(content, path)
    columns = next((pair for pair in (_STAMPS, _SECONDS) if set(names).issuperset(pair)), None)
    if columns is None or "recording" not in names:
        raise DatasetError(
            f"{path}: expected the columns recording, start_s and end_s (or start_ns and end_ns), and maybe task; it has "
            f"{', '.join(filter(None, names)) or 'none'}."
        )
    own = ((line, row) for line, row in rows if row["recording"] == key)
    return sorted(_span(row, columns, f"{path}:{line}", start_ns) for line, row in own)


def _span(row: Mapping[str, str | None], columns: tuple[str, str], where: str, start_ns: int) -> Span:
    try:
        if columns == _STAMPS:
            first, last = (int(row[name] or "") for name in columns)
        else:
            first, last = (start_ns + round(float(row[name] or "") * 1e9) for name in columns)
    except (ValueError, OverflowError) as err:
        raise DatasetError(f"{where}: {' and '.join(columns)} must be numbers ({err}).") from err
    if last <= first:
        raise DatasetError(f"{where}: the episode ends before it begins; correct {' or '.join(columns)}.")
    return Span(first, last - 1, (row.get("task") or "").strip() or None)


def unknown_rows(path: Path, keys: Collection[str]) -> Iterator[str]:
    """Yield a sentence if rows are of none of all recordings; `by_file` says what else is wrong with the file."""
    try:
        _, rows = _rows(path.read_bytes(), path)
    except (OSError, DatasetError):
        return
    named = ((line, row["recording"] or "") for line, row in rows if "recording" in row and any(row.values()))
    unknown = [(line, key) for line, key in named if key not in keys]
    if unknown:
        (line, key), others = unknown[0], len(unknown) - 1
        more = f" (nor what {others} more of its rows name)" if others else ""
        yield (
            f"{path}:{line}: there is no recording {key or repr(key)}{more}, so it has no episodes; `bagassets status --all` lists the keys."
        )


def _rows(content: bytes, path: Path) -> tuple[Sequence[str], list[tuple[int, Mapping[str, str | None]]]]:
    """Return the names of the columns, and the rows with their lines."""
    try:
        reader = csv.DictReader(io.StringIO(content.decode("utf-8-sig")))
        return reader.fieldnames or (), [(reader.line_num, row) for row in reader]
    except (UnicodeDecodeError, csv.Error) as err:
        raise DatasetError(
            f"{path}: expected a CSV file with time ranges, but it cannot be read ({err})."
        ) from err
