#!/usr/bin/env bash
# An asset `dataset` reads all partitions of `images`, one for each recording. When does Dagster mark it as stale, in the web UI and for all
# that asks it? Guess: whenever it would be another if it were made anew. Seen with dagster 1.13.28 on 2026-11-29:
# - a recording changes: with 99 of them it is stale, with 100 it is not, whatever changes. What is recorded as the version of its input is
#   then that of the one recording that came last.
# - a recording is removed: not stale, though the dataset has it; nor where all its inputs were wiped
# - a recording is added: not stale before its images are made, stale afterwards
# No event, log or page says of an asset that it is not looked at.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dagster==1.13.28
cd "$folder"
venv/bin/python - <<'PYTHON'
import logging

import dagster as dg
from dagster._core.definitions.data_version import CachingStaleStatusResolver
from dagster._core.loader import LoadingContextForTest

logging.disable(logging.CRITICAL)
IMAGES, DATASET = dg.AssetKey("images"), dg.AssetKey("dataset")


@dg.asset(partitions_def=dg.DynamicPartitionsDefinition(name="recordings"), code_version="1")
def images() -> None: ...


@dg.asset(deps=[images])
def dataset() -> None: ...


GRAPH = dg.Definitions([images, dataset]).get_repository_def().asset_graph


def made(recording, version):
    """Record that the images of a recording were made, with the version that they have."""
    tags = {"dagster/data_version": version}
    instance.report_runless_asset_event(dg.AssetMaterialization("images", partition=recording, tags=tags))


def built(recordings):
    """Make images of all recordings, and the dataset; return the version of its input that Dagster keeps."""
    instance.add_dynamic_partitions("recordings", recordings)
    for recording in recordings:
        made(recording, f"{recording}, first")
    dg.materialize([images, dataset], selection=[dataset], instance=instance)
    event = instance.get_latest_materialization_event(DATASET)
    return event.asset_materialization.tags["dagster/input_data_version/images"]


def status():
    return CachingStaleStatusResolver(instance, GRAPH, loading_context=LoadingContextForTest(instance)).get_status(DATASET).value


for count in (99, 100):
    with dg.DagsterInstance.ephemeral() as instance:
        recordings = [f"drive_{number:03}" for number in range(count)]
        version = built(recordings)
        assert status() == "FRESH"
        made("drive_007", "drive_007, second")
        print(f"one of {count} has changed: {status()}; version of the input: {version}")
        assert status() == ("STALE" if count == 99 else "FRESH")
        assert (version == "drive_099, first") == (count == 100)

with dg.DagsterInstance.ephemeral() as instance:
    built(["a", "b", "c"])
    instance.delete_dynamic_partition("recordings", "b")
    removed = status()
    instance.add_dynamic_partitions("recordings", ["d"])
    added = status()
    made("d", "d, first")
    with_images = status()
    dg.materialize([images, dataset], selection=[dataset], instance=instance)
    instance.wipe_assets([IMAGES])
    print(f"removed: {removed}; added: {added}, with its images: {with_images}; all inputs wiped: {status()}")
    assert (removed, added, with_images, status()) == ("FRESH", "FRESH", "STALE", "FRESH")
PYTHON
