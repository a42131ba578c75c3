"""The first pass over a new recording, which gives its digest and its inventory together.

Both read all of it. One after the other they would read it from the disk twice, if it is larger than the page cache or lies
on a network. The action of an inventory names the digest, so it is recorded once this is known.
"""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from bagassets.assets import inventory
from bagassets.base.errors import RecordingError
from bagassets.base.files import remove, write_atomically
from bagassets.base.trace import span
from bagassets.engine.inputs import RecordingInputs
from bagassets.engine.process import keep_freed_memory
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.engine.source import EVERY_S, MessageSource, Progress, progress_told, tell_progress
from bagassets.recordings.digest import (
    HashedAlong,
    RecordingDigest,
    RecordingStat,
    recording_digest,
    stat_files,
    stored_digest,
)
from bagassets.recordings.model import RecordingFiles
from bagassets.store.canonical import digest_json
from bagassets.store.lease import action_lock, in_use
from bagassets.store.store import Outcome, Store

_AHEAD = "ahead"
_FORGOTTEN_S = 60 * EVERY_S


@dataclass(frozen=True)
class FirstPass:
    """What the first pass gave.

    Attributes:
        digest: of the recording.
        inventory: the outcome of its inventory, if that was made.
    """

    digest: RecordingDigest
    inventory: Outcome | None = None


def first_pass(assets: RecordingAssets, recording: RecordingFiles, stat: RecordingStat) -> FirstPass:
    """Do what `read_first` does; if another process is at the same recording, wait for it, and tell how far that is."""
    file, told = _reading_file(assets.recipe.state, recording), b""

    def relay() -> None:
        nonlocal told
        with suppress(OSError, ValueError, TypeError):
            if (said := file.read_bytes()) != told:
                told = said
                tell_progress(Progress(**json.loads(said)))

    with only_reader(assets.store, recording, stat, relay):
        return read_first(assets, recording, stat)


def read_first(assets: RecordingAssets, recording: RecordingFiles, stat: RecordingStat) -> FirstPass:
    """Return the digest of a recording; if it has to be hashed, make its inventory in the same pass.

    A recording of which content of the same size is on record was most likely touched only, and is just hashed. An inventory
    that fails is no error here: what is damaged is on record then, and read as such where it is asked for; anything else fails
    again there, and is reported.

    Args:
        assets: the assets of recordings, where the inventory goes, and the digest.
        recording: its files.
        stat: their current sizes and times.

    Raises:
        RecordingError: a file cannot be read.
        ChangedWhileReadError: a file changed while it was hashed.
        StoreError: the index cannot be written.
    """
    index = assets.index
    rows = [(index.row(path), stat) for path, stat in stat_files(recording)]
    is_touched = all(row is not None and row.size == stat.st_size for row, stat in rows)
    if is_touched or stored_digest(recording, index) is not None:
        return FirstPass(recording_digest(recording, index))
    keep_freed_memory()
    with HashedAlong(recording, index) as along:
        return _with_inventory(assets, recording, stat, along)


@contextmanager
def only_reader(
    store: Store, recording: RecordingFiles, stat: RecordingStat, on_wait: Callable[[], None] = lambda: None
) -> Iterator[None]:
    """Wait until no other process hashes a recording, and keep others from it; afterwards its digest may be on record."""
    lock = digest_json([str(recording.path), stat.as_json()])
    with in_use(store.root), action_lock(store.root, lock, on_wait):
        yield


def _with_inventory(
    assets: RecordingAssets, recording: RecordingFiles, stat: RecordingStat, along: HashedAlong
) -> FirstPass:
    recipe, store = assets.recipe, assets.store
    definitions, what = recipe.bags.message_definitions, "hash and inventory"
    source = MessageSource(recording, stat, definitions, recipe.limits, along.follow, what)
    inputs = RecordingInputs(store, recording, "", source)
    pending = summary = made = refused = None
    try:
        with suppress(Exception), span(what):
            use = inventory.use(inventory.InventoryParams.of(recipe, recipe.rigs[0]), inputs)[""]
            pending = store.begin(inventory.INVENTORY.action(use, None))
            try:
                summary = inventory.INVENTORY.run(use, inputs, pending.out)
            except RecordingError as err:
                refused = None if err.transient else str(err)
        digest = along.finish()
        if pending is not None and (summary is not None or refused):
            with suppress(Exception):
                inputs_now = {**pending.action.inputs, "bag": digest.digest}
                pending.action = replace(pending.action, inputs=inputs_now)
                if summary is not None:
                    made = store.use(pending.action) or pending.commit(summary)
                elif refused:
                    store.record_failure(pending.action, refused, recording.path)
        return FirstPass(digest, made)
    finally:
        if pending is not None:
            pending.discard()


# --- what was made before its run --------------------------------------------------------


@contextmanager
def reading_left(state: Path, recording: RecordingFiles) -> Iterator[None]:
    """Leave how far reading has come in this block where `first_pass` looks that waits for it."""
    file = _reading_file(state, recording)

    def leave(reading: Progress) -> None:
        write_atomically(file, json.dumps(vars(reading)).encode(), folders=True)

    try:
        with progress_told(leave):
            yield
    finally:
        with suppress(OSError):
            remove(file)


def forget_readings(state: Path) -> None:
    """Remove what killed processes have left of how far they had come; living ones leave it anew every few seconds."""
    for file in (state / _AHEAD).glob("*.reading"):
        with suppress(OSError):
            if time.time() - file.stat().st_mtime > _FORGOTTEN_S:
                remove(file)


def _reading_file(state: Path, recording: RecordingFiles) -> Path:
    return state / _AHEAD / f"{digest_json(str(recording.path))}.reading"


def note_made(state: Path, action_digest: str) -> None:
    """Note that an action was run ahead of the run that records it, so that this does not call its result an old one."""
    with suppress(OSError):
        write_atomically(state / _AHEAD / action_digest, b"", folders=True)


def ahead_of_run(key: str) -> str:
    """Return what stands for all of a recording in such notes."""
    return digest_json(["recording", key])


def was_just_made(state: Path, action_digest: str) -> bool:
    """Return whether an action was run ahead of this run, and forget that."""
    with suppress(OSError):
        return remove(state / _AHEAD / action_digest)
    return False
