"""The checks of a dataset, group by group: one in which nothing was wrong is read again only when it has changed.

What was found in a group is kept with the record of the published dataset, and holds as long as no file has changed. Where
anything is wrong, `dataset_checks` reads the tables, and says what.
"""

import json
from binascii import unhexlify
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np
from blake3 import blake3

from bagassets.base.json_types import Json, JsonObject
from bagassets.engine.freshness.published import Publication
from bagassets.formats.dataset_lock import LOCK
from bagassets.formats.groups import FoundInGroups, GroupsRecord, read_rows
from bagassets.formats.nuscenes.dataset_rows import MOST_BYTES, DatasetRows, number_of_files
from bagassets.formats.nuscenes.devkit_rules import Held, held_channels, row_problems, whole_problems
from bagassets.formats.nuscenes.schema import RECORDING_TABLES, SHARED_TABLES, TABLES
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.formats.nuscenes.table_file import read_table
from bagassets.formats.nuscenes.table_integrity import broken_references, duplicate_tokens, missing_files

# Tokens and file names are told apart by so many bytes.
_BYTES = 8
_WORD = f"u{_BYTES}"


@dataclass(frozen=True)
class Proven:
    """What was found in a dataset in which nothing is wrong.

    Attributes:
        rows: table of recordings -> number of rows.
        held: see `held_channels`.
        of_rigs: see `held_channels`.
    """

    rows: Mapping[str, int]
    held: Sequence[Held]
    of_rigs: Mapping[str, AbstractSet[str]]


def prove(settings: NuScenes, publication: Publication) -> Proven | frozenset[str]:
    """Check the groups in which something may be wrong.

    Returns:
        What was found if nothing is wrong; else the logs of the groups in which something is: none if it is in no single
        group, or nothing is on record.

    Raises:
        DatasetError: a table that exists once is missing or cannot be read.
    """
    record = GroupsRecord.from_json(publication.groups())
    if record is None or publication.changed_files(settings.output) != frozenset():
        return frozenset()
    shared = {name: read_table(settings.output / settings.version, name) for name in SHARED_TABLES}
    known = {name: {row["token"] for row in rows} for name, rows in shared.items()}
    memory = FoundInGroups(publication.state, publication.asset)
    before, proofs, logs = memory.load(), {}, set()
    for digest, group in record.groups.items():
        proof = before.get(digest)
        if proof is None or not all(
            known[name].issuperset(of) for name, of in _found(proof)["refers"].items()
        ):
            proof = _proof(settings, record, digest, shared)
        if proof is None:
            logs.update(group.facts["logs"])
        else:
            proofs[digest] = proof
    memory.save(proofs)
    if logs or not _is_right_as_a_whole(settings, record, shared, proofs):
        return frozenset(logs)
    found = [_found(proof) for proof in proofs.values()]
    of_rigs: dict[str, set[str]] = {}
    for one in found:
        for rig, channels in one["of_rigs"].items():
            of_rigs.setdefault(rig, set()).update(channels)
    return Proven(
        {
            name: sum(group.rows[f"{name}.json"].number for group in record.groups.values())
            for name in RECORDING_TABLES
        },
        [Held(*held) for one in found for held in one["held"]],
        of_rigs,
    )


def _proof(
    settings: NuScenes, record: GroupsRecord, digest: str, shared: Mapping[str, Sequence[JsonObject]]
) -> bytes | None:
    """Return what was found in a group, a line of JSON and hashes of tokens and file names; None if anything is wrong."""
    folder, groups = settings.output / settings.version, frozenset({digest})
    try:
        own = {
            name: json.loads(read_rows(folder / f"{name}.json", record, groups)) for name in RECORDING_TABLES
        }
        bags = json.loads(read_rows(folder / LOCK, record, groups))
        tables = {name: own[name] if name in own else shared[name] for name in TABLES if name != "map"}
        rigs = {bag["key"]: bag["rig"] for bag in bags}
        rows = DatasetRows(settings.output, settings.version, tables, frozenset(), len(bags), 0, rigs)
        if (
            broken_references(tables)
            or duplicate_tokens(tables)
            or missing_files(own["sample_data"], rows.sizes)
            or [*row_problems(rows)]
        ):
            return None
        held, of_rigs = held_channels(rows)
        files = [row["filename"] for row in own["sample_data"]]
        hashes = b"".join(blake3(name.encode()).digest(_BYTES) for name in files)
        for name, each in own.items():
            tokens = np.frombuffer(
                unhexlify("".join(row["token"][: 2 * _BYTES] for row in each)), dtype=_WORD
            )
            # Rows of two tables may have the same token: an ego pose has that of its reading.
            hashes += (tokens ^ np.frombuffer(blake3(name.encode()).digest(_BYTES), dtype=_WORD)).tobytes()
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None  # whoever reads the tables says what
    refers = {
        target: sorted({token for row in own[name] for token in _listed(row[column])} - {""})
        for name in RECORDING_TABLES
        for column, target in TABLES[name].references.items()
        if target in SHARED_TABLES
    }
    found = {
        "held": held,
        "of_rigs": {rig: sorted(names) for rig, names in of_rigs.items()},
        "refers": refers,
    }
    return json.dumps(found).encode() + b"\n" + hashes


def _found(proof: bytes) -> JsonObject:
    found: JsonObject = json.loads(proof.partition(b"\n")[0])
    return found


def _listed(value: Json) -> list[str]:
    return value if isinstance(value, list) else [value]


def _is_right_as_a_whole(
    settings: NuScenes,
    record: GroupsRecord,
    shared: Mapping[str, Sequence[JsonObject]],
    proofs: Mapping[str, bytes],
) -> bool:
    """Tell whether the files that exist once are right, and nothing is in two groups."""
    folder = settings.output / settings.version
    facts = [group.facts for group in record.groups.values()]
    scenes = {name for group in facts for names in group["scenes"].values() for name in names}
    logs = [{"token": log} for group in facts for log in group["logs"]]
    if [
        *whole_problems(folder, shared["map"], scenes),
        *broken_references({"map": shared["map"], "log": logs}),
    ]:
        return False
    hashes = b"".join(proof.partition(b"\n")[2] for proof in proofs.values())
    ordered = np.sort(np.frombuffer(hashes, dtype=_WORD))
    if (ordered[1:] == ordered[:-1]).any():
        return False
    if sum((folder / f"{name}.json").stat().st_size for name in TABLES) > MOST_BYTES:
        return True  # files that belong to no table are searched for in smaller datasets only
    named = sum(group.rows["sample_data.json"].number for group in record.groups.values())
    return number_of_files(settings.output) == named + len(shared["map"])
