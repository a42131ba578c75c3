#!/usr/bin/env bash
# What does Dagster's web UI say of a partition once the run that made it, or that failed on it, has been deleted?
# Guess: it was never materialized, as the event log then says. Seen with dagster 1.13.28 and SQLite on 2026-11-28: the events go
# with the run, and `get_materialized_partitions` knows none any more; but what the web UI counts is a cache that stays: the one is
# materialized, the other failed. What the next run makes is not counted, either: SQLite gives its events the numbers of those deleted,
# and the cache reads on behind them. Only `dagster asset wipe-partitions-status-cache`, or wiping the asset, mends that.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dagster==1.13.28 dagster-graphql==1.13.28
cd "$folder"
mkdir home
printf 'telemetry:\n  enabled: false\n' >home/dagster.yaml
export DAGSTER_HOME="$folder/home" PATH="$folder/venv/bin:$PATH"
cat >drives.py <<'PYTHON'
import dagster as dg


@dg.asset(partitions_def=dg.StaticPartitionsDefinition(["good", "bad", "later"]))
def images(context):
    if context.partition_key == "bad":
        raise ValueError("no camera")


defs = dg.Definitions([images])
PYTHON
cat >check.py <<'PYTHON'
import json
import logging
import subprocess
from pathlib import Path

import dagster as dg
import drives

logging.disable(logging.CRITICAL)
KEY = drives.images.key
QUERY = """{assetNodes(assetKeys: [{path: ["images"]}]) {assetPartitionStatuses {
  ... on DefaultPartitionStatuses {materializedPartitions failedPartitions}}}}"""


def make(partition):
    dg.materialize([drives.images], partition_key=partition, instance=instance, raise_on_error=False)


def shall_be(when, materialized, failed, events):
    """Compare what the web UI is told, and what the event log has, with what was seen."""
    command = ["dagster-graphql", "-f", "drives.py", "-t", QUERY, "-o", "answer.json"]
    subprocess.run(command, check=True, capture_output=True)
    shown = json.loads(Path("answer.json").read_text())["data"]["assetNodes"][0]["assetPartitionStatuses"]
    logged = sorted(instance.get_materialized_partitions(KEY))
    print(f"{when}: {shown}; in the event log: {logged}")
    assert shown == {"materializedPartitions": materialized, "failedPartitions": failed}
    assert logged == events


with dg.DagsterInstance.get() as instance:
    make("good")
    make("bad")
    shall_be("two runs", ["good"], ["bad"], ["good"])
    for run in instance.get_runs():
        instance.delete_run(run.run_id)
    shall_be("both deleted", ["good"], ["bad"], [])
    make("later")
    shall_be("another run", ["good"], ["bad"], ["later"])
    wipe = ["dagster", "asset", "wipe-partitions-status-cache", "--noprompt", "images"]
    subprocess.run(wipe, check=True, capture_output=True)
    shall_be("cache wiped", ["later"], [], ["later"])
PYTHON
python check.py 2>errors || { cat errors; exit 1; }
