"""The sensor: notices new, changed and removed recordings, and asks for runs.

A look takes names, sizes and times only; hashing happens inside the run. When there is nothing
to do, a tick is over after one look. While something is about to happen (a recording that is being
written, a run that is at work), it looks twice a second for some seconds, since Dagster's daemon
starts a tick every five seconds at most: so a recording is taken up as soon as it has settled, and the
dataset as soon as the last run has ended.
"""

import time

import dagster as dg

from bagassets.defs.reporting import failures_in_words
from bagassets.defs.sensor_cursor import Cursor
from bagassets.defs.sensor_look import Look
from bagassets.defs.workspace import Workspace
from bagassets.errors import RecordingError

__all__ = ["recordings_sensor"]

# Less than the daemon's five seconds, or a tick that came a little early would wait for the one after.
INTERVAL_S = 4
WATCH_S = 10.0
PAUSE_S = 0.5
_MOVING_TRIES = 2


def recordings_sensor() -> dg.SensorDefinition:
    """Return the sensor; the recipe it works for is its workspace's."""

    @dg.sensor(
        name="recordings",
        target=dg.AssetSelection.all(),
        minimum_interval_seconds=INTERVAL_S,
        default_status=dg.DefaultSensorStatus.RUNNING,
        description=(
            "Watches the folder of recordings: registers new ones as partitions once they have settled, has stale ones "
            "built, drops removed ones, and then has the dataset updated."
        ),
    )
    def recordings(context: dg.SensorEvaluationContext, workspace: Workspace) -> dg.SensorResult:
        # The recipe as it is now: the one in `workspace` was read when the code location was loaded.
        workspace = Workspace(recipe_file=workspace.recipe_file)
        with failures_in_words():
            return _watch(Look(context.instance, workspace, Cursor.parse(context.cursor)))

    return recordings


def _watch(look: Look) -> dg.SensorResult:
    """Look until there is something to ask for, or nothing to wait for."""
    begun = time.monotonic()
    end = begun + WATCH_S
    requests = _look(look)
    # With thousands of recordings a look takes its time; then look less often.
    pause_s = max(PAUSE_S, 3 * (time.monotonic() - begun))
    while not requests and time.monotonic() < end and look.is_worth_waiting(time.time() + WATCH_S):
        time.sleep(pause_s)
        requests = _look(look)
    skip = dg.SkipReason(look.cursor.said) if not requests else None
    return dg.SensorResult(run_requests=requests, skip_reason=skip, cursor=look.cursor.text())


def _look(look: Look) -> list[dg.RunRequest]:
    """Look; again if a recording went, or was exchanged, while that was done."""
    for _ in range(_MOVING_TRIES):
        try:
            return look.look(time.time())
        except RecordingError:
            time.sleep(PAUSE_S)
    return look.look(time.time())
