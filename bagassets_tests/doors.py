"""A folder with every kind of recording, and what is compared of it once it was built, by whichever door."""

import shutil

from dagster._core.storage.partition_status_cache import get_and_update_asset_status_cache_value

from bagassets.defs.builds.pending_work import find_pending_work, open_project
from bagassets.defs.graph.location import build_definitions
from bagassets.defs.records.events import Records
from bagassets.defs.records.naming import Naming
from bagassets.engine.build_report import BuildOptions
from bagassets.propose.project import write_project
from bagassets_tests.in_process import QUICK
from bagassets_tests.series import write_parts
from bagassets_tests.small_drive import write_drive

GOOD, TWIN, SERIES, SHORT, TORN, LOST = "a.bag", "b.bag", "drive.bag", "short.bag", "torn.bag", "without.bag"
KEYS = {GOOD, TWIN, SERIES, SHORT, TORN, LOST}
RECIPE = QUICK.replace("settle_s: 0", "settle_s: 0, min_duration_s: 0.8")
ALL = RECIPE.replace("preview: {{enabled: false}}", "vision: {{}}")
"""With pictures, the map and a second dataset."""


def write_recordings(bags, *, fails=True):
    """Write them: one that is fine and its twin, a series, one too short and, with `fails`, a torn one and one without poses."""
    write_drive(bags / GOOD, "ros1", duration_s=1.0)
    shutil.copyfile(bags / GOOD, bags / TWIN)
    write_parts(bags / SERIES, [0.6], 1.2)
    write_drive(bags / SHORT, "ros1", duration_s=0.4)
    if fails:
        (bags / TORN).write_bytes((bags / GOOD).read_bytes()[:5000])
        write_drive(bags / LOST, "ros1", duration_s=1.1, keep=lambda topic, _: topic != "/odom")


def make_door(folder, bags, text=RECIPE):
    """Write a project of these recordings, without any record of them; return its recipe file."""
    write_project(folder, text.format(name="test", root=bags))
    return folder / "recipe.yaml"


def result(recipe_file):
    """Return the dataset, the states, and what the web UI shows of each asset of each recording."""
    graph = build_definitions(recipe_file).resolve_asset_graph()
    with open_project(recipe_file) as workspace:
        instance = workspace.instance
        pending = find_pending_work(workspace, BuildOptions())
        shown = {
            key.to_user_string(): shown_partitions(instance, key, graph.get(key).partitions_def)
            for key in sorted(graph.materializable_asset_keys)
            if graph.get(key).partitions_def is not None
        }
        return {
            "dataset": files(workspace.recipe.nuscenes.output),
            "states": {
                key: {n: one.state for n, one in bag.assets.items()} for key, bag in pending.plan.bags.items()
            },
            "dataset is current": pending.dataset_is_current,
            "shown": shown,
            "why": {
                f"{key} {name}": workspace.records.last_failure(name, key)
                for name, of_asset in shown.items()
                for key in of_asset["failed"]
            },
            "registered": Records(instance, Naming("test")).live(),
        }


def shown_partitions(instance, key, partitions):
    """Return the partitions that the web UI shows as materialized, and those as failed."""
    value = get_and_update_asset_status_cache_value(
        instance, key, partitions, dynamic_partitions_loader=instance
    )
    made = value.deserialize_materialized_partition_subsets(partitions)
    failed = value.deserialize_failed_partition_subsets(partitions)
    return {"made": set(made.get_partition_keys()), "failed": set(failed.get_partition_keys())}


def files(folder):
    """Return path -> content of the files in a folder."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
