"""The `dagster.yaml` and `workspace.yaml` of a source checkout: Dagster started there shows the demo."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from bagassets.defs.records.instances import open_instance
from bagassets.propose.project import dagster_files, write_project
from bagassets_tests.services import BIN, bare_environment
from bagassets_tests.small_drive import RECIPE, write_drive

ROOT = Path(__file__).parents[2]
STATE = "build/demo/.bagassets"

pytestmark = [pytest.mark.xdist_group("materialize"), pytest.mark.once]


@pytest.fixture
def checkout(tmp_path):
    """Return a folder that looks like a checkout in which `make demo` was run."""
    root = tmp_path / "checkout"
    demo = root / "build" / "demo"
    write_drive(demo / "recordings" / "a.bag", "ros1", duration_s=2.0)
    write_project(demo, RECIPE.format(name="demo", root="recordings"))
    for name in ("dagster.yaml", "workspace.yaml"):
        shutil.copy(ROOT / name, root / name)
    return root


def files_of(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_the_checkout_is_configured_like_the_project_of_the_demo():
    project = yaml.safe_load(dagster_files(ROOT / "build" / "demo", ROOT / STATE)["dagster.yaml"])
    del project["secrets"]  # no .env is read here
    project["run_coordinator"]["config"]["max_concurrent_runs"] = 4  # a file for all machines
    text = (ROOT / "dagster.yaml").read_text()
    absolute = text.replace(": build/demo", f": {ROOT}/build/demo")
    assert yaml.safe_load(absolute) == project


def test_a_recording_of_the_demo_is_materialized_from_the_checkout(checkout):
    before = files_of(checkout)
    command = [BIN / "dagster", "asset", "materialize", "-m", "bagassets.definitions"]
    done = subprocess.run(
        [str(part) for part in (*command, "--select", "*", "--partition", "a.bag")],
        check=False,
        cwd=checkout,
        # As in a shell, whose PWD is this folder, and as of a program, whose PWD is another one.
        env={**bare_environment(), "PWD": os.sep},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    new = files_of(checkout) - before
    assert {path for path in new if not path.startswith("build/demo/")} == set()
    with open_instance(str(checkout / "build" / "demo")) as instance:  # the demo's own configuration
        assert instance.get_dynamic_partitions("demo_recordings") == ["a.bag"]
        assert instance.get_runs_count() == 1
