"""Rules about a finished dataset as a whole: references, tokens and files over all recordings."""

from bagassets.formats.nuscenes.check import broken_references, check_dataset_files, duplicate_tokens
from bagassets.formats.nuscenes.dataset_rows import DatasetRows, repeated_tokens
from bagassets.quality.finding import Finding

__all__ = ["files_match", "references_intact", "tokens_unique"]


def references_intact(rows: DatasetRows) -> Finding:
    """Check that tokens lead somewhere, chains are closed, and counts are true."""
    return Finding(broken_references(rows.tables), _facts(rows))


def tokens_unique(rows: DatasetRows) -> Finding:
    """Check that no token and no file name exists twice; tokens over all recordings in any case."""
    if rows.is_whole:
        return Finding(duplicate_tokens(rows.tables), _facts(rows))
    problems = [
        f"{table}: 1 token appears more than once: {tokens[0]}."
        if len(tokens) == 1
        else f"{table}: {len(tokens)} tokens appear more than once, the first is {tokens[0]}."
        for table, tokens in repeated_tokens(rows.folder)
    ]
    return Finding(problems, _facts(rows))


def files_match(rows: DatasetRows) -> Finding:
    """Check that the files of the tables are on disk and not empty, and that there are no others.

    Others are looked for only if all rows are at hand.
    """
    if rows.is_whole:
        return Finding(check_dataset_files(rows.dataroot, rows.version, rows.tables), _facts(rows))
    missing, empty = [], []
    for row in rows.tables["sample_data"]:
        name = str(row["filename"])
        try:
            size = (rows.dataroot / name).stat().st_size
        except FileNotFoundError:
            missing.append(name)
            continue
        if size == 0 and not name.endswith(".pcd.bin"):
            empty.append(name)
    problems = []
    for names, what in ((missing, "not on disk"), (empty, "empty")):
        if len(names) == 1:
            problems.append(f"1 file of the tables is {what}: {names[0]}.")
        elif names:
            problems.append(f"{len(names)} files of the tables are {what}, the first is {names[0]}.")
    return Finding(problems, _facts(rows))


def _facts(rows: DatasetRows) -> dict[str, int]:
    counts = {
        name: len(rows.tables[name]) for name in ("scene", "sample", "sample_data", "sample_annotation")
    }
    return counts | {"recordings_checked": rows.recordings, "recordings": rows.of}
