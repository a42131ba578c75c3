"""Nodes that do not see what the machine that submits sees, under a real Slurm: a folder is there, but not mounted."""

import subprocess

import pytest

from bagassets.defs.records.instances import open_instance
from bagassets.defs.runs.execution import failure_of
from bagassets.propose.project import dagster_home
from bagassets.recipe import load_recipe
from bagassets_tests.defs.launchers.test_slurm_build import build, command, projects, runs, use_slurm
from bagassets_tests.in_process import make_project

pytestmark = pytest.mark.long
__all__ = ["projects"]


def can_mount():
    return subprocess.run(["unshare", "--mount", "true"], capture_output=True, check=False).returncode == 0


def seen_as(path, instead):
    """What a job has before its command, for its node to see another folder under a path."""
    return f"unshare --mount sh -c 'mount --bind {instead} {path} && exec \"$@\"' sh"


@pytest.fixture
def project(tmp_path, slurm, projects):
    if not can_mount():
        pytest.skip("this machine does not let us mount (unshare --mount)")
    recipe_file = make_project(tmp_path / "p", ("a.bag", "b.mcap"))
    projects.append(recipe_file)
    (tmp_path / "other").mkdir()
    return recipe_file


def failures(recipe_file):
    with open_instance(str(dagster_home(recipe_file, load_recipe(recipe_file)))) as instance:
        return {failure_of(instance, run) for run in instance.get_runs() if "slurm/job" in run.tags}


def fails(recipe_file):
    done = subprocess.run(command(recipe_file), capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 1, done.stdout + done.stderr
    assert all(run.is_finished for run in runs(recipe_file)), "none hangs"
    return "\n".join(failures(recipe_file))


@pytest.mark.parametrize("what", ["empty", "another"])
def test_a_store_that_is_not_mounted(project, tmp_path, what):
    store = load_recipe(project).store_path
    if what == "another":
        (tmp_path / "other" / "store.id").write_text("0123" * 8 + "\n")
    use_slurm(project, prefix=seen_as(store, tmp_path / "other"))
    store.mkdir(parents=True, exist_ok=True)
    before = {path.name for path in (tmp_path / "other").iterdir()}
    found = fails(project)
    words = {"empty": "nothing of the store", "another": "another store"}[what]
    assert f" sees {words} in {store}; mount it there, under this very path." in found
    assert "Node n1" in found or "Node n2" in found
    assert {path.name for path in (tmp_path / "other").iterdir()} == before, "nothing was made there"
    use_slurm(project)
    assert "2 built" in build(project, "--retry-failed").stdout


@pytest.mark.parametrize("what", ["empty", "another"])
def test_recordings_that_are_not_mounted(project, tmp_path, what):
    root = load_recipe(project).bags.root
    if what == "another":
        for path in root.iterdir():
            (tmp_path / "other" / path.name).write_bytes(path.read_bytes()[:-7])
    use_slurm(project, prefix=seen_as(root, tmp_path / "other"))
    found = fails(project)
    size = (root / "a.bag").stat().st_size
    words = {
        "empty": f"does not see {root}/a.bag; mount the folder of recordings there",
        "another": f"sees {root}/a.bag with {size - 7} bytes instead of {size}; mount the folder of recordings there",
    }[what]
    assert words in found


def test_a_recording_that_goes_on_its_way_costs_the_others_nothing(project):
    root = load_recipe(project).bags.root
    # As between the launch and the begin of the job.
    use_slurm(project, prefix=f"rm {root}/a.bag;")
    done = subprocess.run(command(project), capture_output=True, text=True, check=False, timeout=120)
    assert "1 built" in done.stdout, done.stdout + done.stderr
    assert not any("mount" in failure for failure in failures(project))


def test_the_folder_of_jobs_that_is_not_mounted(project, tmp_path):
    folder = load_recipe(project).state.absolute() / "slurm"
    folder.mkdir(parents=True)
    use_slurm(project, prefix=seen_as(folder, tmp_path / "other"))
    found = fails(project)
    assert " does not see " in found
    assert str(folder / "jobs") in found


def test_a_job_whose_log_cannot_be_made_says_where_it_should_be(project, tmp_path):
    folder = load_recipe(project).state.absolute() / "slurm"
    # The batch script dies before it can leave anything, as where Slurm cannot open its output.
    use_slurm(project, prefix=f"rm -r {folder}/logs; kill -KILL $$;")
    found = fails(project)
    assert "ended as FAILED: its command failed. It left neither a record nor a log in" in found
    assert str(folder) in found
