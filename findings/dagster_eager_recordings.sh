#!/usr/bin/env bash
# A project with recordings gets a further asset for each, whose automation condition is `eager()`, or `on_missing()` as it is to be made where
# it is missing; and a dataset of all of them, likewise. What is requested? Guess: the further asset for all recordings, since it is missing for
# all; the dataset once all that can be made is made, and again when a recording is removed.
# Seen with dagster 1.13.28 on 2026-11-29, by its own evaluation of conditions, which says nothing of what it does not request:
# - recordings that were there at the first tick: nothing, by either condition, at this tick and all later ones, until an input of theirs is
#   made again (`eager`). Only recordings that come afterwards count as missing
# - the dataset waits for the images of EVERY recording: one that cannot be made holds it back, whatever else changes; when that
#   recording is removed, it is requested
# - a recording that is in the dataset is removed: nothing
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dagster==1.13.28
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import logging

import dagster as dg

logging.disable(logging.CRITICAL)
RECORDINGS = dg.DynamicPartitionsDefinition(name="recordings")


@dg.asset(partitions_def=RECORDINGS)
def inventory() -> None: ...


@dg.asset(partitions_def=RECORDINGS, deps=[inventory], automation_condition=dg.AutomationCondition.eager())
def images() -> None: ...


@dg.asset(partitions_def=RECORDINGS, deps=[inventory], automation_condition=dg.AutomationCondition.on_missing())
def poses() -> None: ...


@dg.asset(deps=[images], automation_condition=dg.AutomationCondition.eager())
def dataset() -> None: ...


definitions = dg.Definitions([inventory, images, poses, dataset])
cursor = None


def tick():
    """Return what is requested: of each asset the recordings, and None for the dataset."""
    global cursor
    result = dg.evaluate_automation_conditions(definitions, instance, cursor=cursor)
    cursor = result.cursor
    requested = {name: list(result.get_requested_partitions(dg.AssetKey(name))) for name in ("images", "poses", "dataset")}
    return {name: keys for name, keys in requested.items() if keys}


def made(asset, *recordings):
    for recording in recordings or (None,):
        instance.report_runless_asset_event(dg.AssetMaterialization(asset, partition=recording))


with dg.DagsterInstance.ephemeral() as instance:
    instance.add_dynamic_partitions("recordings", ["a", "b"])
    made("inventory", "a", "b")
    seen = {"there before": [tick(), tick()]}
    made("inventory", "b")
    seen["inventory of b changes"] = [tick(), tick()]
    instance.add_dynamic_partitions("recordings", ["c"])
    made("inventory", "c")
    seen["c comes"] = [tick(), tick()]
    made("images", "a", "c")
    seen["images of b are missing"] = [tick()]
    made("images", "b")
    seen["images of b are made"] = [tick()]
    made("dataset")
    seen["dataset is made"] = [tick()]
    instance.add_dynamic_partitions("recordings", ["bad"])
    made("inventory", "bad")
    seen["bad comes"] = [tick()]
    made("images", "a")
    seen["images of a are made again"] = [tick(), tick()]
    instance.delete_dynamic_partition("recordings", "bad")
    seen["bad is removed"] = [tick()]
    made("dataset")
    tick()
    instance.delete_dynamic_partition("recordings", "b")
    seen["b is removed"] = [tick(), tick()]
for what, requested in seen.items():
    print(f"{what}: {requested}")
assert seen == {
    "there before": [{}, {}],
    "inventory of b changes": [{"images": ["b"]}, {}],
    "c comes": [{"images": ["c"], "poses": ["c"]}, {}],
    "images of b are missing": [{}],
    "images of b are made": [{"dataset": [None]}],
    "dataset is made": [{}],
    "bad comes": [{"images": ["bad"], "poses": ["bad"]}],
    "images of a are made again": [{}, {}],
    "bad is removed": [{"dataset": [None]}],
    "b is removed": [{}, {}],
}
PYTHON
