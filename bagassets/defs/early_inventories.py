"""Inventories made ahead of the runs, while the server of a build still imports Dagster.

Starting the server keeps one processor busy for a second or two. Meanwhile another one reads the recordings that the
build will begin with; the runs then find these inventories in the store, or wait for the one that is being made. No
Dagster is needed here, and no failure is reported: it happens again in the run, which reports it.
"""

import gc
import logging
from pathlib import Path

from bagassets.build.choose import choose_recordings
from bagassets.build.execute import execute
from bagassets.build.first_pass import first_pass
from bagassets.build.graph import Graph
from bagassets.build.recording_assets import RecordingAssets
from bagassets.errors import BagAssetsError
from bagassets.forkserver.server_files import ServerFiles
from bagassets.formats.catalogue import recording_assets
from bagassets.json_types import JsonObject
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import DigestIndex, recording_stat
from bagassets.recordings.discover import discover
from bagassets.recordings.model import RecordingFiles
from bagassets.store.store import Store

__all__ = ["make_inventories"]

_LOG = logging.getLogger(__name__)
# For a larger recording the second saved is nothing, and an interrupted build must not leave a reader running for long.
_LARGEST_BYTES = 4_000_000_000


def make_inventories(args: JsonObject) -> int:
    """Make inventories until the server takes jobs; return the number of recordings that were tried.

    Args:
        args: `recipe` (file), `bags` (of `BuildOptions`), and `state` and `stamp` of the server's `ServerFiles`.
    """
    gc.enable()  # the server disables it while it imports
    files = ServerFiles(Path(args["state"]), args["stamp"])
    recipe = load_recipe(Path(args["recipe"]))
    assets = recording_assets(recipe)
    recordings = discover(recipe.bags).recordings
    chosen = choose_recordings(recordings, args["bags"]) if args["bags"] else recordings.keys()
    tried = 0
    # In the order of the build: the largest first.
    for recording in sorted(
        (recordings[key] for key in recordings if key in chosen), key=lambda one: -one.size
    ):
        if files.socket is not None:
            break
        if recording.size > _LARGEST_BYTES:
            continue
        tried += 1
        try:
            _make_inventory(assets, recording)
        except BagAssetsError as err:
            _LOG.info("%s: %s", recording.key, err)
    return tried


def _make_inventory(assets: RecordingAssets, recording: RecordingFiles) -> None:
    recipe, stat = assets.recipe, recording_stat(recording)
    store = Store(recipe.store_path)
    digest = first_pass(assets, store, recording, stat, DigestIndex.of(recipe)).digest.digest
    for _ in execute(Graph(assets, store, recording, digest, stat, wanted={"inventory"})):
        pass
