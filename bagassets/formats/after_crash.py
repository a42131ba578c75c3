"""After a crash, the last writes are read again, and torn files are removed so that the build makes them again.

Files appear by renaming, so a killed process leaves no torn one. But nothing waits for the disk: when a machine loses power,
files of the last half minute may exist with zeros or nothing in them. So the first build after a reboot, or after a build
that was killed, reads the artifacts written in the last `WINDOW_S` seconds before the newest one, the joined files of
datasets, copies in datasets that are as new, and the report. After a reboot, the newest one is that from before it: runs of the web UI
may have come first.
"""

import json
import math
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from bagassets.base.cache import Cache
from bagassets.base.files import remove
from bagassets.base.fingerprints import PlanNeeded, boot_id, booted_at_s
from bagassets.engine.first_pass import forget_readings
from bagassets.engine.freshness.decide import BuildLog
from bagassets.engine.freshness.published import Publication
from bagassets.forkserver.process import ProcessId
from bagassets.formats.dataset_build import dataset_code_versions
from bagassets.formats.report_data import report_path
from bagassets.recipe.model import Recipe
from bagassets.store.artifact import MANIFEST, Artifact
from bagassets.store.collect import remove_leftovers
from bagassets.store.integrity import artifact_damage
from bagassets.store.store import Store

# Every 5 s, Linux writes back what is older than 30 s; a slow disk takes longer.
WINDOW_S = 120.0
# The clock may be set a little while a machine boots.
_CLOCK_S = 10.0


@contextmanager
def noted_build(recipe: Recipe, recipe_file: Path) -> Iterator[list[str]]:
    """Repair what a crash tore, and note that a build is running until it ends; only a kill leaves the note.

    Yields:
        A sentence about each removed artifact.
    """
    builds = BuildLog(recipe.state)
    killed, until_s = _crashed(builds)
    repaired = []
    if until_s is not None:
        Cache(recipe.state).remove_if_damaged()
        repaired = repair_last_writes(recipe, until_s)
    process = json.dumps(ProcessId.current().as_json())
    builds.begin(process, recipe_file, over=killed)
    remove_leftovers(Store(recipe.store_path), time.time())
    forget_readings(recipe.state)
    try:
        yield repaired
    finally:
        builds.end(process)


def repair_last_writes(recipe: Recipe, until_s: float) -> list[str]:
    """Read the last writes until some time (Unix seconds), remove torn artifacts, and return a sentence about each."""
    store = Store(recipe.store_path)
    sentences = []
    newest, since_s = _newest(store, until_s)
    for artifact in newest:
        reasons = artifact_damage(artifact)
        if reasons and artifact.folder.is_dir():
            store.remove(artifact.digest)
            sentences.append(f"{artifact.folder}: {reasons[0]}; torn by a crash, so it is made again")
    report = report_path(recipe)
    with suppress(OSError):
        if report.stat().st_mtime >= since_s and not report.read_bytes().rstrip().endswith(b"</html>"):
            remove(report)
    for asset in dataset_code_versions(recipe):
        Publication(recipe.state, asset).distrust(since_s, links=bool(sentences))
    return sentences


def _newest(store: Store, until_s: float) -> tuple[list[Artifact], float]:
    """Return the newest artifacts in the store of those written until some time (Unix seconds), and since when they were."""
    times: dict[str, float] = {}
    for group in (store.root / "artifacts").glob("??"):
        with suppress(OSError), os.scandir(group) as entries:
            for entry in entries:
                with suppress(OSError):
                    time_s = os.stat(f"{entry.path}/{MANIFEST}").st_mtime
                    if time_s < until_s:
                        times[entry.name] = time_s
    since_s = max(times.values(), default=0.0) - WINDOW_S
    digests = sorted(digest for digest, time_s in times.items() if time_s >= since_s)
    return [Artifact(digest, store.artifact_folder(digest)) for digest in digests], since_s


def _crashed(builds: BuildLog) -> tuple[Sequence[str], float | None]:
    """Return what happened since the last build began.

    Returns:
        Processes of the builds that were killed, and until when what may be torn was written (Unix seconds): None if no
        build was killed, and the machine has not rebooted.
    """
    try:
        killed = [
            text for text in builds.unfinished() if not ProcessId.from_json(json.loads(text)).is_alive()
        ]
        is_same_boot = builds.last_boot_id() == boot_id()
    except PlanNeeded:
        return (), math.inf  # the first build of this project, or the record is lost
    if is_same_boot:
        return killed, math.inf if killed else None
    booted_s = booted_at_s()
    return killed, math.inf if booted_s is None else booted_s + _CLOCK_S
