#!/usr/bin/env bash
# How often may the result of an asset check of a partition be reported without a run (`report_runless_asset_event`)?
# Guess: as often as one likes, each time a further evaluation, as for materializations and for checks without partitions.
# Seen with dagster 1.13.28 and SQLite on 2026-11-28: once for each partition. The second is an IntegrityError of the database, since
# (asset, check, run id, partition) must be unique and all that have no run share one id; without a partition, NULL is never equal to NULL.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dagster==1.13.28
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import logging

import dagster as dg
from sqlalchemy.exc import IntegrityError

logging.disable(logging.CRITICAL)


def accepted(partition):
    """Report three results; return how many of them are on record."""
    for passed in (False, False, True):
        result = dg.AssetCheckEvaluation(
            asset_key=dg.AssetKey("images"), check_name="sharp", passed=passed, partition=partition
        )
        try:
            instance.report_runless_asset_event(result)
        except IntegrityError as error:
            print(f"partition {partition}: {str(error).splitlines()[0]}")
    key = dg.AssetCheckKey(dg.AssetKey("images"), "sharp")
    return len(instance.event_log_storage.get_asset_check_execution_history(key, limit=10))


with dg.instance_for_test() as instance:
    plain = accepted(None)
with dg.instance_for_test() as instance:
    partitioned = accepted("drive")
print(f"of three results: {plain} without a partition, {partitioned} of a partition")
assert (plain, partitioned) == (3, 1)
PYTHON
