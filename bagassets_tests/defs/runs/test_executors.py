"""Projects in a code location whose executor is somebody else's: a click on *Materialize* uses it, our own jobs do not."""

import re
import subprocess
import sys
from pathlib import Path

import dagster as dg
import pytest

from bagassets.defs import build_definitions
from bagassets.defs.records.events import Records
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import add_partitions
from bagassets.defs.runs.execution import CodeLocation
from bagassets.defs.runs.run_pool import RunPool
from bagassets.defs.runs.worker_tag import RunWorker
from bagassets.forkserver.client import Client
from bagassets_tests.in_process import QUICK
from bagassets_tests.services import BIN, bare_environment
from bagassets_tests.small_drive import write_drive

KEY = "a.bag"
NAMES = ("north", "south")
MODULE = """
from pathlib import Path

import dagster as dg

from bagassets.defs import build_definitions

HERE = Path(__file__).parent


@dg.asset
def other(): ...


defs = dg.Definitions.merge(
    *(build_definitions(HERE / name / "recipe.yaml", key_prefix=name) for name in ("north", "south")),
    dg.Definitions(assets=[other], executor=dg.multiprocess_executor),
)
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """The same recording in two projects, beside assets of somebody who has chosen the multiprocess executor."""
    folder = tmp_path_factory.mktemp("executors")
    for name in NAMES:
        write_drive(folder / name / "bags" / KEY, "ros1", duration_s=1.0)
        (folder / name / "recipe.yaml").write_text(QUICK.format(name="drives", root="bags"))
    (folder / "two_drives.py").write_text(MODULE)
    (folder / "home").mkdir()
    launcher = f"{{module: bagassets.defs.launcher, class: BagAssetsRunLauncher, config: {{state_folder: {folder}/north/.bagassets}}}}"
    (folder / "home" / "dagster.yaml").write_text(
        f"telemetry: {{enabled: false}}\nrun_launcher: {launcher}\n"
    )
    yield folder
    for client in Client.all_of(folder / "north" / ".bagassets"):
        client.shutdown(grace_s=0.0)


def dagster(place, *command):
    done = subprocess.run(
        [BIN / "dagster", *command],
        check=False, cwd=place, capture_output=True, text=True, timeout=300,
        env=bare_environment() | {"DAGSTER_HOME": str(place / "home")},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout + done.stderr


def records(place, name):
    """Return asset -> what is on record of it, but for times and paths, of the newest materialization."""
    found = {}
    with open_instance(str(place / "home")) as instance:
        for key in instance.all_asset_keys():
            if key.path[0] != name:
                continue
            made = instance.get_latest_materialization_event(key).asset_materialization
            inputs = {
                tag.replace(f"/{name}/", "/"): version
                for tag, version in made.tags.items()
                if "input_data_version" in tag
            }
            cached = made.metadata.get("cached")
            found[key.path[-1]] = (
                made.tags["dagster/data_version"],
                inputs,
                cached is not None and cached.value,
            )
    return found


def processes(log):
    """Return the process ids in a log of Dagster of which steps were executed."""
    return set(re.findall(r" - (\d+) - \S+ - STEP_START ", log))


def test_beside_somebody_elses_executor_our_jobs_keep_one_process_and_clicks_have_theirs(place, monkeypatch):
    monkeypatch.syspath_prepend(str(place))
    monkeypatch.delitem(sys.modules, "two_drives", raising=False)
    definitions = __import__("two_drives").defs
    click = definitions.resolve_implicit_global_asset_job_def()
    assert click.executor_def is dg.multiprocess_executor
    for name in NAMES:
        names = Naming("drives", (name,))
        for job in (names.assets_job, names.batch_job):
            assert definitions.resolve_job_def(job).executor_def is dg.in_process_executor


@pytest.mark.parametrize(
    ("prefix", "asked", "named"),
    [
        (None, None, dg.in_process_executor),
        (None, False, None),
        ("north", None, None),
        ("north", True, dg.in_process_executor),
    ],
)
def test_the_executor_is_named_without_a_prefix_or_if_asked_for(place, prefix, asked, named):
    definitions = build_definitions(place / "north" / "recipe.yaml", key_prefix=prefix, in_process=asked)
    assert definitions.executor is named


@pytest.mark.long
def test_a_step_in_a_process_of_its_own_records_what_one_process_does(place):
    """One project by what a click runs, and the other by the job of its sensor."""
    many = dagster(place, "asset", "materialize", "-m", "two_drives",
                   "--select", 'key:"north/*"', "--partition", KEY)  # fmt: skip
    assert len(processes(many)) > 2
    with open_instance(str(place / "home")) as instance:
        add_partitions(Records(instance, Naming("drives", ("south",))), [KEY])
    one = dagster(place, "job", "execute", "-m", "two_drives", "-j", "south__recordings_and_datasets",
                  "--tags", f'{{"dagster/partition": "{KEY}"}}')  # fmt: skip
    assert len(processes(one)) == 1
    found = records(place, "north")
    assert {"bag", "inventory", "frames", "nuscenes_tables", "nuscenes_dataset"} <= found.keys()
    assert found == records(place, "south")
    assert not any(cached for _, _, cached in found.values()), "the store was empty"


@pytest.mark.long
def test_our_launcher_executes_runs_whose_steps_are_processes(place, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))
    monkeypatch.delenv("BAGASSETS_RECIPE", raising=False)
    names = Naming("drives", ("north",))
    location = CodeLocation("two_drives", working_directory=str(place))
    with open_instance(str(place / "home")) as instance:
        add_partitions(Records(instance, names), [KEY])
        log = place / "code-server.log"
        with RunPool(Records(instance, names), 1, lambda _: None, log, location, key_of=names.key) as runs:
            runs.work([{KEY: ("bag", "inventory")}])
        assert runs.ended[KEY].problem is None
        run = instance.get_run_by_id(runs.ended[KEY].run_id)
        assert RunWorker.of(run) is not None, "a worker of our server executed it"
        began = instance.all_logs(run.run_id, of_type=dg.DagsterEventType.STEP_WORKER_STARTED)
        assert len(began) >= 2, "each step in a process of its own"
