"""Rows of a file of time ranges that are of no recording."""

import csv
import io
from collections.abc import Collection, Iterator
from pathlib import Path


def unknown_rows(path: Path, keys: Collection[str]) -> Iterator[str]:
    """Yield a sentence if rows are of none of all recordings; `cuts.by_file` says what else is wrong with the file."""
    try:
        rows = list(csv.DictReader(io.StringIO(path.read_text("utf-8-sig"))))
    except (OSError, UnicodeDecodeError, csv.Error):
        return
    named = ((line, row.get("recording")) for line, row in enumerate(rows, 2))
    unknown = [(line, key) for line, key in named if key and key not in keys]
    if unknown:
        (line, key), others = unknown[0], len(unknown) - 1
        more = f" (nor what {others} more of its rows name)" if others else ""
        yield (
            f"{path}:{line}: there is no recording {key}{more}, so it has no episodes; `bagassets status --all` lists the keys."
        )
