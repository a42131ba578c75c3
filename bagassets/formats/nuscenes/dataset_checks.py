"""The checks of a finished nuScenes dataset, over all its recordings."""

from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from itertools import chain, starmap

from bagassets.assets.quality.finding import Finding
from bagassets.base.garbage import uncollected
from bagassets.engine.freshness.published import Publication
from bagassets.formats.format import DatasetCheck
from bagassets.formats.nuscenes.dataset_rows import DatasetRows, read_dataset, repeated_tokens
from bagassets.formats.nuscenes.devkit_rules import channels_found, devkit_ready
from bagassets.formats.nuscenes.group_checks import Proven, prove
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.formats.nuscenes.table_integrity import (
    broken_references,
    check_dataset_files,
    duplicate_tokens,
    missing_files,
    repeated_tokens_sentence,
)


def dataset_references_intact(rows: DatasetRows) -> Finding:
    """Check that every token refers to a row, that chains are closed, and that counts are true."""
    return Finding(broken_references(rows.tables), _facts(rows))


def dataset_tokens_unique(rows: DatasetRows) -> Finding:
    """Check that no token and no file name exists twice.

    Where not all rows fit into memory, tokens are still compared over all recordings, file names are not.
    """
    if rows.is_whole:
        return Finding(duplicate_tokens(rows.tables), _facts(rows))
    repeated = starmap(repeated_tokens_sentence, repeated_tokens(rows.folder))
    return Finding([*chain.from_iterable(repeated)], _facts(rows))


def dataset_files_match(rows: DatasetRows) -> Finding:
    """Check that the files in the tables are on disk and not empty, and that there are no others.

    Others are searched for only if the rows of all recordings are read.
    """
    if rows.is_whole:
        return Finding(
            check_dataset_files(rows.dataroot, rows.version, rows.tables, rows.sizes), _facts(rows)
        )
    return Finding(missing_files(rows.tables["sample_data"], rows.sizes), _facts(rows))


def _facts(rows: DatasetRows) -> dict[str, int]:
    numbers = {name: len(its) for name, its in rows.tables.items()}
    return _numbers(numbers, rows.recordings, rows.of)


def _numbers(rows: Mapping[str, int], recordings: int, of: int) -> dict[str, int]:
    counts = {name: rows[name] for name in ("scene", "sample", "sample_data", "sample_annotation")}
    return counts | {"recordings_checked": recordings, "recordings": of}


_RULES: Mapping[DatasetCheck, Callable[[DatasetRows], Finding]] = {
    DatasetCheck(
        "dataset_references_intact",
        "references_intact",
        "Over all recordings, every token refers to a row, and chains are closed.",
    ): dataset_references_intact,
    DatasetCheck(
        "dataset_tokens_unique",
        "tokens_unique",
        "Over all recordings, no token and no file name exists twice.",
    ): dataset_tokens_unique,
    DatasetCheck(
        "dataset_files_match",
        "files_match",
        "The files below the dataroot are exactly those in the tables.",
    ): dataset_files_match,
    DatasetCheck(
        "devkit_ready",
        "devkit_ready",
        "The dataset has what nuscenes-devkit and its users rely on: formats, units, maps, splits, file layouts, all "
        "channels in every sample.",
    ): devkit_ready,
}
CHECKS = tuple(_RULES)


def check(
    settings: NuScenes, names: AbstractSet[str], publication: Publication | None = None
) -> dict[str, Finding]:
    """Run the named checks on the dataset on disk; return check -> finding.

    Args:
        settings: the recipe's `nuscenes`.
        names: names of the checks.
        publication: what is on record of the dataset, so that only groups of recordings with changes are read.

    Raises:
        DatasetError: a table is missing or cannot be read.
    """
    with uncollected():  # a fifth of the time with a million rows
        found: Proven | frozenset[str] = frozenset() if publication is None else prove(settings, publication)
        if isinstance(found, Proven):
            return _right(found, names)
        rows = read_dataset(settings.output, settings.version, doubted=found)
        return {one.name: rule(rows) for one, rule in _RULES.items() if one.name in names}


def _right(found: Proven, names: AbstractSet[str]) -> dict[str, Finding]:
    """Return the findings of the named checks on a dataset in which nothing is wrong."""
    logs = found.rows["log"]  # of recordings without scenes there are none
    facts = _numbers(found.rows, logs, logs)
    ready = channels_found(found.held, found.of_rigs, found.rows["scene"], [])
    return {name: ready if name == "devkit_ready" else Finding([], facts) for name in names}
