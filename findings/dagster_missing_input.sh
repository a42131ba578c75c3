#!/usr/bin/env bash
# What does Dagster record of an input whose partition was never materialized?
# Guess: the version INITIAL and the pointer NULL, as for an input that nothing was ever made of.
# Seen with dagster 1.13.27 on 2026-11-28:
#   so it is as long as no partition of the input exists. Once another partition of it was made, the version is the SHA-256 of nothing
#   (e3b0c442…), the same for all partitions that are missing, and the pointer is that of the OTHER partition's materialization:
#   the provenance of partition a leads to an event of partition b.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dagster==1.13.27
"$folder/venv/bin/python" - <<'PYTHON'
import hashlib
import logging

import dagster as dg

logging.disable(logging.CRITICAL)
DRIVES = dg.StaticPartitionsDefinition(["a", "b"])


@dg.asset(partitions_def=DRIVES)
def poses():
    return dg.MaterializeResult(data_version=dg.DataVersion("1"))


@dg.asset(partitions_def=DRIVES, deps=[poses])
def scenes():
    return dg.MaterializeResult(data_version=dg.DataVersion("1"))


def make(asset, drive):
    """Materialize an asset of a drive; return its record."""
    assert dg.materialize([poses, scenes], selection=[asset], partition_key=drive, instance=instance).success
    (record,) = instance.fetch_materializations(
        dg.AssetRecordsFilter(asset_key=asset.key, asset_partitions=[drive]), limit=1
    ).records
    return record


def input_of(record):
    tags = record.asset_materialization.tags
    return tags["dagster/input_data_version/poses"], tags["dagster/input_event_pointer/poses"]


with dg.instance_for_test() as instance:
    before = input_of(make(scenes, "a"))
    of_b = make(poses, "b")
    after = input_of(make(scenes, "a"))

print("no partition of poses exists:      ", *before)
print("poses of b exist, those of a do not:", *after, "which is the event of b:", of_b.storage_id)
assert before == ("INITIAL", "NULL")
assert after == (hashlib.sha256(b"").hexdigest(), str(of_b.storage_id))
PYTHON
