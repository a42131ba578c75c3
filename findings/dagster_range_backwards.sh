#!/usr/bin/env bash
# Which dynamic partitions does `dagster asset materialize --partition-range` make, and in which order do they lie?
# Guess: names from one to the other as they sort, or an error. Seen with dagster 1.13.28 on 2026-11-28: order is that in which they
# were added. Against it, as in 2026-01...2026-03 here, since 2026-01 came last, the body runs with no partition at all, nothing is
# made, and the exit status is 0. A partition that is deleted and added again goes to the end, so a range can turn overnight.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dagster==1.13.28
cd "$folder"
mkdir home
printf 'telemetry:\n  enabled: false\n' >home/dagster.yaml
export DAGSTER_HOME="$folder/home" PATH="$folder/venv/bin:$PATH"
cat >drives.py <<'PYTHON'
from pathlib import Path

import dagster as dg


@dg.asset(partitions_def=dg.DynamicPartitionsDefinition(name="drives"), backfill_policy=dg.BackfillPolicy.single_run())
def images(context) -> dg.MaterializeResult:
    Path("made").write_text(" ".join(context.partition_keys))
    return dg.MaterializeResult()


defs = dg.Definitions([images])
PYTHON
cat >check.py <<'PYTHON'
import logging
import subprocess
from pathlib import Path

import dagster as dg

logging.disable(logging.CRITICAL)


def made(first, last):
    """Return the exit status, the partitions that the body was given, and those in the event log."""
    Path("made").unlink(missing_ok=True)
    instance.wipe_assets([dg.AssetKey("images")])
    command = ["dagster", "asset", "materialize", "-f", "drives.py", "--select", "images"]
    run = subprocess.run([*command, "--partition-range", f"{first}...{last}"], capture_output=True, check=False)
    logged = instance.get_materialized_partitions(dg.AssetKey("images"))
    print(f"{first}...{last}: exit status {run.returncode}, made: {Path('made').read_text() or 'nothing'}")
    return run.returncode, Path("made").read_text().split(), sorted(logged)


with dg.DagsterInstance.get() as instance:
    keys = ["2026-02", "2026-03", "2026-01"]
    for key in keys:
        instance.add_dynamic_partitions("drives", [key])
    assert list(instance.get_dynamic_partitions("drives")) == keys
    assert made("2026-02", "2026-01") == (0, keys, sorted(keys))
    assert made("2026-01", "2026-03") == (0, [], [])
    instance.delete_dynamic_partition("drives", "2026-02")
    instance.add_dynamic_partitions("drives", ["2026-02"])
    assert made("2026-02", "2026-03") == (0, [], [])
PYTHON
python check.py 2>errors || { cat errors; exit 1; }
