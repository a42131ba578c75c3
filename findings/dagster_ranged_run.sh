#!/usr/bin/env bash
# A run about a range of partitions (BackfillPolicy.multi_run) records some itself, yields no output, and fails for one: which
# partitions are red, what becomes of the next step, and what do the checks show of a partition that had nothing to check?
# Guess: the whole range is red, as its step failed. Seen with dagster 1.13.28 on 2026-11-28: only the partition without a
# materialization in the run is red, and if none failed the run is green and the steps that read what was not yielded are skipped.
# But checks are planned for every partition of the range, and what is left planned in a run that failed is shown as failed
# (EXECUTION_FAILED), also of a partition that was made and had nothing to check.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dagster==1.13.28
cd "$folder"
cat >check.py <<'PYTHON'
import logging

import dagster as dg
from dagster._core.event_api import PartitionKeyFilter
from dagster._core.storage.partition_status_cache import get_and_update_asset_status_cache_value

logging.disable(logging.CRITICAL)
drives = dg.DynamicPartitionsDefinition(name="drives")
images, tables = dg.AssetKey("images"), dg.AssetKey("tables")
fails: set[str] = set()


@dg.multi_asset(
    specs=[dg.AssetSpec("images", skippable=True)],
    partitions_def=drives,
    backfill_policy=dg.BackfillPolicy.multi_run(10),
)
def make(context):
    for key in context.partition_keys:
        if key not in fails:
            context.log_event(dg.AssetMaterialization("images", partition=key))
    if fails:
        raise dg.Failure("some failed", allow_retries=False)
    return
    yield


@dg.multi_asset_check(specs=[dg.AssetCheckSpec("sharp", asset="images", partitions_def=drives)], can_subset=True)
def checks():
    return
    yield


@dg.asset(deps=["images"], partitions_def=drives, backfill_policy=dg.BackfillPolicy.multi_run(10), name="tables")
def more():
    return None


def run(instance):
    """Make all; return the status, the partitions that are made and those that are red, and the states of the checks."""
    ends = {"dagster/asset_partition_range_start": "a", "dagster/asset_partition_range_end": "c"}
    job = dg.Definitions([make, more], asset_checks=[checks]).resolve_implicit_global_asset_job_def()
    done = job.execute_in_process(instance=instance, tags=ends, raise_on_error=False)
    value = get_and_update_asset_status_cache_value(instance, images, drives, dynamic_partitions_loader=instance)
    made = sorted(value.deserialize_materialized_partition_subsets(drives).get_partition_keys())
    red = sorted(value.deserialize_failed_partition_subsets(drives).get_partition_keys())
    key = dg.AssetCheckKey(images, "sharp")
    latest = [
        instance.event_log_storage.get_latest_asset_check_execution_by_key([key], PartitionKeyFilter(key=part)).get(key)
        for part in "abc"
    ]
    planned = [one is not None and one.run_id == done.run_id and one.status.value for one in latest]
    skipped = [event.step_key for event in done.all_events if event.event_type == dg.DagsterEventType.STEP_SKIPPED]
    print(f"success: {done.success}; made: {made}; red: {red}; skipped steps: {skipped}; checks: {planned}")
    return done.success, made, red, skipped, planned, instance.get_materialized_partitions(tables)


with dg.DagsterInstance.ephemeral() as instance:
    instance.add_dynamic_partitions("drives", ["a", "b", "c"])
    fails.add("b")
    assert run(instance) == (False, ["a", "c"], ["b"], [], ["PLANNED"] * 3, set())
    fails.clear()
    assert run(instance) == (True, ["a", "b", "c"], [], ["checks", "tables"], ["PLANNED"] * 3, set())
PYTHON
"$folder/venv/bin/python" check.py 2>errors || { cat errors; exit 1; }
