"""What was written last before a crash is read once more, and what is torn is taken out so that the build mends it.

Files appear by renaming, so a killed process leaves none that is torn. But nothing waits for the disk: when a machine
loses power, what was written in the last half minute may be there by name, with zeros or nothing in it. So the first
build after another boot, or after a build that did not get to its end, reads what the store got in the last
`WINDOW_S` seconds before its newest file, all that datasets were put together from, and the copies in them that
are as new.
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

__all__ = ["WINDOW_S", "mend_last_writes", "noted_build"]

# Linux writes back what is older than 30 s, every 5 s, and a slow disk takes its time.
WINDOW_S = 120.0
# What earlier versions kept in the state folder; now it is in one file.
_OLD_CACHES = ("plan.sqlite", "nothing-to-do.snapshot", "last-build.json")
_OLD_PUBLISHED = "published"


@contextmanager
def noted_build(recipe: Recipe, recipe_file: Path) -> Iterator[list[str]]:
    """Mend what a crash tore, and note that a build is at work, until it ends in whatever way but a kill.

    Yields:
        What was taken out, in words.
    """
    _remove_old_caches(recipe.state)
    builds = BuildLog(recipe.state)
    crashed = _crashed(builds)
    mended = []
    if crashed is not None:
        Cache(recipe.state).remove_if_damaged()
        mended = mend_last_writes(recipe)
    process = json.dumps(ProcessId.current().as_json())
    builds.begin(process, recipe_file, over=crashed or ())
    try:
        yield mended
    finally:
        builds.end(process)


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
                    times[entry.name] = os.stat(f"{entry.path}/{MANIFEST}").st_mtime
    since_s = max(times.values(), default=0.0) - WINDOW_S
    digests = sorted(digest for digest, time_s in times.items() if time_s >= since_s)
    return [Artifact(digest, store.artifact_folder(digest)) for digest in digests], since_s


def _crashed(builds: BuildLog) -> list[str] | None:
    """Return the builds that were killed; None if none was, and the machine runs since before the last one."""
    try:
        killed = [
            text for text in builds.unfinished() if not ProcessId.from_json(json.loads(text)).is_alive()
        ]
        is_same_boot = builds.last_boot_id() == boot_id()
    except PlanNeeded:
        return []  # the first build of this project, or what was on record is lost
    return killed if killed or not is_same_boot else None


def _remove_old_caches(state: Path) -> None:
    with suppress(OSError):
        for name in _OLD_CACHES:
            for path in [
                *state.glob(f"{name}*"),
                *state.glob(f".{name}*"),
            ]:  # with journals, and what was being written
                path.unlink()
    shutil.rmtree(state / _OLD_PUBLISHED, ignore_errors=True)
