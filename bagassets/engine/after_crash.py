"""What was written last before a crash is read once more, and what is torn is taken out so that the build mends it.

Files appear by renaming, so a killed process leaves none that is torn. But nothing waits for the disk: when a machine
loses power, what was written in the last half minute may be there by name, with zeros or nothing in it. So the first
build after another boot, or after a build that did not get to its end, reads what the store got in the last
`WINDOW_S` seconds before its newest file, all that datasets were put together from, and the copies in them that
are as new.
"""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from bagassets.engine.dataset_build import dataset_code_versions
from bagassets.engine.publication import Publication
from bagassets.forkserver.process import ProcessId
from bagassets.quick.looks import boot
from bagassets.recipe.model import Recipe
from bagassets.store.artifact import MANIFEST, Artifact
from bagassets.store.integrity import artifact_damage
from bagassets.store.store import Store

__all__ = ["WINDOW_S", "mend_last_writes", "noted_build"]

# Linux writes back what is older than 30 s, every 5 s, and a slow disk takes its time.
WINDOW_S = 120.0
_NOTE = "last-build.json"


@contextmanager
def noted_build(recipe: Recipe) -> Iterator[list[str]]:
    """Mend what a crash tore, and note that a build is at work, until it ends in whatever way but a kill.

    Yields:
        What was taken out, in words.
    """
    path = recipe.state / _NOTE
    mended = mend_last_writes(recipe) if _has_crashed(path) else []
    _note(path, ProcessId.current())
    try:
        yield mended
    finally:
        _note(path, None)


def mend_last_writes(recipe: Recipe) -> list[str]:
    """Read what was written last, take out what is torn, and return that in words."""
    store = Store(recipe.store_path)
    told = []
    newest, since_s = _newest(store)
    for artifact in newest:
        reasons = artifact_damage(artifact)
        if reasons and artifact.folder.is_dir():
            store.remove(artifact.digest)
            told.append(f"{artifact.folder}: {reasons[0]}; torn by a crash, so it is made again")
    for asset in dataset_code_versions(recipe):
        Publication(recipe.state, asset).distrust(since_s, links=bool(told))
    return told


def _newest(store: Store) -> tuple[list[Artifact], float]:
    """Return the artifacts that came last into the store, and since when (Unix seconds)."""
    times: dict[str, float] = {}
    for group in (store.root / "artifacts").glob("??"):
        with suppress(OSError), os.scandir(group) as entries:
            for entry in entries:
                with suppress(OSError):
                    times[entry.name] = os.stat(f"{entry.path}/{MANIFEST}").st_mtime  # noqa: PTH116  (for thousands)
    since_s = max(times.values(), default=0.0) - WINDOW_S
    digests = sorted(digest for digest, time_s in times.items() if time_s >= since_s)
    return [Artifact(digest, store.artifact_folder(digest)) for digest in digests], since_s


def _has_crashed(path: Path) -> bool:
    """Tell whether the machine was started anew since the last build, or that build was killed."""
    try:
        note = json.loads(path.read_bytes())
        process = note["process"]
        if note["boot"] != boot():
            return True
        return process is not None and not ProcessId.from_json(process).is_alive()
    except FileNotFoundError:
        return False  # the first build of this project, or of this version
    except (OSError, ValueError, KeyError, TypeError):
        return True


def _note(path: Path, process: ProcessId | None) -> None:
    temporary = path.with_name(f".{path.name}.{uuid4().hex}")
    with suppress(OSError):
        value = {"boot": boot(), "process": None if process is None else process.as_json()}
        temporary.write_text(json.dumps(value), "utf-8")
        temporary.replace(path)
