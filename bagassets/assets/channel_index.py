"""The index of the files of a channel, `index.parquet`: what cameras, lidars and radars have in common."""

import pyarrow as pa

from bagassets.base.json_types import JsonObject
from bagassets.store.artifact import FileEntry

FILE_COLUMNS = {
    "stamp_ns": pa.int64(),
    "log_time_ns": pa.int64(),
    "file": pa.string(),
    "size": pa.int64(),
    "digest": pa.string(),
}


def file_row(entry: FileEntry, stamp_ns: int, log_time_ns: int) -> JsonObject:
    """Return the row of a file."""
    file = {"file": entry.path, "size": entry.size, "digest": entry.digest}
    return {"stamp_ns": stamp_ns, "log_time_ns": log_time_ns, **file}
