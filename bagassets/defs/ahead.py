"""What a build can begin with while its server still imports Dagster: the inventories of its recordings.

Starting the server keeps one processor busy for a second or two. Meanwhile this reads the recordings
that the build will begin with, on another one; runs find the inventories in the store, or wait for the
one that is just being made. It needs nothing of Dagster, and says nothing: what goes wrong here
goes wrong again in the run, which tells.
"""

import gc
import logging
from pathlib import Path
from typing import Any

from bagassets.build.choose import choose_recordings
from bagassets.build.execute import execute
from bagassets.build.graph import Graph
from bagassets.build.recording_assets import RecordingAssets
from bagassets.errors import BagAssetsError
from bagassets.forkserver.places import Places
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import DigestIndex, recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.recordings.model import RecordingFiles
from bagassets.store.store import Store

__all__ = ["make_inventories"]

_LOG = logging.getLogger(__name__)
# A second saved is nothing to larger ones, and an interrupted build should not leave a reader behind for long.
_LARGEST_BYTES = 4_000_000_000


def make_inventories(args: dict[str, Any]) -> int:
    """Make inventories until the server takes jobs; return how many were looked at.

    Args:
        args: `recipe` (file), `bags` (of `BuildOptions`), and `state` and `stamp` of the server's `Places`.
    """
    gc.enable()  # the server has it off while it imports
    places = Places(Path(args["state"]), args["stamp"])
    recipe = load_recipe(Path(args["recipe"]))
    assets = recording_assets(recipe)
    recordings = discover(recipe.bags).recordings
    chosen = choose_recordings(recordings, args["bags"]) if args["bags"] else recordings.keys()
    looked_at = 0
    # As the driver goes about it: the largest first.
    for recording in sorted(
        (recordings[key] for key in recordings if key in chosen), key=lambda one: -one.size
    ):
        if places.socket is not None:
            break
        if recording.size > _LARGEST_BYTES:
            continue
        looked_at += 1
        try:
            _make_inventory(assets, recording)
        except BagAssetsError as err:
            _LOG.info("%s: %s", recording.key, err)
    return looked_at


def _make_inventory(assets: RecordingAssets, recording: RecordingFiles) -> None:
    recipe, stat = assets.recipe, recording_stat(recording)
    digest = recording_digest(recording, DigestIndex(recipe.state)).digest
    store = Store(recipe.store_path)
    for _ in execute(Graph(assets, store, recording, digest, stat, wanted={"inventory"})):
        pass
