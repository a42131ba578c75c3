"""Integrity of nuScenes tables and their files: each check returns a sentence per problem.

A sentence counts the offending rows or files and names the first.
"""

from collections import Counter
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from operator import itemgetter
from pathlib import Path

from bagassets.assets.quality.finding import Finding, counted
from bagassets.base.errors import StoreError
from bagassets.formats.nuscenes.schema import TABLES, Row
from bagassets.formats.nuscenes.table_file import read_table
from bagassets.store.artifact import Artifact

Tables = Mapping[str, Sequence[Row]]
NOT_ON_DISK = "{} files|file of the tables are|is not on disk"


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
        *_ends("scene", "sample", tables, index),
        *_ends("instance", "sample_annotation", tables, index),
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
        *sentence(NOT_ON_DISK, sorted(named - present)),
        *sentence("{} files|file on disk belong|belongs to no table", sorted(present - named - elsewhere)),
        *sentence("{} files|file are|is empty", sorted(empty)),
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


def missing_files(sample_data: Sequence[Row], sizes: Mapping[str, int]) -> list[str]:
    """Check that the files of some rows are on disk and not empty.

    Args:
        sample_data: the rows.
        sizes: path below the dataroot -> size in bytes, of the files on disk.
    """
    names = [str(row["filename"]) for row in sample_data]
    missing = [name for name in names if name not in sizes]
    empty = [name for name in names if sizes.get(name) == 0 and not name.endswith(".pcd.bin")]
    return sentence(NOT_ON_DISK, missing) + sentence("{} files|file of the tables are|is empty", empty)


def files_match(
    sample_data: Sequence[Row],
    files: Sequence[Mapping[str, str]],
    artifact: Callable[[str], Artifact],
) -> Finding:
    """Check the files of one recording's tables against the store.

    Args:
        sample_data: rows of the table.
        files: content of `files.json`: where each `filename` is in the store.
        artifact: digest -> artifact; raises StoreError if it is gone.
    """
    named = [str(row["filename"]) for row in sample_data]
    listed = {entry["filename"] for entry in files}
    nowhere = sorted(set(named) - listed)
    unnamed = sorted(listed - set(named))
    problems = counted("{} files|file of sample_data are|is in no artifact", nowhere)
    problems += counted("{} listed files|file are|is not in sample_data", unnamed)
    artifacts: dict[str, tuple[Artifact, dict[str, int]]] = {}
    lost: dict[str, str] = {}
    missing, torn = [], []
    total = 0
    for entry in files:
        digest = entry["artifact"]
        if digest not in artifacts and digest not in lost:
            try:
                found = artifact(digest)
                artifacts[digest] = found, {file.path: file.size for file in found.entries()}
            except StoreError as err:
                lost[digest] = str(err)
                problems.append(f"{entry['filename']}: {err}")
        if digest in lost:
            continue
        whole, sizes = artifacts[digest]
        try:
            size = whole.path(entry["file"]).stat().st_size
        except FileNotFoundError:
            missing.append(entry["filename"])
            continue
        total += size
        expected = sizes.get(entry["file"])
        if size != expected:
            torn.append(f"{entry['filename']} ({size} bytes instead of {expected})")
    problems += counted("{} files|file are|is not in the store", missing)
    whose = "their|its artifacts'|artifact's manifests|manifest"
    problems += counted(f"{{}} files|file do|does not have the sizes|size in {whose}", torn)
    return Finding(problems, {"files": len(files), "bytes": total})


def sentence(text: str, offenders: Sequence[str]) -> list[str]:
    """Return what `counted` does, with a full stop."""
    return [f"{one}." for one in counted(text, offenders)]


def repeated_tokens_sentence(table: str, tokens: Sequence[str]) -> list[str]:
    """Return the sentence about the tokens that appear twice in a table; none without any."""
    return sentence(f"{table}: {{}} tokens|token appear|appears more than once", tokens)


def duplicate_tokens(tables: Tables) -> list[str]:
    """Check that no token appears twice in a table, and no file in `sample_data`."""
    problems = []
    for name, rows in tables.items():
        problems += repeated_tokens_sentence(name, _repeated(rows, "token"))
    files = _repeated(tables.get("sample_data", ()), "filename")
    return problems + sentence("sample_data: {} files|file are|is named by more than one row", files)


def _repeated(rows: Sequence[Row], column: str) -> list[str]:
    counts = Counter(row[column] for row in rows)
    return [value for value, number in counts.items() if number > 1]


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
            yield from sentence(f"{name}: {{}} values|value of {column} are|is in no row of {target}", loose)


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
        if broken:
            yield f"{name}: {len(broken)} links of prev and next are broken, the first is at row {broken[0]}."


def _time(row: Row, index: Mapping[str, Mapping[str, Row]]) -> int:
    if "timestamp" in row:
        return int(row["timestamp"])
    sample = index.get("sample", {}).get(row["sample_token"])
    return int(sample["timestamp"]) if sample is not None else 0


def _ends(owner: str, member: str, tables: Tables, index: Mapping[str, Mapping[str, Row]]) -> Iterable[str]:
    """Check the first and last member of each scene and instance, and the number of members."""
    column, name = f"{owner}_token", member.removeprefix("sample_")
    counts = Counter(row[column] for row in tables.get(member, ()))
    members = index.get(member, {})
    wrong = []
    for row in tables.get(owner, ()):
        first, last = members.get(row[f"first_{name}_token"]), members.get(row[f"last_{name}_token"])
        if (
            counts[row["token"]] != row[f"nbr_{name}s"]
            or first is None
            or last is None
            or first["prev"] != ""
            or last["next"] != ""
            or {first[column], last[column]} != {row["token"]}
        ):
            wrong.append(row["token"])
    text = f"{owner}: {{}} rows|row disagree|disagrees with their|its rows of {member}"
    yield from sentence(text, wrong)


def _keyframes(tables: Tables) -> Iterable[str]:
    data = tables.get("sample_data", ())
    not_boolean = [row["token"] for row in data if not isinstance(row["is_key_frame"], bool)]
    yield from sentence("sample_data: is_key_frame is not a JSON boolean in {} rows|row", not_boolean)
    pairs: Counter[tuple[str, str]] = Counter(
        (row["sample_token"], row["calibrated_sensor_token"]) for row in data if row["is_key_frame"] is True
    )
    several = [sample for (sample, _), number in pairs.items() if number > 1]
    yield from sentence("sample: {} have|has two keyframe readings of one channel", several)
    with_readings = {sample for sample, _ in pairs}
    bare = [row["token"] for row in tables.get("sample", ()) if row["token"] not in with_readings]
    yield from sentence("sample: {} have|has no keyframe reading at all", bare)


def _maps(tables: Tables) -> Iterable[str]:
    if "map" not in tables:
        return
    mapped = {token for row in tables["map"] for token in row["log_tokens"]}
    without = [row["token"] for row in tables.get("log", ()) if row["token"] not in mapped]
    yield from sentence("log: {} are|is on no map", without)
