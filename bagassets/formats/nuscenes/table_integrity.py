"""Integrity of nuScenes tables and their files: each check returns a sentence per problem.

A sentence counts the offending rows or files and names the first.
"""

from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

from bagassets.formats.nuscenes.schema import TABLES, Row
from bagassets.formats.nuscenes.table_file import read_table

__all__ = [
    "broken_references",
    "check_dataset_files",
    "check_files",
    "duplicate_tokens",
]

Tables = Mapping[str, Sequence[Row]]


class _Group(NamedTuple):
    """A table whose rows each own a chain of rows in another table."""

    owner: str
    member: str
    column: str
    number: str
    end: str


def broken_references(tables: Tables) -> list[str]:
    """Check that every token refers to a row, that chains are closed and in order, and that counts are true.

    Args:
        tables: table -> rows. References into a table that is not given are not followed, so that
            one recording can be checked by itself.
    """
    index = {name: {row["token"]: row for row in rows} for name, rows in tables.items()}
    return [
        *_references(tables, index),
        *_chains(index),
        *_ends(_Group("scene", "sample", "scene_token", "nbr_samples", "sample_token"), tables, index),
        *_ends(
            _Group("instance", "sample_annotation", "instance_token", "nbr_annotations", "annotation_token"),
            tables,
            index,
        ),
        *_keyframes(tables),
        *_maps(tables),
    ]


def check_files(
    sizes: Mapping[str, int], tables: Tables, elsewhere: AbstractSet[str] = frozenset()
) -> list[str]:
    """Check that the files in the tables are on disk and not empty, and that there are no others.

    Args:
        sizes: path below the dataroot -> size in bytes, of the files on disk.
        tables: table -> rows.
        elsewhere: files in the tables of other versions in this dataroot.
    """
    named = {row["filename"] for name in ("sample_data", "map") for row in tables.get(name, ())}
    present = sizes.keys()
    # An empty lidar file is a revolution without points.
    empty = [name for name in named & present if sizes[name] == 0 and not name.endswith(".pcd.bin")]
    return [
        *_sentence(
            "{} files of the tables are not on disk, the first is {}",
            sorted(named - present),
            one="{} file of the tables is not on disk: {}",
        ),
        *_sentence(
            "{} files on disk belong to no table, the first is {}",
            sorted(present - named - elsewhere),
            one="{} file on disk belongs to no table: {}",
        ),
        *_sentence("{} files are empty, the first is {}", sorted(empty), one="{} file is empty: {}"),
    ]


def check_dataset_files(dataroot: Path, version: str, tables: Tables, sizes: Mapping[str, int]) -> list[str]:
    """Check the files of one version of a dataset; its dataroot may hold others.

    Args:
        dataroot: folder of samples, sweeps and maps.
        version: name of the version folder.
        tables: table -> rows.
        sizes: path below the dataroot -> size in bytes, of the files on disk.

    Raises:
        DatasetError: a table of another version cannot be read.
    """
    others = [
        path.parent for path in sorted(dataroot.glob("*/sample_data.json")) if path.parent.name != version
    ]
    elsewhere = {
        row["filename"]
        for folder in others
        for name in ("sample_data", "map")
        for row in read_table(folder, name)
    }
    return check_files(sizes, tables, elsewhere)


def _sentence(text: str, offenders: Sequence[str], *, one: str | None = None) -> list[str]:
    """Return the sentence with the number of offenders and the first one; `one` is the text for a single offender."""
    text = one if one is not None and len(offenders) == 1 else text
    return [text.format(len(offenders), offenders[0]) + "."] if offenders else []


def duplicate_tokens(tables: Tables) -> list[str]:
    """Check that no token appears twice in a table, and no file in `sample_data`."""
    return list(_duplicates(tables))


def _duplicates(tables: Tables) -> Iterable[str]:
    for name, rows in tables.items():
        counts = Counter(row["token"] for row in rows)
        twice = [token for token, number in counts.items() if number > 1]
        yield from _sentence(
            f"{name}: {{}} tokens appear more than once, the first is {{}}",
            twice,
            one=f"{name}: {{}} token appears more than once: {{}}",
        )
    files = Counter(row["filename"] for row in tables.get("sample_data", ()))
    twice = [name for name, number in files.items() if number > 1]
    yield from _sentence(
        "sample_data: {} files are named by more than one row, the first is {}",
        twice,
        one="sample_data: {} file is named by more than one row: {}",
    )


def _references(tables: Tables, index: Mapping[str, Mapping[str, Row]]) -> Iterable[str]:
    for name, rows in tables.items():
        for column, target in TABLES[name].references.items():
            if target not in tables:
                continue
            known = {*index[target], ""} if column in TABLES[name].optional else index[target]
            if _all_known(rows, column, known):
                continue
            loose = [
                f"{token!r} of row {row['token']}"
                for row in rows
                for token in (row[column] if isinstance(row[column], list) else [row[column]])
                if token not in known
            ]
            yield from _sentence(
                f"{name}: {{}} values of {column} are in no row of {target}, the first is {{}}",
                loose,
                one=f"{name}: {{}} value of {column} is in no row of {target}: {{}}",
            )


def _all_known(rows: Sequence[Row], column: str, known: Container[str]) -> bool:
    """Return whether all rows have known tokens in a column; False if some have lists of them."""
    try:
        return all(map(known.__contains__, map(itemgetter(column), rows)))  # three times as fast as a loop
    except TypeError:
        return False


def _chains(index: Mapping[str, Mapping[str, Row]]) -> Iterable[str]:
    """Check that links are mutual, go forward in time, and stay within one scene, channel or instance."""
    chained = {
        "sample": "scene_token",
        "sample_data": "calibrated_sensor_token",
        "sample_annotation": "instance_token",
    }
    for name, group in chained.items():
        table = index.get(name, {})
        broken = []
        for row in table.values():
            after = table.get(row["next"])
            before = table.get(row["prev"])
            mutual = (after is None or after["prev"] == row["token"]) and (
                before is None or before["next"] == row["token"]
            )
            forward = after is None or (
                after[group] == row[group] and _time(row, index) < _time(after, index)
            )
            if not (mutual and forward):
                broken.append(row["token"])
        yield from _sentence(
            f"{name}: {{}} links of prev and next are broken, the first is at row {{}}", broken
        )


def _time(row: Row, index: Mapping[str, Mapping[str, Row]]) -> int:
    if "timestamp" in row:
        return int(row["timestamp"])
    sample = index.get("sample", {}).get(row["sample_token"])
    return int(sample["timestamp"]) if sample is not None else 0


def _ends(group: _Group, tables: Tables, index: Mapping[str, Mapping[str, Row]]) -> Iterable[str]:
    """Check the first and last member of each scene and instance, and the number of members."""
    counts = Counter(row[group.column] for row in tables.get(group.member, ()))
    members = index.get(group.member, {})
    wrong = []
    for row in tables.get(group.owner, ()):
        first, last = members.get(row[f"first_{group.end}"]), members.get(row[f"last_{group.end}"])
        if (
            counts[row["token"]] != row[group.number]
            or first is None
            or last is None
            or first["prev"] != ""
            or last["next"] != ""
            or {first[group.column], last[group.column]} != {row["token"]}
        ):
            wrong.append(row["token"])
    yield from _sentence(
        f"{group.owner}: {{}} rows disagree with their rows of {group.member}, the first is {{}}",
        wrong,
        one=f"{group.owner}: {{}} row disagrees with its rows of {group.member}: {{}}",
    )


def _keyframes(tables: Tables) -> Iterable[str]:
    data = tables.get("sample_data", ())
    not_boolean = [row["token"] for row in data if not isinstance(row["is_key_frame"], bool)]
    yield from _sentence(
        "sample_data: is_key_frame is not a JSON boolean in {} rows, the first is {}",
        not_boolean,
        one="sample_data: is_key_frame is not a JSON boolean in {} row: {}",
    )
    pairs: Counter[tuple[str, str]] = Counter(
        (row["sample_token"], row["calibrated_sensor_token"]) for row in data if row["is_key_frame"] is True
    )
    several = [sample for (sample, _), number in pairs.items() if number > 1]
    yield from _sentence(
        "sample: {} have two keyframe readings of one channel, the first is {}",
        several,
        one="sample: {} has two keyframe readings of one channel: {}",
    )
    with_readings = {sample for sample, _ in pairs}
    bare = [row["token"] for row in tables.get("sample", ()) if row["token"] not in with_readings]
    yield from _sentence(
        "sample: {} have no keyframe reading at all, the first is {}",
        bare,
        one="sample: {} has no keyframe reading at all: {}",
    )


def _maps(tables: Tables) -> Iterable[str]:
    if "map" not in tables:
        return
    mapped = {token for row in tables["map"] for token in row["log_tokens"]}
    without = [row["token"] for row in tables.get("log", ()) if row["token"] not in mapped]
    yield from _sentence("log: {} are on no map, the first is {}", without, one="log: {} is on no map: {}")
