#!/usr/bin/env bash
# A partition fails in a backfill; while that still runs, a sensor's run makes the partition. What becomes of the backfill?
# Guess: it takes the partition as made, as the asset does, and goes on to what is downstream. Seen with dagster 1.13.28 on 2026-11-28:
# the asset has 3 of 3 partitions, none failed; the backfill has 2 made, 1 failed, ends as COMPLETED_FAILED, and never requests the
# unpartitioned asset downstream, although all that it needs is there. To a backfill only runs with its own tag count.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dagster==1.13.28 dagster-webserver==1.13.28
cd "$folder"
mkdir home
printf 'telemetry:\n  enabled: false\n' >home/dagster.yaml
export DAGSTER_HOME="$folder/home" PATH="$folder/venv/bin:$PATH"
cat >drives.py <<'PYTHON'
import time
from pathlib import Path

import dagster as dg

repaired = Path(__file__).parent / "repaired"


@dg.asset(partitions_def=dg.StaticPartitionsDefinition(["good", "slow", "bad"]))
def images(context):
    of_backfill = "dagster/backfill" in context.run.tags
    if context.partition_key == "bad" and of_backfill:
        raise ValueError("no camera")
    while context.partition_key == "slow" and not repaired.exists():
        time.sleep(1)


@dg.asset(deps=[images])
def dataset():
    pass


repair = dg.define_asset_job("repair", [images])


@dg.sensor(job=repair, minimum_interval_seconds=2, default_status=dg.DefaultSensorStatus.RUNNING)
def again(context):
    failed = dg.RunsFilter(statuses=[dg.DagsterRunStatus.FAILURE])
    if context.instance.get_runs(failed):
        return dg.RunRequest(run_key="again", partition_key="bad")
    return dg.SkipReason("nothing failed")


defs = dg.Definitions([images, dataset], jobs=[repair], sensors=[again])
PYTHON
cat >follow.py <<'PYTHON'
import json
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

PORT = 3947
COUNTS = """{
  assetNodes(assetKeys: [{path: ["images"]}, {path: ["dataset"]}]) {
    assetKey {path} partitionStats {numMaterialized numFailed} assetMaterializations(limit: 1) {runId}}
  partitionBackfillsOrError {... on PartitionBackfills {results {
    status assetBackfillData {assetBackfillStatuses {... on AssetPartitionsStatusCounts {
      numPartitionsMaterialized numPartitionsFailed}}}}}}}"""
LAUNCH = """mutation($what: LaunchBackfillParams!) {launchPartitionBackfill(backfillParams: $what) {__typename}}"""


def ask(query, **variables):
    body = json.dumps({"query": query, "variables": variables}).encode()
    request = urllib.request.Request(f"http://127.0.0.1:{PORT}/graphql", body, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request) as answer:
        return json.load(answer)["data"]


def wait(what, seconds, answer):
    for _ in range(seconds):
        try:
            if found := answer():
                return found
        except OSError:  # not up yet
            pass
        time.sleep(1)
    raise SystemExit(f"waited in vain for {what}")


def assets(data):
    return {node["assetKey"]["path"][0]: node for node in data["assetNodes"]}


def repaired():
    """Tell whether the partition that failed has been made, while the backfill waits for the slow one."""
    return assets(ask(COUNTS))["images"]["partitionStats"] == {"numMaterialized": 2, "numFailed": 0}


def ended():
    """Return the backfill if it is over, with the counts of the asset and what is downstream."""
    data = ask(COUNTS)
    (backfill,) = data["partitionBackfillsOrError"]["results"]
    if backfill["status"] in ("REQUESTED", "CANCELING"):
        return None
    counts = next(filter(None, backfill["assetBackfillData"]["assetBackfillStatuses"]))
    made = assets(data)
    return backfill["status"], counts, made["images"]["partitionStats"], made["dataset"]["assetMaterializations"]


log = Path("log").open("wb")
server = subprocess.Popen(["dagster", "dev", "-f", "drives.py", "-p", str(PORT)], stdout=log, stderr=log)
try:
    wait("the web UI", 60, lambda: ask("{version}"))
    what = {"assetSelection": [{"path": ["images"]}, {"path": ["dataset"]}], "partitionNames": ["good", "slow", "bad"]}
    assert ask(LAUNCH, what=what)["launchPartitionBackfill"]["__typename"] == "LaunchBackfillSuccess"
    wait("the sensor's run", 180, repaired)
    Path("repaired").touch()
    status, counts, images, dataset = wait("the end of the backfill", 180, ended)
finally:
    server.terminate()
    server.wait(60)
print("backfill:", status, counts)
print("asset:", images, " downstream:", dataset)
assert (status, images) == ("COMPLETED_FAILED", {"numMaterialized": 3, "numFailed": 0})
assert counts == {"numPartitionsMaterialized": 2, "numPartitionsFailed": 1}
assert dataset == []
PYTHON
python follow.py || { tail -20 log; exit 1; }
