"""Recordings that hold the same data in different files: converted ones, excerpts, and merges beside what they were merged of.

Their digests differ, so each is in the dataset, perhaps in different splits. But images and clouds that are made from the same
messages have the same names, which are their stamps, and the same bytes. So a recording is known by its marks: of each
channel, the first file of every period of five seconds. An excerpt shares them, but for those of the period in which it begins.
"""

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from hashlib import blake2b
from itertools import groupby
from operator import itemgetter

import numpy as np

from bagassets.assets.frames import FRAMES
from bagassets.assets.signals import SIGNALS
from bagassets.assets.sweeps import SWEEPS
from bagassets.base.alike import names_text
from bagassets.base.cache import Cache, Changes
from bagassets.base.errors import StoreError
from bagassets.base.fingerprints import PlanNeeded
from bagassets.base.json_types import JsonObject
from bagassets.store.store import Store

LOOKED_AT = (FRAMES.name, SWEEPS.name, SIGNALS.name)
_KIND = "marks 3"
_PERIOD_NS = 5_000_000_000
_MARK_BYTES = 8
# What so many hold is of a simulator that begins alike each time.
_MOST_ALIKE = 64


def same_data(
    versions: Mapping[str, Sequence[str]], store: Store, state: str | os.PathLike[str]
) -> Iterator[str]:
    """Yield a sentence about recordings that hold the same data, or of which one holds most of what another one does.

    Args:
        versions: recording -> data versions of `LOOKED_AT`, as far as it has them.
        store: has the artifacts.
        state: the state folder, which keeps the marks.
    """
    alike: dict[bytes, list[str]] = {}
    for key, marks in _marks(versions, store, state).items():
        alike.setdefault(marks, []).append(key)
    for keys in alike.values():
        if len(keys) > 1:
            yield (
                f"{names_text(keys)} hold the same data in different files, so each is in the dataset, perhaps in different "
                "splits; keep one, and name the others in bags.exclude or remove them."
            )
    wholes = _wholes({keys[0]: marks for marks, keys in alike.items()})
    for whole in sorted({*wholes.values()}):
        parts = sorted(part for part, of in wholes.items() if of == whole)
        yield (
            f"{names_text(parts)} {'hold parts' if len(parts) > 1 else 'holds a part'} of what {whole} holds, so this is in the "
            "dataset twice, perhaps in different splits; keep the whole or the parts, and name the others in bags.exclude or "
            "remove them."
        )


def _marks(
    versions: Mapping[str, Sequence[str]], store: Store, state: str | os.PathLike[str]
) -> dict[str, bytes]:
    """Return the marks of each recording whose artifacts are in the store; those on record are not looked for again."""
    cache, changes, known = Cache(state), Changes(), dict[str, bytes]()
    with suppress(PlanNeeded):
        known = cache.all(_KIND)
    names = {key: " ".join(digests) for key, digests in versions.items()}
    for key, name in names.items():
        if name not in known:
            with suppress(StoreError):
                known[name] = _found(store, versions[key])
                changes.put(_KIND, name, known[name])
    for name in known.keys() - names.values():
        changes.drop(_KIND, name)
    cache.write(changes)
    return {key: known[name] for key, name in names.items() if known.get(name)}


def _found(store: Store, digests: Iterable[str]) -> bytes:
    """Return the marks of a recording: of one without images and clouds, all files of its signals.

    Images that are the same again and again, such as black ones, count only where there is nothing else.

    Raises:
        StoreError: an artifact is not in the store.
    """
    marks, again, others = list[JsonObject](), list[JsonObject](), list[JsonObject]()
    for digest in digests:
        for channel in store.artifact(digest).read_json("channels.json").values():
            files: list[JsonObject] = store.artifact(channel["artifact"]).manifest()["files"]
            stamps = [
                (int(stamp), file) for file in files if (stamp := file["path"].partition(".")[0]).isdecimal()
            ]
            stamps.sort(key=itemgetter(0))
            firsts = [next(some)[1] for _, some in groupby(stamps, lambda one: one[0] // _PERIOD_NS)]
            times = Counter(one["digest"] for one in firsts)
            for one in firsts:
                (marks if times[one["digest"]] == 1 else again).append(one)
            others += () if stamps else files
    return b"".join(map(_mark, marks or again or others))


def _mark(file: JsonObject) -> bytes:
    return blake2b(f"{file['path']} {file['digest']}".encode(), digest_size=_MARK_BYTES).digest()


def _wholes(recordings: Mapping[str, bytes]) -> dict[str, str]:
    """Return recording -> the one that has most of its marks, and more than half, if there is one that is longer."""
    keys, sizes = list(recordings), [len(marks) // _MARK_BYTES for marks in recordings.values()]
    marks = np.frombuffer(b"".join(recordings.values()), np.uint64)
    found, times = np.unique(marks, return_counts=True)
    again = np.isin(marks, found[(times > 1) & (times <= _MOST_ALIKE)])
    held = [*zip(marks[again].tolist(), np.repeat(np.arange(len(keys)), sizes)[again].tolist(), strict=True)]
    holders: dict[int, set[int]] = {}
    for mark, one in held:
        holders.setdefault(mark, set()).add(one)
    shared: Counter[tuple[int, int]] = Counter()
    for mark, one in held:
        shared.update((one, other) for other in holders[mark] if (sizes[one], one) < (sizes[other], other))
    return {
        keys[one]: keys[other]
        for (one, other), number in sorted(shared.items(), key=itemgetter(1))
        if 2 * number > sizes[one]
    }
