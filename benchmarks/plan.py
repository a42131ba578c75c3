"""What it costs to decide that thousands of recordings are fresh.

Registers sparse recordings with made-up artifacts and records (10 assets each; without checks, which would read the
artifacts), then times commands from cold, each in a process of its own::

    python benchmarks/plan.py [--recordings 10000] [--json FILE] [--folder DIR]

It also times what one recording costs when the memory of the last plan is lost, on a real drive.
"""

import argparse
import json
import os
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import dagster as dg  # noqa: TID251  (records are made up here)

sys.path.insert(0, str(Path(__file__).parents[1]))

from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.records.events import Records, all_assets, event_database
from bagassets.defs.records.instance_plan import plan_instance, workspace_fingerprint
from bagassets.defs.records.partitions import add_partitions
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.freshness.artifacts import note_of
from bagassets.engine.freshness.plan_cache import CachedPlan, PlanCache, recording_fingerprint
from bagassets.engine.freshness.published import Publication
from bagassets.engine.plan import AssetState, BagPlan
from bagassets.engine.planner import plan_recording, recorded_graph
from bagassets.formats.after_crash import noted_build
from bagassets.formats.catalogue import recording_assets
from bagassets.formats.dataset_build import (
    dataset_code_versions,
    dataset_folders,
    datasets_of,
    select_inputs,
)
from bagassets.formats.dataset_lock import LOCK
from bagassets.propose.project import write_project
from bagassets.recipe.model import Recipe
from bagassets.store.canonical import digest_bytes
from benchmarks.common import machine, markdown

RECIPE = """
name: many
bags: {root: bags}
nuscenes: {}
vision: {}
preview: {trajectory_map: false}
checks: {enabled: false}
rigs:
  - name: car
    ego_pose: {source: odometry, topic: /odom}
    channels:
      CAM_FRONT: {modality: camera, topic: /cam/image_raw}
      LIDAR_TOP: {modality: lidar, topic: /points}
"""
ROOT = Path(__file__).parents[1]
SIZE = 1_000_000
TIMES = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--recordings", type=int, default=10_000)
    parser.add_argument("--folder", type=Path, help="where to work; default: a temporary folder")
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder, ignore_cleanup_errors=True) as folder:
        recipe = Path(folder) / "project" / "recipe.yaml"
        prepare(recipe, options.recordings)
        figures: dict[str, Any] = {"recordings": options.recordings, "assets": 10}
        dry = ["build", "--dry-run", "--json", "--recipe", str(recipe)]
        figures["plan_cold_s"] = [timed(dry, '"settled": true') for _ in range(3)]
        build = ["build", "--recipe", str(recipe)]
        figures["build_full_s"] = timed(build, "fresh in")
        figures["build_nothing_to_do_s"] = [timed(build, "nothing to do") for _ in range(TIMES)]
        figures["walk_per_recording_s"] = walk(Path(folder) / "real" / "recipe.yaml")
    print(plan_table(figures))
    if options.json is not None:
        options.json.write_text(json.dumps({"machine": machine(), **figures}, indent=1) + "\n", "utf-8")


def plan_table(found: dict[str, Any]) -> str:
    """Return the table of `plan.json`: medians."""
    times = {
        "nothing to do": found["build_nothing_to_do_s"],
        "the plan, from a cold command (`build --dry-run`)": found["plan_cold_s"],
        "a build that examines all of it and finds everything fresh": [found["build_full_s"]],
        "of that, when nothing is remembered, for each recording": [found["walk_per_recording_s"]],
    }
    rows = [[name, f"{statistics.median(seconds):.4g} s"] for name, seconds in times.items()]
    return markdown(["", f"{found['recordings']:,} recordings of {found['assets']} assets"], rows)


def timed(arguments: list[str], expected: str) -> float:
    """Return the wall time of a command, in seconds; it must print what is expected."""
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "bagassets", *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    seconds = time.perf_counter() - began
    if done.returncode or expected not in done.stdout:
        sys.exit(f"{arguments} ended with {done.returncode}:\n{done.stdout[-1000:]}\n{done.stderr[-2000:]}")
    return seconds


def prepare(recipe_file: Path, number: int) -> None:
    """Make a project of sparse recordings that are all fresh."""
    write_project(recipe_file.parent, RECIPE)
    bags = recipe_file.parent / "bags"
    bags.mkdir()
    for index in range(number):
        with (bags / f"r{index:06}.bag").open("wb") as stream:
            stream.truncate(SIZE)
    with open_project(recipe_file) as workspace:
        instance = workspace.instance
        recipe = workspace.recipe
        recordings = workspace.discover().recordings
        add_partitions(workspace.records, list(recordings))
        with noted_build(recipe, recipe_file):
            pass  # a build has ended well: the next one need not read the artifacts, which hold nothing
        assets = ("bag", *recording_assets(recipe).names)
        record(instance, assets, list(recordings))
        names = workspace.names
        ids, project = (
            Records(instance, names).latest_ids(all_assets()),
            str(workspace_fingerprint(workspace)),
        )
        remembered = {}
        for key, recording in recordings.items():
            states = {}
            for asset in assets:
                digest = digest_bytes(f"{key} {asset}".encode())
                if asset != "bag":
                    artifact(recipe.store_path, digest)
                states[asset] = AssetState("fresh", "up to date", digest)
            channels = tuple(digest_bytes(f"{key} channel {n}".encode()) for n in range(2))
            for digest in channels:
                artifact(recipe.store_path, digest)
            recorded = {asset: str(state.data_version) for asset, state in states.items()}
            plan = BagPlan(key, states, "ros1", recorded, channels)
            records = {asset: ids[asset][key] for asset in assets}
            mark = recording_fingerprint(project, recording.relative, recording.files, (), records)
            made = note_of(f"{recipe.store_path}/artifacts", plan.artifacts)
            remembered[key] = CachedPlan(mark, made, plan.as_row())
        PlanCache(recipe.state, recipe.store_path / "artifacts").save(remembered, [])
        datasets(instance, workspace)


def artifact(store: Path, digest: str) -> None:
    """Make an artifact of one file, of which only the names matter here."""
    folder = f"{store}/artifacts/{digest[:2]}/{digest}"
    os.makedirs(f"{folder}/files")  # noqa: PTH103  (a hundred thousand times)
    for name in ("manifest.json", "files/index.parquet"):
        os.close(os.open(f"{folder}/{name}", os.O_CREAT | os.O_WRONLY))


def record(instance: dg.DagsterInstance, assets: tuple[str, ...], keys: list[str]) -> None:
    """Record a materialization of every asset of every recording: one by Dagster, copies of it by SQL."""
    for asset in assets:
        instance.report_runless_asset_event(
            dg.AssetMaterialization(
                asset, partition=keys[0], tags={"dagster/data_version": "0" * 64, "dagster/code_version": "1"}
            )
        )
    with sqlite3.connect(str(event_database(instance))) as connection:
        columns = "run_id, event, dagster_event_type, timestamp, step_key, asset_key, partition"
        rows = connection.execute(
            f"SELECT {columns} FROM event_logs WHERE dagster_event_type = 'ASSET_MATERIALIZATION'"
        ).fetchall()
        for row in rows:
            copies = ([*row[:1], row[1].replace(keys[0], key), *row[2:6], key] for key in keys[1:])
            connection.executemany(f"INSERT INTO event_logs ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?)", copies)


def datasets(instance: dg.DagsterInstance, workspace: Workspace) -> None:
    """Make datasets on disk of which only the lock files matter, and record them."""
    recipe = workspace.recipe
    inputs = select_inputs(plan_instance(workspace.on(instance)))
    if len(inputs.parts["nuscenes"]) != len(workspace.discover().recordings):
        sys.exit("the benchmark is out of date: the plan does not take its recordings for fresh")
    folder = datasets_of(recipe)["nuscenes_dataset"].folder
    for name in ("samples", "sweeps", "maps", folder.name):
        folder.with_name(name).mkdir(parents=True)
    publish(
        recipe,
        "nuscenes_dataset",
        f"{folder.name}/{LOCK}",
        '{"format": 2, "dataset": "nuscenes", "nuscenes": {}, "bags": [], "duplicates": {}, "files": {}, "shares": {}}',
    )
    publish(
        recipe,
        "vision_dataset",
        f"annotations/{LOCK}",
        '{"format": 2, "dataset": "vision", "vision": {}, "bags": [], "files": {}}',
    )
    for asset, version in dataset_code_versions(recipe).items():
        instance.report_runless_asset_event(
            dg.AssetMaterialization(
                asset,
                tags={
                    "dagster/data_version": "1",
                    "dagster/code_version": version,
                    "dagster/input_data_version/dataset_inputs": inputs.digest,
                },
            )
        )


def publish(recipe: Recipe, asset: str, name: str, content: str) -> None:
    """Write the only file of a dataset, and record it as published."""
    output = dataset_folders(recipe)[asset]
    (output / name).parent.mkdir(parents=True, exist_ok=True)
    (output / name).write_text(content, "utf-8")
    time.sleep(0.05)  # times of files that are too new are not trusted
    Publication(recipe.state, asset).write(output, {name: digest_bytes(content.encode())}, {}, None)


def walk(recipe_file: Path) -> float:
    """Return what looking into one recording costs, in seconds: a fresh one of a real project."""
    from bagassets_tests.small_drive import write_drive

    for number in range(4):
        write_drive(recipe_file.parent / "bags" / f"{number}.bag", "ros1", duration_s=2.0 + number)
    write_project(recipe_file.parent, RECIPE)
    timed(["build", "--recipe", str(recipe_file)], "built in")
    with open_project(recipe_file) as workspace:
        recordings, records = workspace.discover().recordings, workspace.records
        recorded = records.fetch(records.latest_ids(all_assets()), recordings)

        def plan(key: str) -> BagPlan:
            return plan_recording(recorded_graph(workspace.assets, recordings[key], recorded[key]))

        if not all(plan(key).settled for key in recordings):
            sys.exit("the recordings should be fresh after a build")
        began = time.perf_counter()
        for _ in range(TIMES):
            for key in recordings:
                plan(key)
        return (time.perf_counter() - began) / TIMES / len(recordings)


if __name__ == "__main__":
    main()
