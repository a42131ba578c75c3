"""The sensor: notices new, changed and removed recordings, and requests runs.

A scan reads names, sizes and times only; hashing happens inside the run. A tick with nothing to do ends after one scan.
While something is about to happen (a recording is being written, a run is active), the tick scans twice a second for
some seconds, since Dagster's daemon starts a tick at most every five seconds: so a recording is taken up as soon as it
has settled, and the datasets as soon as the last run has ended.
"""

import time
from collections.abc import Iterable
from pathlib import Path

import dagster as dg

from bagassets.base.errors import RecordingError
from bagassets.defs.graph.sensor_cursor import Cursor
from bagassets.defs.graph.sensor_scan import Scan
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.projects import require_own_keys
from bagassets.defs.records.reporting import errors_explained
from bagassets.defs.records.workspace import Workspace

RECIPE, KEY_PREFIX = "bagassets/recipe", "bagassets/key_prefix"
"""Metadata of the sensor."""

# Less than the daemon's five seconds, or a tick that came a little early would be put off to the next one.
INTERVAL_S = 4
WATCH_S = 10.0
PAUSE_S = 0.5
_MOVING_TRIES = 2


def recordings_sensor(
    recipe_file: Path, names: Naming, assets: Iterable[dg.AssetsDefinition], batch_job: dg.JobDefinition
) -> dg.SensorDefinition:
    """Return the sensor; its metadata says which project is defined where it is, for `own_location`.

    Args:
        recipe_file: the recipe.
        names: of the project.
        assets: its assets.
        batch_job: the job of small recordings that share a run.
    """
    asset_job = dg.define_asset_job(
        names.assets_job,
        dg.AssetSelection.assets(*assets),
        # A run of ours is one process, whatever the executor of the code location: our workers are forked from a server.
        executor_def=dg.in_process_executor,
    )

    @dg.sensor(
        name=names.sensor,
        # The runs of large recordings and of datasets, and those that several small recordings share.
        jobs=[asset_job, batch_job],
        required_resource_keys={names.workspace},
        minimum_interval_seconds=INTERVAL_S,
        default_status=dg.DefaultSensorStatus.RUNNING,
        metadata={RECIPE: dg.MetadataValue.path(str(recipe_file)), KEY_PREFIX: "/".join(names.prefix)},
        description=(
            "Watches the folder of recordings: registers new recordings as partitions once they have settled, requests runs "
            "for stale ones, deletes the partitions of removed ones, and then requests a run for the datasets."
        ),
    )
    # Called directly, as in tests, a sensor is given its resources as parameters, too.
    def recordings(context: dg.SensorEvaluationContext, **_resources: object) -> dg.SensorResult:
        loaded = Workspace.of(context, names.workspace)
        # The recipe as it is now: that one was read when the code location was loaded.
        workspace = loaded.below(loaded.key_prefix)
        with errors_explained():
            require_own_keys(context.instance, names.prefix, Path(workspace.recipe_file))
            return _watch(Scan(workspace, Cursor.parse(context.cursor)))

    return recordings


def _watch(scan: Scan) -> dg.SensorResult:
    """Scan until there is something to request, or nothing to wait for."""
    begun = time.monotonic()
    end = begun + WATCH_S
    requests = _scan(scan)
    # With thousands of recordings a scan takes its time; then scan less often.
    pause_s = max(PAUSE_S, 3 * (time.monotonic() - begun))
    while not requests and time.monotonic() < end and scan.is_worth_waiting(time.time() + WATCH_S):
        time.sleep(pause_s)
        requests = _scan(scan)
    skip = dg.SkipReason(scan.cursor.said) if not requests else None
    return dg.SensorResult(run_requests=requests, skip_reason=skip, cursor=scan.cursor.text())


def _scan(scan: Scan) -> list[dg.RunRequest]:
    """Scan; repeat if a recording was removed or replaced meanwhile."""
    for _ in range(_MOVING_TRIES):
        try:
            return scan.scan(time.time())
        except RecordingError:
            time.sleep(PAUSE_S)
    return scan.scan(time.time())
