"""The snapshot of a build that found nothing to do: one file in the state folder."""

import json
import os
from typing import TypedDict

from bagassets.quick.artifacts import Group, check_groups, groups_of
from bagassets.quick.looks import Doubt, boot, database_look, files_look, tree_look
from bagassets.quick.published import check as check_published

__all__ = ["NAME", "Before", "Header", "Places", "check", "load", "look_before", "remove", "save"]

NAME = "nothing-to-do.snapshot"
FORMAT = 2

Before = dict[str, str]
"""What was seen before anything was decided: boot of the machine, code, files, recordings, database."""


class Places(TypedDict):
    """Where to look.

    Attributes:
        recipe: the recipe file.
        files: files that the recipe names, and Dagster's configuration.
        bag_root: folder of the recordings.
        database: the database of Dagster's event log, a file of SQLite or a URL of PostgreSQL.
        partitions: name of the dynamic partitions.
        artifacts: folder of the artifacts in the store.
    """

    recipe: str
    files: list[str]
    bag_root: str
    database: str
    partitions: str
    artifacts: str


def look_before(code: str, places: Places) -> Before:
    """Look at everything that a plan is decided from, but the store; taken before the plan is made.

    Args:
        code: stamp of code, libraries and recipe.
        places: where to look.

    Raises:
        Doubt: something cannot be seen.
    """
    return {
        "boot": boot(),
        "code": code,
        "files": files_look(places["files"]),
        "recordings": tree_look(places["bag_root"]),
        "database": database_look(places["database"], places["partitions"]),
    }


def save(
    state: str,
    before: Before,
    places: Places,
    *,
    artifacts: set[str],
    published: list[str],
    lines: list[str],
) -> None:
    """Write the snapshot of a plan that found nothing to do.

    Args:
        state: the state folder.
        before: what `look_before` saw before the plan was made.
        places: where it looked.
        artifacts: digests of the artifacts that the plan rests on.
        published: folders with the records of what was published.
        lines: what a build with nothing to do prints.

    Raises:
        Doubt: something is not there any more.
        OSError: the file cannot be written.
    """
    digests = b"".join(sorted(bytes.fromhex(digest) for digest in artifacts))
    header: Header = {
        "format": FORMAT,
        "before": before,
        "places": places,
        "groups": groups_of(places["artifacts"], digests),
        "published": published,
        "lines": lines,
    }
    for folder in published:
        check_published(folder)
    path = os.path.join(state, NAME)  # noqa: PTH118  (no pathlib here: its import costs 5 ms)
    temporary = f"{path}.{os.getpid()}"
    with open(temporary, "wb", opener=_private) as stream:
        stream.write(json.dumps(header).encode() + b"\n" + digests)
    os.replace(temporary, path)  # noqa: PTH105


def _private(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)  # the URL of a database may hold a password


def remove(state: str) -> None:
    """Forget the snapshot, if there is one."""
    try:
        os.unlink(os.path.join(state, NAME))  # noqa: PTH108, PTH118
    except OSError:
        return


class Header(TypedDict):
    """The first line of a snapshot; the digests of the artifacts follow, 32 bytes each."""

    format: int
    before: Before
    places: Places
    groups: list[Group]
    published: list[str]
    lines: list[str]


def load(state: str) -> tuple[Header, bytes]:
    """Return header and artifact digests of the snapshot in a state folder.

    Raises:
        Doubt: there is none, or it is not readable.
    """
    path = os.path.join(state, NAME)  # noqa: PTH118
    try:
        with open(path, "rb") as stream:  # noqa: PTH123
            header: Header = json.loads(stream.readline())
            digests = stream.read()
        if header["format"] != FORMAT or sum(group[1] for group in header["groups"]) * 32 != len(digests):
            raise Doubt(f"{path}: damaged, or written by another version")
    except (OSError, ValueError, KeyError, TypeError, IndexError) as err:
        raise Doubt(f"{path}: {err}") from err
    return header, digests


def check(header: Header, digests: bytes, before: Before) -> None:
    """Compare a snapshot with what is seen now.

    Raises:
        Doubt: something differs.
    """
    for name, look in before.items():
        if header["before"].get(name) != look:
            raise Doubt(f"{name} changed")
    for folder in header["published"]:
        check_published(folder)
    check_groups(header["places"]["artifacts"], digests, header["groups"])
