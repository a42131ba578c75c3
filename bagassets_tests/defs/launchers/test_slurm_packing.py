"""What jobs ask for, how runs are packed into them, and who gets a run: without Slurm."""

import threading
import time
from dataclasses import asdict

import pytest

from bagassets.base.errors import BagAssetsError
from bagassets.defs.launchers.slurm import launcher as slurm_launcher
from bagassets.defs.launchers.slurm.commands import JobState, SlurmError, submit_job
from bagassets.defs.launchers.slurm.keeper import Packing
from bagassets.defs.launchers.slurm.launcher import SlurmRunLauncher
from bagassets.defs.launchers.slurm.options import JobOptions, options_for
from bagassets.defs.launchers.slurm.spool import JobSpec, Spool, SpooledRun
from bagassets_tests.in_process import make_project
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

BASE = JobOptions(partition="work", cpus=2, memory="4G", options=("--qos=low",))
RULES = [
    {"above_gb": 1.0, "memory": "16G"},
    {"above_gb": 10.0, "memory": "64G", "time": "8:00:00"},
]


def spec(**options):
    return JobSpec("{}", JobOptions(**options).as_json(), "python", "/", ["m"], [], "/locks", {}, [], {})


def run(name, seconds=1.0, since=0.0, recordings=1, **options):
    return SpooledRun(name, spec(**options), seconds, since, recordings)


@pytest.mark.parametrize(
    ("size", "tags", "expected"),
    [
        (0, {}, ["--partition=work", "--mem=4G", "--cpus-per-task=2", "--qos=low"]),
        (2_000_000_000, {}, ["--partition=work", "--mem=16G", "--cpus-per-task=2", "--qos=low"]),
        (
            20_000_000_000,
            {"slurm/memory": "1G", "slurm/cpus": "3", "slurm/prefix": "rm -r", "slurm/options": "--uid=0"},
            ["--partition=work", "--mem=1G", "--time=8:00:00", "--cpus-per-task=3", "--qos=low"],
        ),
    ],
)
def test_later_rules_override_earlier_ones_and_tags_override_all(size, tags, expected):
    options = options_for(BASE, RULES, size, tags)
    assert options.arguments() == expected
    assert options.prefix == "", "a tag is no shell command"


def test_a_tag_that_cannot_be_is_refused():
    with pytest.raises(BagAssetsError, match="slurm/cpus: a number of processors is expected, not 'many'"):
        options_for(BASE, RULES, 0, {"slurm/cpus": "many"})


def test_a_job_is_full_by_number_or_by_work_on_all_its_cpus():
    names = [run(str(number), seconds=60.0, cpus=2) for number in range(10)]
    packed = Packing(runs=3, minutes=99, gather_s=1).jobs(names)
    assert [[one.run_id for one in job] for job in packed] == [
        ["0", "1", "2"],
        ["3", "4", "5"],
        ["6", "7", "8"],
        ["9"],
    ]
    assert [len(job) for job in Packing(runs=99, minutes=2, gather_s=1).jobs(names)] == [4, 4, 2]
    assert [len(job) for job in Packing(runs=99, minutes=2, gather_s=1).jobs(names, pace=2.0)] == [2] * 5


def test_a_run_of_several_recordings_counts_as_so_many():
    names = [run(str(number), recordings=10) for number in range(4)]
    assert [len(job) for job in Packing(runs=20, minutes=99, gather_s=1).jobs(names)] == [2, 2]


def test_a_run_that_an_older_version_left_waiting_is_about_one_recording():
    value = asdict(run("a"))
    del value["recordings"]
    assert SpooledRun.from_json(value) == run("a")


def test_runs_with_other_needs_get_another_job():
    packed = Packing(99, 99, 1).jobs([run("a"), run("b", memory="9G"), run("c")])
    assert [[one.run_id for one in job] for job in packed] == [["a", "c"], ["b"]]


def test_a_job_waits_for_more_runs_but_not_for_ever():
    packing = Packing(runs=3, minutes=99, gather_s=1.0)
    few = [run("a", since=100.0), run("b", since=100.5)]
    assert packing.jobs(few, now=101.2) == []
    assert packing.jobs(few, now=101.6) == [few]
    trickle = [run("a", since=100.0), run("b", since=110.0)]
    assert packing.jobs(trickle, now=110.1) == [trickle]
    full = [*few, run("c", since=101.0)]
    assert packing.jobs([*full, run("d", since=101.1)], now=101.2) == [full]


def test_one_of_many_gets_a_run(tmp_path):
    spool = Spool(tmp_path)
    spool.make()
    for number in range(20):
        spool.put(run(str(number), since=float(number)))
    barrier, got, waiting = threading.Barrier(4), [], spool.waiting()

    def pack():
        barrier.wait()
        got.extend(one.run_id for one in spool.new_job(waiting)[1])

    threads = [threading.Thread(target=pack) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(got, key=int) == [str(number) for number in range(20)]
    assert spool.waiting() == []


def test_what_was_taken_back_cannot_be_begun(tmp_path):
    spool = Spool(tmp_path)
    spool.make()
    for name in ("begun", "taken back"):
        spool.put(run(name, since=time.time()))
    job, _ = spool.new_job(spool.waiting())
    assert job.take("begun").run_id == "begun"
    assert not spool.take_back(job, "begun")
    assert not spool.drop(job, "begun")
    assert spool.take_back(job, "taken back")
    assert job.take("taken back") is None
    assert [one.run_id for one in spool.waiting()] == ["taken back"]
    spool.settle(job)
    assert not job.is_open


def test_a_job_begins_its_runs_by_age(tmp_path):
    spool = Spool(tmp_path)
    spool.make()
    for run_id, since in (("a", 3.0), ("b", 1.0), ("c", 2.0)):
        spool.put(run(run_id, since=since))
    job, _ = spool.new_job(spool.waiting())
    assert [one.run_id for one in job.queue()] == ["b", "c", "a"]
    assert job.has("a")
    assert not job.has("d")


def test_a_job_takes_more_runs_like_its_own_if_they_end_in_time(tmp_path):
    spool = Spool(tmp_path)
    spool.make()
    spool.put(run("its own"))
    job, _ = spool.new_job(spool.waiting())
    spool.put(run("other needs", memory="9G"))
    spool.put(run("too long", seconds=61.0))
    assert job.take_waiting(60.0) is None
    spool.put(run("more", seconds=59.0))
    assert job.take_waiting(60.0).run_id == "more"
    assert job.begun() == ["more"]
    assert {one.run_id for one in spool.waiting()} == {"other needs", "too long"}


@pytest.mark.parametrize(
    ("state", "words"),
    [
        (
            JobState("7", "PENDING", "QOSMaxJobsPerUserLimit"),
            "Slurm job 7 is queued (QOSMaxJobsPerUserLimit)",
        ),
        (JobState("7", "RUNNING", "", "n1"), "Slurm job 7 on n1"),
        (
            JobState("7", "OUT_OF_MEMORY", "", "n1"),
            "Slurm job 7 on n1 ended as OUT_OF_MEMORY: it took more memory than it asked for",
        ),
    ],
)
def test_states_in_words(state, words):
    assert str(state) == words
    assert state.has_ended == ("ended" in words)


POLICY = (
    "sbatch: error: Batch job submission failed: Job violates accounting/QOS policy "
    "(job submit limit, user's size and/or time limits)"
)


@pytest.mark.parametrize(
    ("words", "is_temporary"),
    [
        (f"sbatch: error: QOSMaxSubmitJobPerUserLimit\n{POLICY}", True),
        (f"sbatch: error: AssocGrpSubmitJobsLimit\n{POLICY}", True),
        (POLICY, True),
        (f"sbatch: error: QOSMaxWallDurationPerJobLimit\n{POLICY}", False),
        (f"sbatch: error: AssocMaxCpuPerJobLimit\n{POLICY}", False),
        (
            "sbatch: error: Batch job submission failed: Invalid account or account/partition combination specified",
            False,
        ),
        ("sbatch: error: Batch job submission failed: Invalid qos specification", False),
        ("sbatch: error: Slurm temporarily unable to accept job, sleeping and retrying", True),
        ("sbatch: error: Batch job submission failed: Unable to contact slurm controller", True),
        ("", False),
    ],
)
def test_only_what_may_change_by_itself_is_tried_again(tmp_path, monkeypatch, words, is_temporary):
    (tmp_path / "sbatch").write_text(f"#!/bin/sh\nprintf '%s\\n' \"{words}\" >&2\nexit 1\n")
    (tmp_path / "sbatch").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(SlurmError) as caught:
        submit_job([], "", tmp_path)
    assert caught.value.is_temporary == is_temporary
    assert " ".join(words.split()) in str(caught.value)


def test_a_recording_that_came_a_moment_ago_has_its_size(tmp_path, monkeypatch):
    """The daemon launches runs of new recordings soon after others, and rules on sizes are for them, too."""
    monkeypatch.setattr(slurm_launcher, "_LOOK_LEAST_S", 0.0)
    recipe_file = make_project(tmp_path)
    launcher = SlurmRunLauncher(recipe=str(recipe_file))
    assert _size(launcher, recipe_file, "a.bag") == (tmp_path / "bags" / "a.bag").stat().st_size
    new = write_drive(tmp_path / "bags" / "b.bag", "ros1", duration_s=1.2)
    assert _size(launcher, recipe_file, "b.bag") == new.stat().st_size
    assert _size(launcher, recipe_file, "gone.bag") == 0


def _size(launcher, recipe_file, key):
    return sum(one.size for one in launcher._recordings(recipe_file, [key]))
