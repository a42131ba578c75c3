"""What is made ahead of the runs that need it: the recordings that a build begins with, and the page of the map.

Starting the server of a build keeps one processor busy for a second or two; opening Dagster's records, planning and starting
a run take a third of a second. Meanwhile another processor makes the recordings that the build will begin with. The page of
the map, which is the same for all recordings, is made when a processor has nothing else to do: the run of the datasets comes
last, alone. The runs find all this in the store, or wait for what is being made. No Dagster is needed here, and no failure
is reported: it happens again in the run, which reports it.
"""

import gc
import logging
import os
import sys
import time
from collections.abc import Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

import yaml

from bagassets.assets.inventory import INVENTORY
from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonObject
from bagassets.engine.build_report import BuildOptions
from bagassets.engine.choose import choose_recordings
from bagassets.engine.execute import AssetResult, execute
from bagassets.engine.first_pass import ahead_of_run, note_made, only_reader, read_first, reading_left
from bagassets.engine.graph import Graph
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.forkserver.client import Client
from bagassets.forkserver.server_files import ServerFiles
from bagassets.forkserver.tasks import find_server
from bagassets.formats.catalogue import recording_assets
from bagassets.propose.project import dagster_home
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Recipe
from bagassets.recordings.digest import recording_stat, stat_files, stored_digest
from bagassets.recordings.discover import discover
from bagassets.recordings.model import RecordingFiles
from bagassets.store.store import Store

_LOG = logging.getLogger(__name__)
# For a larger recording the second saved is nothing, and an interrupted build must not leave a reader running for long.
_LARGEST_BYTES = 4_000_000_000
# A run that waits for another process says nothing of how far that is; one that is at work for ten seconds should.
_LARGEST_WHOLE_BYTES = 2_000_000_000
_FIRST_JOB, _JOB, _MAP_JOB = (f"{__name__}:{name}" for name in ("make_first", "make_ahead", "make_map"))
# So long does a build open Dagster and plan; then its runs begin, and need the processors.
_BEGIN_S = 0.35
_LEAST_URGENT = 19
_LAUNCHER = "BagAssetsRunLauncher"  # in `dagster.yaml`


def make_first(args: JsonObject) -> int:
    """Make recordings until the server takes jobs and its build has planned; return the number of those that were tried.

    Another process would make the maps of all lenses anew, and the machine code, before it could go on.

    Args:
        args: `recipe` (file), `bags` and `select` (of `BuildOptions`), and `state` and `stamp` of the server's `ServerFiles`.
    """
    gc.freeze()  # what the server has imported so far would be scanned again and again
    gc.enable()  # the server disables it while it imports
    files, recipe_file = ServerFiles(Path(args["state"]), args["stamp"]), Path(args["recipe"])
    recipe = load_recipe(recipe_file)
    whole_bytes = 0 if args["select"] or not _has_our_launcher(recipe_file, recipe) else _LARGEST_WHOLE_BYTES
    assets, tried = recording_assets(recipe), 0
    known = assets.index.digests()
    for recording in _chosen(recipe, args["bags"], _LARGEST_BYTES):
        if _has_planned(files):
            break
        tried += 1
        _make(assets, recording, known, whole_bytes)
    return tried


@contextmanager
def making_ahead(recipe_file: Path, options: BuildOptions) -> Iterator[None]:
    """Have the server make what a build is likely to need, while the block plans and does the rest.

    Begin before Dagster is opened, which takes a tenth of a second. The server is asked by a thread: it may be busy, and it
    forks. Where other machines execute the runs, they read, too.
    """
    with ThreadPoolExecutor(max_workers=1) as pool:
        asking = pool.submit(_submit, recipe_file, options)
        try:
            yield
        finally:
            if client := asking.result():
                client.close()


def make_ahead(args: JsonObject) -> None:
    """Make what is new while a build plans (see `make_new`), and then the page of the map.

    Args:
        args: `recipe` (file) and `bags` (of `BuildOptions`).
    """
    make_new(load_recipe(Path(args["recipe"])), args["bags"])
    make_map(args)


def make_map(args: JsonObject) -> None:
    """Make the page of the map, if the project has one; `args` has its `recipe` (file)."""
    recipe = load_recipe(Path(args["recipe"]))
    os.nice(_LEAST_URGENT)  # the runs have begun
    if recipe.preview.has_map:
        # Folium looks whether it is there, for tables that it could draw; that takes longer than the page.
        sys.modules.setdefault("pandas", None)  # type: ignore[arg-type]  # Python's way to say that it is not
        from bagassets.formats.trajectory_map import map_shell_of  # noqa: PLC0415  (`make_first` must begin at once)

        with suppress(BagAssetsError, OSError):
            map_shell_of(Store(recipe.store_path))


def make_new(recipe: Recipe, bags: Collection[str]) -> None:
    """Make recordings that have not been hashed as they are, the largest first, while a build plans.

    Args:
        recipe: the recipe.
        bags: of `BuildOptions`.
    """
    began_s = time.monotonic()
    assets = recording_assets(recipe)
    known = assets.index.digests()
    for recording in _chosen(recipe, bags, _LARGEST_WHOLE_BYTES):
        if time.monotonic() - began_s > _BEGIN_S:
            break
        with suppress(BagAssetsError):
            if stored_digest(recording, assets.index) is None:
                _make(assets, recording, known, _LARGEST_WHOLE_BYTES)


def _has_planned(files: ServerFiles) -> bool:
    """Return whether a server has been taking jobs for so long that the build that started it has planned."""
    with suppress(OSError):  # it is not there yet
        return files.socket is not None and not 0 <= time.time() - files.lock.stat().st_mtime <= _BEGIN_S
    return False


def _has_our_launcher(recipe_file: Path, recipe: Recipe) -> bool:
    """Return whether workers of the server are to execute the runs, as far as can be told without Dagster."""
    # What is wrong with the file, the build meets, too, and reports.
    with suppress(BagAssetsError, OSError, LookupError, TypeError, yaml.YAMLError):
        said = yaml.safe_load((dagster_home(recipe_file, recipe) / "dagster.yaml").read_bytes())
        return bool(said["run_launcher"]["class"] == _LAUNCHER)
    return False


def _submit(recipe_file: Path, options: BuildOptions) -> Client | None:
    """Submit the job to the server of a build, and return its client; None if there is no such server, or no use in it."""
    from bagassets.defs.runs.launching import executes_here  # noqa: PLC0415  (with Dagster; `make_first` does without)

    # With one processor, or for some assets only, the plan comes first.
    if options.jobs == 1 or options.select:
        return None
    if not executes_here(lambda: dagster_home(recipe_file, load_recipe(recipe_file))):
        return None
    client = find_server(recipe_file)
    if client is None:
        return None
    try:
        args = {"recipe": str(recipe_file), "bags": list(options.bags)}
        goes_on = any(job["function"] == _FIRST_JOB for job in client.status()["jobs"])
        client.submit(_MAP_JOB if goes_on else _JOB, args, label=f"ahead-{uuid4()}", grace_s=1.0)
    except (BagAssetsError, OSError) as err:  # it would only save time
        _LOG.info("nothing is made ahead: %s", err)
        client.close()
        return None
    return client


def _chosen(recipe: Recipe, bags: Collection[str], largest_bytes: int) -> list[RecordingFiles]:
    """Return recordings that are not too large in the order in which they are built: the largest first."""
    recordings = discover(recipe.bags).recordings
    chosen = choose_recordings(recordings, list(bags)) if bags else recordings.keys()
    found = [recordings[key] for key in recordings if key in chosen]
    return sorted((one for one in found if one.size <= largest_bytes), key=lambda one: -one.size)


def _make(
    assets: RecordingAssets, recording: RecordingFiles, known: Collection[str], whole_bytes: int
) -> None:
    """Make all of a recording, of a larger one its inventory; if that is known, nothing: what is left was tried before.

    Its run waits until this is done, as no two processes make the digest of a recording.

    Args:
        assets: the assets of recordings.
        recording: its files.
        known: the digests that were in the index when this job began.
        whole_bytes: size of the largest recording of which all is made.
    """
    state = assets.recipe.state
    try:
        stat = recording_stat(recording)
        with only_reader(assets.store, recording, stat), reading_left(state, recording):
            first = read_first(assets, recording, stat)
            # Of one that was built before, some may be made again: a build says that, once it has planned.
            files = (assets.index.row(path) for path, _ in stat_files(recording))
            is_known = any(row is not None and row.digest in known for row in files)
            if first.inventory is None and first.digest.hashed_bytes:
                return  # it is damaged: its run salvages it, and reports that
            is_new = first.inventory is not None and not first.inventory.cached
            if first.inventory is not None and is_new:
                note_made(state, first.inventory.action_digest)
            wanted = {INVENTORY.name} if is_known or recording.size > whole_bytes else None
            source, is_noted = (recording, first.digest.digest, stat.as_of(first.digest)), False
            for result in execute(Graph(assets, *source, wanted=wanted)):
                if isinstance(result, AssetResult) and not result.cached:
                    note_made(state, result.action_digest)
                    if not is_noted:
                        note_made(state, ahead_of_run(recording.key))
                    is_noted = True
                elif result.asset == INVENTORY.name and not is_new:
                    break
    except BagAssetsError as err:
        _LOG.info("%s: %s", recording.key, err)
