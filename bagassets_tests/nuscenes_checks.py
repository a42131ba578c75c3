"""All checks of nuScenes tables at once, for tests of finished datasets and of parts."""

from bagassets.formats.nuscenes.dataset_rows import file_sizes
from bagassets.formats.nuscenes.schema import TABLES
from bagassets.formats.nuscenes.table_file import read_table
from bagassets.formats.nuscenes.table_integrity import (
    broken_references,
    check_dataset_files,
    duplicate_tokens,
)


def check_tables(tables):
    """Return what is wrong with tokens, references, chains and counts of rows."""
    return [*duplicate_tokens(tables), *broken_references(tables)]


def check_dataset(dataroot, version):
    """Return what is wrong with the tables and files of a finished dataset."""
    tables = {name: read_table(dataroot / version, name) for name in TABLES}
    return [*check_tables(tables), *check_dataset_files(dataroot, version, tables, file_sizes(dataroot))]
