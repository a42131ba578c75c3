"""Whether the artifacts of a store are unchanged, at a bounded number of system calls.

The list of artifacts is kept as bytes, 32 per digest, in 256 groups by the first byte, as the store's
folders are. In a small store every artifact is checked. In a large one (a stat costs 2 µs, and there
may be hundreds of thousands) only the folder of every group is, whose change time shows that artifacts
were added or removed. The artifacts of such a group are checked, and those of a few groups chosen at
random, so that a file removed from an artifact by hand does not go unnoticed for long.
"""

import os
import random
from collections.abc import Iterable
from hashlib import blake2b

from bagassets.base.fingerprints import PlanNeeded, Signature, signature

# No more artifacts than about this are checked at a time.
MOST_CHECKED = 10_000
SIZE = 32
"""Bytes of a digest."""

Group = tuple[str, int, Signature, str]
"""First byte in hex, number of artifacts, signature of the group's folder, fingerprint of its artifacts."""


def packed(digests: Iterable[str]) -> bytes:
    """Return digests (64 hex digits each) as bytes, 32 per digest."""
    return bytes.fromhex("".join(digests))


def artifacts_fingerprint(root: str, digests: bytes) -> str:
    """Return the fingerprint of artifacts: it changes when one gains or loses files, or its manifest is replaced.

    The change time of a folder is when an entry was last added, removed or renamed. Bytes that change
    in place are found by `bagassets verify`.

    Args:
        root: folder `artifacts` of the store.
        digests: 32 bytes per artifact.

    Raises:
        PlanNeeded: an artifact is missing.
    """
    hasher = blake2b(digest_size=SIZE)
    stat = os.stat
    names = digests.hex()
    for start in range(0, len(names), 2 * SIZE):
        path = f"{root}/{names[start : start + 2]}/{names[start : start + 2 * SIZE]}"
        try:
            manifest, files = stat(f"{path}/manifest.json"), stat(f"{path}/files")
        except OSError as err:
            raise PlanNeeded(f"{path}: {err}") from err
        hasher.update(
            b"%d %d %d %d;" % (manifest.st_ino, manifest.st_ctime_ns, files.st_ino, files.st_ctime_ns)
        )
    return hasher.hexdigest()


def marks_of(root: str, digests: bytes) -> bytes:
    """Return 8 bytes for each artifact that change when it gains or loses files, or its manifest is replaced.

    Raises:
        PlanNeeded: an artifact is missing.
    """
    ends = range(SIZE, len(digests) + 1, SIZE)
    return b"".join(
        bytes.fromhex(artifacts_fingerprint(root, digests[end - SIZE : end])[:16]) for end in ends
    )


def marked(digests: bytes, marks: bytes) -> bytes:
    """Return artifacts with the marks that they have, each once and in order."""
    starts = range(0, len(digests), SIZE)
    return b"".join(sorted({digests[at : at + SIZE] + marks[at // 4 : at // 4 + 8] for at in starts}))


def folders_of(root: str) -> dict[str, Signature]:
    """Return the signatures of the 256 folders in which artifacts are, by the first byte of their digests."""
    return {name: signature(f"{root}/{name}") for name in (f"{number:02x}" for number in range(256))}


def groups_of(root: str, digests: bytes) -> list[Group]:
    """Return the groups of a sorted list of artifact digests, as they are in the store now.

    Args:
        root: folder `artifacts` of the store.
        digests: 32 bytes per artifact.

    Raises:
        PlanNeeded: an artifact is missing.
    """
    groups: list[Group] = []
    start = 0
    while start < len(digests):
        end = start
        while end < len(digests) and digests[end] == digests[start]:
            end += SIZE
        name = digests[start : start + 1].hex()
        # The folder first: an artifact added or removed meanwhile then shows next time.
        folder = signature(f"{root}/{name}")
        groups.append((name, (end - start) // SIZE, folder, artifacts_fingerprint(root, digests[start:end])))
        start = end
    return groups


def check_groups(root: str, digests: bytes, groups: list[Group]) -> None:
    """Check that the artifacts are as they were when `groups_of` was called.

    Raises:
        PlanNeeded: one has changed.
    """
    total = len(digests) // SIZE
    if total != sum(number for _, number, _, _ in groups):
        raise PlanNeeded("the list of artifacts is damaged")
    share = min(1.0, MOST_CHECKED / max(total, 1))
    start = 0
    for name, number, folder, fingerprint in groups:
        end = start + number * SIZE
        path = f"{root}/{name}"
        # No secret is at stake: any groups will do, as long as they differ from time to time.
        is_due = share == 1.0 or signature(path) != folder or random.random() < share
        if is_due and artifacts_fingerprint(root, digests[start:end]) != fingerprint:
            raise PlanNeeded(f"{path}: an artifact has changed")
        start = end
