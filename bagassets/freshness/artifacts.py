"""Whether the artifacts of a store are as they were, without naming each of them to the system twice.

The list of artifacts is kept as bytes, 32 per digest, in 256 groups by the first one, as the store's
folders are. Of a small store every artifact is looked at. Of a large one (a stat costs 2 µs, and there
may be hundreds of thousands) it is every group's folder, whose time of change tells of artifacts that
came or went; where something did, the group's artifacts are looked at, and besides them those of some
groups taken at random, so that a file that was taken out of an artifact by hand is not missed for long.
"""

import os
import random
from collections.abc import Iterable
from hashlib import blake2b

from bagassets.freshness.marks import Doubt, Signature, signature

__all__ = ["Group", "artifacts_mark", "check_groups", "groups_of", "packed"]

# More artifacts than this are not looked at in one go.
MOST_LOOKED_AT = 10_000
_SIZE = 32

Group = tuple[str, int, Signature, str]
"""First byte in hex, number of artifacts, signature of the group's folder, mark of its artifacts."""


def packed(digests: Iterable[str]) -> bytes:
    """Return digests (64 hex digits each) as bytes, 32 for each."""
    return bytes.fromhex("".join(digests))


def artifacts_mark(root: str, digests: bytes) -> str:
    """Return the mark of artifacts: it changes when files come or go in one, or its manifest is replaced.

    The time of change of a folder is that of its last new, removed or renamed entry. Bytes that change
    in place are found by `bagassets verify`.

    Args:
        root: folder `artifacts` of the store.
        digests: 32 bytes for each.

    Raises:
        Doubt: one is not there.
    """
    hasher = blake2b(digest_size=_SIZE)
    stat = os.stat
    names = digests.hex()
    for start in range(0, len(names), 2 * _SIZE):
        path = f"{root}/{names[start : start + 2]}/{names[start : start + 2 * _SIZE]}"
        try:
            manifest, files = stat(f"{path}/manifest.json"), stat(f"{path}/files")
        except OSError as err:
            raise Doubt(f"{path}: {err}") from err
        hasher.update(
            b"%d %d %d %d;" % (manifest.st_ino, manifest.st_ctime_ns, files.st_ino, files.st_ctime_ns)
        )
    return hasher.hexdigest()


def groups_of(root: str, digests: bytes) -> list[Group]:
    """Return the groups of a sorted list of artifact digests, as they are in the store now.

    Args:
        root: folder `artifacts` of the store.
        digests: 32 bytes for each.

    Raises:
        Doubt: an artifact is not there.
    """
    groups: list[Group] = []
    start = 0
    while start < len(digests):
        end = start
        while end < len(digests) and digests[end] == digests[start]:
            end += _SIZE
        name = digests[start : start + 1].hex()
        # The folder first: what comes or goes meanwhile shows next time.
        folder = signature(f"{root}/{name}")
        groups.append((name, (end - start) // _SIZE, folder, artifacts_mark(root, digests[start:end])))
        start = end
    return groups


def check_groups(root: str, digests: bytes, groups: list[Group]) -> None:
    """Check that the artifacts are as `groups_of` found them.

    Raises:
        Doubt: one is not.
    """
    total = len(digests) // _SIZE
    if total != sum(number for _, number, _, _ in groups):
        raise Doubt("the list of artifacts is damaged")
    share = min(1.0, MOST_LOOKED_AT / max(total, 1))
    start = 0
    for name, number, folder, mark in groups:
        end = start + number * _SIZE
        path = f"{root}/{name}"
        # No secret is at stake: any groups will do, as long as they are others each time.
        is_due = share == 1.0 or signature(path) != folder or random.random() < share
        if is_due and artifacts_mark(root, digests[start:end]) != mark:
            raise Doubt(f"{path}: an artifact is not as it was")
        start = end
