"""A process that builds everything and assembles the dataset, to be killed or starved by tests.

`python -m bagassets_tests.build_process RECIPE [BYTES]`: with BYTES, no file may become larger.
"""

import resource
import sys
from pathlib import Path

from bagassets.base.errors import BagAssetsError
from bagassets.formats.assembly import assemble
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.store.store import Store
from bagassets_tests.recording_build import RecordingBuild


def make_dataset(recipe):
    store, parts = Store(recipe.store_path), []
    for key, recording in discover(recipe.bags).recordings.items():
        digest = recording_digest(recording).digest
        build = RecordingBuild(recipe, store, recording, digest, recording_stat(recording))
        made = {result.asset: result.artifact.digest for result in build.build()}
        parts.append(Part(key, key, made["nuscenes_tables"]))
    assemble(NUSCENES, parts, recipe.nuscenes, store, recipe.nuscenes.output)
    return parts


if __name__ == "__main__":
    if len(sys.argv) > 2:
        limit = int(sys.argv[2])
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    try:
        make_dataset(load_recipe(Path(sys.argv[1])))
    except BagAssetsError as err:
        sys.exit(str(err))
