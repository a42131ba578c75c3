"""After a crash, the last writes are read again, and torn files are removed so that the build makes them again.

Files appear by renaming, so a killed process leaves no torn one. But nothing waits for the disk: when a machine loses power,
files of the last half minute may exist with zeros or nothing in them. So the first build after a reboot, or after a build
that was killed, reads the artifacts written in the last `WINDOW_S` seconds before the newest one, the joined files of
datasets, and copies in datasets that are as new.
"""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bagassets.forkserver.process import ProcessId
from bagassets.formats.dataset_build import dataset_code_versions
from bagassets.freshness.cache import Cache
from bagassets.freshness.decide import BuildLog
from bagassets.freshness.fingerprints import PlanNeeded, boot_id
from bagassets.freshness.published import Publication
from bagassets.recipe.model import Recipe
from bagassets.store.artifact import MANIFEST, Artifact
from bagassets.store.integrity import artifact_damage
from bagassets.store.store import Store

__all__ = ["WINDOW_S", "noted_build", "repair_last_writes"]

# Every 5 s, Linux writes back what is older than 30 s; a slow disk takes longer.
WINDOW_S = 120.0
# Caches of earlier versions in the state folder; now they are one file.
_OLD_CACHES = ("plan.sqlite", "nothing-to-do.snapshot", "last-build.json")
_OLD_PUBLISHED = "published"


@contextmanager
def noted_build(recipe: Recipe, recipe_file: Path) -> Iterator[list[str]]:
    """Repair what a crash tore, and note that a build is running until it ends; only a kill leaves the note.

    Yields:
        A sentence about each removed artifact.
    """
    _remove_old_caches(recipe.state)
    builds = BuildLog(recipe.state)
    crashed = _crashed(builds)
    repaired = []
    if crashed is not None:
        Cache(recipe.state).remove_if_damaged()
        repaired = repair_last_writes(recipe)
    process = json.dumps(ProcessId.current().as_json())
    builds.begin(process, recipe_file, over=crashed or ())
    try:
        yield repaired
    finally:
        builds.end(process)


def repair_last_writes(recipe: Recipe) -> list[str]:
    """Read the last writes, remove torn artifacts, and return a sentence about each."""
    store = Store(recipe.store_path)
    sentences = []
    newest, since_s = _newest(store)
    for artifact in newest:
        reasons = artifact_damage(artifact)
        if reasons and artifact.folder.is_dir():
            store.remove(artifact.digest)
            sentences.append(f"{artifact.folder}: {reasons[0]}; torn by a crash, so it is made again")
    for asset in dataset_code_versions(recipe):
        Publication(recipe.state, asset).distrust(since_s, links=bool(sentences))
    return sentences


def _newest(store: Store) -> tuple[list[Artifact], float]:
    """Return the newest artifacts in the store, and the time from which on they were written (Unix seconds)."""
    times: dict[str, float] = {}
    for group in (store.root / "artifacts").glob("??"):
        with suppress(OSError), os.scandir(group) as entries:
            for entry in entries:
                with suppress(OSError):
                    times[entry.name] = os.stat(f"{entry.path}/{MANIFEST}").st_mtime
    since_s = max(times.values(), default=0.0) - WINDOW_S
    digests = sorted(digest for digest, time_s in times.items() if time_s >= since_s)
    return [Artifact(digest, store.artifact_folder(digest)) for digest in digests], since_s


def _crashed(builds: BuildLog) -> list[str] | None:
    """Return the builds that were killed; None if none was and the machine has not rebooted since the last build."""
    try:
        killed = [
            text for text in builds.unfinished() if not ProcessId.from_json(json.loads(text)).is_alive()
        ]
        is_same_boot = builds.last_boot_id() == boot_id()
    except PlanNeeded:
        return []  # the first build of this project, or the record is lost
    return killed if killed or not is_same_boot else None


def _remove_old_caches(state: Path) -> None:
    with suppress(OSError):
        for name in _OLD_CACHES:
            for path in [
                *state.glob(f"{name}*"),
                *state.glob(f".{name}*"),
            ]:  # with their journals and temporary files
                path.unlink()
    shutil.rmtree(state / _OLD_PUBLISHED, ignore_errors=True)
