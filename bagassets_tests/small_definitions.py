"""A code location of small assets for the tests of runs and of the launcher.

What an asset does is steered by files in the folder that the variable SMALL_DEFINITIONS names.
"""

import os
import signal
import time
from pathlib import Path

import dagster as dg

from bagassets.base.errors import RecordingError

recordings = dg.DynamicPartitionsDefinition(name="recordings")


def steering(name):
    return Path(os.environ["SMALL_DEFINITIONS"]) / name


def write_down(name, text):
    with steering(name).open("a", encoding="utf-8") as file:
        file.write(f"{text}\n")


@dg.asset(partitions_def=recordings, code_version="1")
def first(context: dg.AssetExecutionContext):
    """Writes down its spans, and waits while a file `hold` is there."""
    write_down("spans", f"begin {context.partition_key} {context.run.run_id}")
    while steering("hold").exists():
        time.sleep(0.02)
    print("printed by first")
    write_down("spans", f"end {context.partition_key} {context.run.run_id}")
    return dg.MaterializeResult(data_version=dg.DataVersion("one"))


@dg.asset(partitions_def=recordings, deps=[first], code_version="1")
def second():
    return dg.MaterializeResult(data_version=dg.DataVersion("two"))


@dg.asset_check(asset=second)
def second_is_good():
    return dg.AssetCheckResult(passed=True)


@dg.asset(partitions_def=recordings)
def broken():
    """Fails as the library does: its own error, raised from a lower one."""
    try:
        Path("/no/such/file").read_bytes()
    except OSError as err:
        raise RecordingError("drive.bag: the recording is truncated; copy it again.") from err


@dg.asset(partitions_def=recordings, retry_policy=dg.RetryPolicy(max_retries=5))
def patient():
    """Sleeps, and would be retried."""
    write_down("attempts", "attempt")
    time.sleep(600)


@dg.asset(partitions_def=recordings)
def stubborn():
    """Lets no SIGTERM through."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    write_down("attempts", "attempt")
    time.sleep(600)


@dg.asset(partitions_def=recordings, retry_policy=dg.RetryPolicy(max_retries=2))
def signalled(context: dg.AssetExecutionContext):
    """Interrupts itself; marked CANCELING before if the file `mark` is there."""
    write_down("attempts", "attempt")
    if steering("mark").exists():
        context.instance.report_run_canceling(context.run)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(600)


@dg.asset
def whole():
    return dg.MaterializeResult(data_version=dg.DataVersion("whole"))


defs = dg.Definitions(
    assets=[first, second, broken, patient, stubborn, signalled, whole],
    asset_checks=[second_is_good],
    executor=dg.in_process_executor,
)
