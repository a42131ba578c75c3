"""Whether the artifacts of a store are unchanged, at a bounded number of system calls.

Of each artifact 40 bytes are noted: its digest, and a mark that changes when it gains or loses files, or its manifest is
replaced. Artifacts fall into 256 groups by the first byte, as the store's folders do. In a small store every artifact is checked. In a large one (a stat costs 2 µs, and there may be hundreds of thousands) only the folder of every group is, whose
change time shows that artifacts were added or removed. The artifacts of such a group are checked, and those of a few groups
chosen at random, so that a file removed from an artifact by hand does not go unnoticed for long.
"""

import os
import random
from collections.abc import Iterable, Mapping
from hashlib import blake2b

from bagassets.base.fingerprints import PlanNeeded, Signature, signature

# No more artifacts than about this are checked at a time.
MOST_CHECKED = 10_000
SIZE = 40
"""Bytes that are noted of an artifact."""
_DIGEST, _MARK = 32, 8
ALL_GROUPS = frozenset(range(256))


def digests_in(noted: bytes) -> list[str]:
    """Return the digests (64 hex digits each) of artifacts of which this was noted."""
    return [noted[start : start + _DIGEST].hex() for start in range(0, len(noted), SIZE)]


def note_of(root: str, digests: Iterable[str]) -> bytes:
    """Return what is to be noted of artifacts.

    The change time of a folder is when an entry was last added, removed or renamed. Bytes that change
    in place are found by `bagassets verify`.

    Args:
        root: folder `artifacts` of the store.
        digests: 64 hex digits per artifact.

    Raises:
        PlanNeeded: an artifact is missing.
    """
    noted = []
    stat = os.stat
    for digest in digests:
        path = f"{root}/{digest[:2]}/{digest}"
        try:
            manifest, files = stat(f"{path}/manifest.json"), stat(f"{path}/files")
        except OSError as err:
            raise PlanNeeded(f"{path}: {err}") from err
        times = b"%d %d %d %d" % (manifest.st_ino, manifest.st_ctime_ns, files.st_ino, files.st_ctime_ns)
        noted += [bytes.fromhex(digest), blake2b(times, digest_size=_MARK).digest()]
    return b"".join(noted)


def each_once(noted: bytes) -> bytes:
    """Return what was noted of artifacts, of each once, in order."""
    return b"".join(sorted({noted[start : start + SIZE] for start in range(0, len(noted), SIZE)}))


def folders_of(root: str) -> dict[str, Signature]:
    """Return the signatures of the 256 folders in which artifacts are, by the first byte of their digests in hex.

    Ask for them before the artifacts: one that is added or removed meanwhile then shows next time.
    """
    return {name: signature(f"{root}/{name}") for name in (f"{number:02x}" for number in range(256))}


def groups_to_check(
    before: Mapping[str, Signature], now: Mapping[str, Signature], total: float, *, sampled: bool = True
) -> frozenset[int]:
    """Return the groups whose artifacts are to be checked, by their first byte.

    Args:
        before: signatures of the folders (`folders_of`) when artifacts were noted.
        now: signatures as they are.
        total: number of artifacts.
        sampled: of a large store, some groups are checked, too, whose folder has not changed.
    """
    share = MOST_CHECKED / max(total, 1)
    if share >= 1.0:
        return ALL_GROUPS
    # No secret is at stake: any groups will do, as long as they differ from time to time.
    share *= sampled
    changed = (int(name, 16) for name in now if before.get(name) != now[name] or random.random() < share)
    return frozenset(changed)


def are_unchanged(root: str, noted: bytes, groups: frozenset[int]) -> bool:
    """Return whether those artifacts that are in some groups are as they were noted."""
    if groups.isdisjoint(noted[::SIZE]):
        return True
    if groups != ALL_GROUPS:
        starts = (start for start in range(0, len(noted), SIZE) if noted[start] in groups)
        noted = b"".join(noted[start : start + SIZE] for start in starts)
    try:
        return note_of(root, digests_in(noted)) == noted
    except PlanNeeded:
        return False
