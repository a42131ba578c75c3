"""What the last plan found of each recording, so that the next one looks only at those that changed.

A pure cache in one SQLite file in the state folder: an entry counts only while everything that it was
decided from is the same (its fingerprint), and its artifacts are in the store as they were. Only
recordings with nothing to do are remembered; a damaged or missing file costs time, nothing else.
"""

import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bagassets.bags.model import Found
from bagassets.engine.named_files import file_signature
from bagassets.engine.plan_model import AssetState, BagPlan
from bagassets.store.artifact import MANIFEST
from bagassets.store.canonical import digest_json
from bagassets.store.store import Store

__all__ = ["PlanMemo", "Remembered", "artifact_signature", "artifacts_of", "fingerprint", "signatures"]

_SCHEMA = 1
Signature = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Remembered:
    """A recording with nothing to do, as it was.

    Attributes:
        fingerprint: see `fingerprint`.
        plan: its states.
        signatures: digest of the signatures of its artifacts.
    """

    fingerprint: str
    plan: BagPlan
    signatures: str


def fingerprint(stamp: str, found: Found, storage_ids: Mapping[str, int], beside: Iterable[Path] = ()) -> str:
    """Return the digest of everything outside the store that the states of one recording are decided from.

    Args:
        stamp: digest of recipe, code and libraries.
        found: the recording; all its files are looked at.
        storage_ids: asset -> id of what Dagster recorded last; nothing if its partition is not alive.
        beside: label files of the recording.
    """
    files = []
    for path in found.files:
        stat = os.stat(path)  # noqa: PTH116  (twice as fast, for thousands)
        files.append([path.name, stat.st_size, stat.st_mtime_ns, stat.st_ino, stat.st_ctime_ns])
    labels = [[str(path), *file_signature(path)] for path in beside]
    return digest_json([_SCHEMA, stamp, found.relative, found.format, files, dict(storage_ids), labels])


def artifacts_of(plan: BagPlan) -> list[str]:
    """Return the artifacts that a recording with nothing to do rests on."""
    assets = [state.data_version for name, state in plan.assets.items() if name != "bag"]
    return [digest for digest in (*assets, *plan.channels) if digest is not None]


def artifact_signature(folder: str) -> Signature | None:
    """Return what tells whether files came or went in an artifact; None if it is not there.

    The time of change of a folder is that of its last new, removed or renamed entry. Bytes that change
    in place are found by `bagassets verify`.

    Args:
        folder: the artifact's folder.
    """
    try:
        manifest = os.stat(f"{folder}/{MANIFEST}")  # noqa: PTH116  (twice as fast, for thousands)
        files = os.stat(f"{folder}/files")  # noqa: PTH116
    except OSError:
        return None
    return manifest.st_ino, manifest.st_ctime_ns, files.st_ino, files.st_ctime_ns


def signatures(store: Store, plan: BagPlan) -> str | None:
    """Return the digest of the signatures of a recording's artifacts; None if one is not there."""
    root = f"{store.root}/artifacts"
    found = [artifact_signature(f"{root}/{digest[:2]}/{digest}") for digest in artifacts_of(plan)]
    return None if None in found else digest_json(found)


class PlanMemo:
    """The memory of one state folder.

    Args:
        folder: the state folder.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / "plan.sqlite"

    def load(self) -> dict[str, Remembered]:
        """Return partition key -> what is remembered; nothing if it cannot be read."""
        if not self._path.is_file():
            return {}
        try:
            with self._open() as connection:
                rows = connection.execute("SELECT key, fingerprint, body FROM bags").fetchall()
            return {key: _parse(key, mark, body) for key, mark, body in rows}
        except (sqlite3.Error, ValueError, TypeError):
            return {}

    def save(self, found: Iterable[Remembered], gone: Iterable[str]) -> None:
        """Remember recordings and forget others; a disk that refuses is no error."""
        rows = [(entry.plan.key, entry.fingerprint, _text(entry)) for entry in found]
        forget = [(key,) for key in gone]
        if not rows and not forget:
            return
        with suppress(OSError, sqlite3.OperationalError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            try:
                self._write(rows, forget)
            except sqlite3.OperationalError:
                raise  # locked, read-only or full: not a damage
            except sqlite3.DatabaseError:
                self._path.unlink(missing_ok=True)
                self._write(rows, forget)

    def _write(self, rows: list[tuple[str, str, str]], forget: list[tuple[str]]) -> None:
        with self._open() as connection:
            connection.execute(
                "CREATE TABLE IF NOT EXISTS bags (key TEXT PRIMARY KEY, fingerprint TEXT, body TEXT)"
            )
            connection.executemany("INSERT OR REPLACE INTO bags VALUES (?, ?, ?)", rows)
            connection.executemany("DELETE FROM bags WHERE key = ?", forget)

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        with closing(sqlite3.connect(self._path, timeout=10)) as connection, connection:
            yield connection


def _text(entry: Remembered) -> str:
    plan = entry.plan
    states = {name: [state.state, state.reason, state.data_version] for name, state in plan.assets.items()}
    return json.dumps(
        [states, plan.format, dict(plan.recorded), list(plan.channels), entry.signatures],
        separators=(",", ":"),
    )


def _parse(key: str, mark: str, text: str) -> Remembered:
    value: list[Any] = json.loads(text)
    states, file_format, recorded, channels, artifacts = value
    assets = {name: AssetState(*state) for name, state in states.items()}
    return Remembered(mark, BagPlan(key, assets, file_format, recorded, tuple(channels)), artifacts)
