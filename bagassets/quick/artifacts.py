"""Whether the artifacts of a store are as they were, without naming each of them to the system twice.

The list of artifacts is kept as bytes, 32 per digest, in 256 groups by the first one, as the store's
folders are. Of a small store every artifact is looked at. Of a large one (a stat costs 2 µs, and there
may be hundreds of thousands) it is every group's folder, whose time of change tells of artifacts that
came or went; where something did, the group's artifacts are looked at, and besides them those of some
groups taken at random, so that a file that was taken out of an artifact by hand is not missed for long.
"""

import os
import random
from hashlib import blake2b

from bagassets.quick.looks import Doubt, signature

__all__ = ["Group", "check_groups", "groups_of"]

# More artifacts than this are not looked at in one go.
MOST_LOOKED_AT = 10_000
_SIZE = 32

Group = tuple[str, int, list[int], str]
"""First byte in hex, number of artifacts, signature of the group's folder, digest over its artifacts."""


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
        groups.append((name, (end - start) // _SIZE, folder, _look(f"{root}/{name}", digests[start:end])))
        start = end
    return groups


def check_groups(root: str, digests: bytes, groups: list[Group]) -> None:
    """Check that the artifacts are as `groups_of` found them.

    Raises:
        Doubt: one is not.
    """
    total = len(digests) // _SIZE
    share = min(1.0, MOST_LOOKED_AT / max(total, 1))
    start = 0
    for name, number, folder, look in groups:
        end = start + number * _SIZE
        path = f"{root}/{name}"
        # No secret is at stake: any groups will do, as long as they are others each time.
        is_due = share == 1.0 or signature(path) != folder or random.random() < share  # noqa: S311
        if is_due and _look(path, digests[start:end]) != look:
            raise Doubt(f"{path}: an artifact is not as it was")
        start = end


def _look(folder: str, digests: bytes) -> str:
    """Return a digest over the signatures of artifacts.

    Raises:
        Doubt: one is not there.
    """
    hasher = blake2b(digest_size=_SIZE)
    stat = os.stat
    for start in range(0, len(digests), _SIZE):
        path = f"{folder}/{digests[start : start + _SIZE].hex()}"
        try:
            manifest, files = stat(f"{path}/manifest.json"), stat(f"{path}/files")
        except OSError as err:
            raise Doubt(f"{path}: {err}") from err
        hasher.update(
            b"%d %d %d %d;" % (manifest.st_ino, manifest.st_ctime_ns, files.st_ino, files.st_ctime_ns)
        )
    return hasher.hexdigest()
