"""Projects built by a real Slurm of two nodes with their records in a real PostgreSQL."""

import shutil
import subprocess
import sys
import time

import dagster as dg
import pytest

from bagassets.engine.batches import DATASET
from bagassets.engine.freshness.decide import nothing_to_do
from bagassets_tests.defs.launchers.test_slurm_build import (
    build,
    content,
    projects,
    runs,
    start,
    use_slurm,
    wait,
)
from bagassets_tests.in_process import keys_of, make_project
from bagassets_tests.postgres_server import PROGRAMS, running_postgres, use_postgres
from bagassets_tests.small_drive import write_drive

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(PROGRAMS is None, reason="PostgreSQL is not installed"),
]
KEYS = [f"drive_{number:02}.{('bag', 'mcap')[number % 2]}" for number in range(12)]
__all__ = ["projects"]


@pytest.fixture
def postgres():
    with running_postgres() as server:
        yield server


def make(folder, keys, postgres, projects):
    recipe_file = make_project(folder, keys)
    use_slurm(recipe_file, runs_per_job=3)
    use_postgres(recipe_file, postgres.url)
    projects.append(recipe_file)
    return recipe_file


def test_twelve_recordings_over_two_nodes_are_the_dataset_that_one_machine_makes(
    tmp_path, slurm, postgres, projects
):
    project = make(tmp_path / "p", KEYS, postgres, projects)
    assert "12 built" in build(project).stdout
    assert {run.tags["slurm/node"] for run in runs(project)} == {"n1", "n2"}
    assert not list(tmp_path.rglob("index.db")), "no SQLite of Dagster's"
    here = make_project(tmp_path / "here", ())
    projects.append(here)
    shutil.copytree(project.parent / "bags", here.parent / "bags", dirs_exist_ok=True)
    build(here)
    assert content(here.parent / "dataset") == content(project.parent / "dataset")
    # What changed, and nothing else.
    assert "12 fresh: nothing to do" in nothing_to_do(["build", "--recipe", str(project)])
    write_drive(project.parent / "bags" / KEYS[3], "mcap", duration_s=2.0)
    (project.parent / "bags" / KEYS[0]).unlink()
    before = {run.run_id for run in runs(project)}
    assert "1 built" in build(project).stdout
    later = [keys_of(run) for run in runs(project) if run.run_id not in before]
    assert later == [{KEYS[3], DATASET}]
    assert "11 fresh: nothing to do" in nothing_to_do(["build", "--recipe", str(project)])


def test_a_restart_of_the_database_leaves_nothing_half_made(tmp_path, slurm, postgres, projects):
    project = make(tmp_path / "p", KEYS[:2], postgres, projects)
    process = start(project)
    wait(lambda: runs(project, statuses=[dg.DagsterRunStatus.STARTED]), "runs are at work")
    postgres.stop()
    time.sleep(1.0)
    postgres.start()
    process.communicate(timeout=180)
    wait(lambda: slurm.ask("squeue", "--noheader") == "", "no job is left")
    for _ in range(2):
        last = subprocess.run(
            [sys.executable, "-m", "bagassets", "build", "--retry-failed", "--recipe", str(project)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
    assert last.returncode == 0, last.stdout + last.stderr
    assert all(run.is_finished for run in runs(project))
    verified = subprocess.run(
        [sys.executable, "-m", "bagassets", "verify", "--recipe", str(project)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert verified.returncode == 0, verified.stdout + verified.stderr
