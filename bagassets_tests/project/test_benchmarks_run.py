"""Each benchmark runs to its end, with recordings as small as can be; what it measures then says nothing."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bagassets_tests.postgres_server import PROGRAMS
from bagassets_tests.slurm_cluster import missing_program
from benchmarks.cold import BUILD, FIXED_LOOP, PICTURES
from benchmarks.doors import doors_table
from benchmarks.launch import launch_table
from benchmarks.peers import BAGASSETS, BAZEL, LOOP
from benchmarks.reader import reader_table
from benchmarks.reads import reads_table
from benchmarks.scale import scale_table, unbuilt_table
from benchmarks.series import series_table
from benchmarks.slurm import scaling_table, slurm_table

pytestmark = [pytest.mark.benchmark, pytest.mark.long]

ROOT = Path(__file__).parents[2]


def run(*arguments):
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def results_of(part, folder):
    printed = run("-m", "benchmarks", "--tiny", "--results", folder, part)
    assert (folder / f"{part}.md").read_text("utf-8") in printed
    return json.loads((folder / f"{part}.json").read_text("utf-8"))


def test_rq1_measures_every_row(tmp_path):
    times = results_of("rq1", tmp_path)["times_s"]
    assert len(times) == 3
    for by_scenario in times.values():
        assert list(by_scenario) == ["cold", "warm", "incremental, metadata", "incremental, content"]
    rows = [tuple(taken) for by_scenario in times.values() for taken in by_scenario.values()]
    assert len(set(rows)) == len(rows)  # none is a copy of another
    assert (tmp_path / "rq1.png").exists()


def test_rq2_fits_lines(tmp_path):
    times = results_of("rq2", tmp_path)["times_s"]
    assert all(len(by_size) == 3 for by_size in times.values())


def test_rq3_changes_a_target_beside_a_fixed_volume(tmp_path):
    found = results_of("rq3", tmp_path)
    assert found["target_gb"] == found["volume_gb"] / 8
    assert len(found["times_s"]) == 4
    assert all(list(by) == ["1 + 1 files", "2 + 1 files"] for by in found["times_s"].values())


def test_cold_and_floor(tmp_path):
    found = results_of("cold", tmp_path)
    assert all(set(case) > {PICTURES, BUILD, FIXED_LOOP} for case in found["cases"].values())
    assert all(case["floor_cpu_s"] > 0 for case in found["cases"].values())
    assert results_of("floor", tmp_path)["plain_cpu_s"] > 0


def test_incremental(tmp_path):
    json_file = tmp_path / "incremental.json"
    run("benchmarks/incremental.py", "--bags", "2", "--seconds", "1.0", "--times", "1", "--json", json_file)
    modes = json.loads(json_file.read_text("utf-8"))["modes"]
    assert {"plain, all", "cold, server down", "metadata only, server up"} <= modes.keys()


def test_plan(tmp_path):
    json_file = tmp_path / "plan.json"
    run("benchmarks/plan.py", "--recordings", "20", "--json", json_file)
    assert json.loads(json_file.read_text("utf-8"))["recordings"] == 20


def test_scale(tmp_path):
    result = tmp_path / "scale.json"
    numbers = ("--numbers", "3", "--replicated", "8", "--base", "4", "--unbuilt", "10")
    printed = run("-m", "benchmarks.scale", *numbers, "--times", "1", "--json", result)
    found = json.loads(result.read_text("utf-8"))
    assert scale_table(found) in printed
    assert unbuilt_table(found) in printed
    costs = found["built"]["costs"]
    assert [name for name, (_, copied) in costs.items() if copied is None] == [
        name for name in costs if name.startswith("first build")
    ]
    assert min(built for built, _ in costs.values()) > 0
    assert min(value for (value,) in found["unbuilt"]["costs"].values()) > 0


def test_series(tmp_path):
    result = tmp_path / "series.json"
    options = ("--seconds", "1", "--parts", "2", "--times", "1", "--files", "20")
    printed = run("-m", "benchmarks.series", *options, "--json", result)
    found = json.loads(result.read_text("utf-8"))
    assert series_table(found) in printed
    assert all(shapes["cut"][0]["cpu_s"] > 0 for shapes in found["builds"].values())


@pytest.mark.devkit
def test_reader(tmp_path):
    json_file = tmp_path / "reader.json"
    printed = run("-m", "benchmarks.reader", "--seconds", "2", "--trials", "1", "--json", json_file)
    found = json.loads(json_file.read_text("utf-8"))
    assert reader_table(found) in printed
    assert found["read"]["images"] == 3 * found["read"]["samples"] > 0
    assert all(
        found[name][workers][0]["samples_per_s"] > 0
        for name in ("bare", "bagassets", "devkit")
        for workers in "12"
    )


def test_kernels(tmp_path):
    json_file = tmp_path / "kernels.json"
    run("-m", "benchmarks.kernels", "--size-gb", "0.03", "--trials", "1", "--json", json_file)
    assert len(json.loads(json_file.read_text("utf-8"))["with_cpu_s"]) == 1


def test_flips(tmp_path):
    printed = run("-m", "benchmarks.flips", "--flips", "1", "--results", tmp_path)
    rows = (tmp_path / "flips.md").read_text("utf-8").splitlines()[2:]
    assert len(rows) == 11
    assert all(row in printed for row in rows)


def test_launch(tmp_path):
    json_file = tmp_path / "launch.json"
    printed = run("benchmarks/launch.py", "--times", "1", "--recordings", "2", "--json", json_file)
    found = json.loads(json_file.read_text("utf-8"))
    assert launch_table(found) in printed
    for seconds in found["seconds"].values():
        assert len(seconds) == 5
        assert all(len(taken) == 1 and taken[0] > 0 for taken in seconds.values())


def test_doors(tmp_path):
    json_file = tmp_path / "doors.json"
    beside = "*Materialize all* in `bagassets ui`, beside"
    printed = run(
        "-m", "benchmarks.doors", "--recordings", "7", "--doors", "sensor", beside, "--json", json_file
    )
    figures = json.loads(json_file.read_text("utf-8"))
    assert doors_table(figures) in printed
    command, sensor, web_ui = figures["doors"]["doors"].values()
    for one in (sensor, web_ui):
        assert one["differs"] == []
        assert (one["datasets"], one["made"]) == (command["datasets"], 5)
    assert web_ui["backfill"] == "COMPLETED_FAILED"


def test_peers_without_peers(tmp_path):
    printed = run("-m", "benchmarks.peers", "--tiny", "--results", tmp_path)
    assert "No Bazel was given" in printed
    assert "No converter was given" in printed
    found = json.loads((tmp_path / "peers.json").read_text("utf-8"))
    assert len(found["rows"]) == 7
    assert all(set(by_method) == {BAGASSETS} for by_method in found["rows"].values())


@pytest.mark.skipif(shutil.which("bazel") is None, reason="there is no Bazel")
def test_peers_with_a_rule_of_ours(tmp_path):
    script = tmp_path / "convert.py"
    script.write_text("import shutil, sys; shutil.copy(sys.argv[1], sys.argv[2])")
    command = f"{sys.executable} {script} {{bag}} {{out}}"
    folder = tmp_path / "results"
    run("-m", "benchmarks.peers", "--tiny", "--results", folder, "--bazel", "bazel", "--converter", command)
    found = json.loads((folder / "peers.json").read_text("utf-8"))
    assert found["files"] == {BAGASSETS: found["files"][BAGASSETS], BAZEL: 2, LOOP: 2}
    assert [len(by_method) for by_method in found["rows"].values()] == [3, 2, 2, 2, 2, 2, 3]
    assert str(tmp_path) not in (folder / "peers.json").read_text("utf-8")


def test_chaos(tmp_path):
    run("-m", "benchmarks.chaos", "--kills", "2", "--json", tmp_path / "chaos.json")
    found = json.loads((tmp_path / "chaos.json").read_text("utf-8"))
    assert (found["counts"]["kills"], found["counts"]["verified"], found["problems"]) == (2, 2, [])


def test_soak(tmp_path):
    run("-m", "benchmarks.soak", "--minutes", "0.01", "--json", tmp_path / "soak.json")
    (only,) = json.loads((tmp_path / "soak.json").read_text("utf-8"))["rounds"]
    assert all(value > 0 for value in only.values())


def may_make_control_groups():
    root = Path("/sys/fs/cgroup")
    return any(os.access(folder, os.W_OK) for folder in (root / "memory", root / "cgroup.subtree_control"))


@pytest.mark.skipif(not may_make_control_groups(), reason="this user may not make control groups")
def test_reads(tmp_path):
    json_file = tmp_path / "reads.json"
    printed = run("-m", "benchmarks.reads", "--size", "0.03", "--memory", "2", "--json", json_file)
    found = json.loads(json_file.read_text("utf-8"))
    assert reads_table(found) in printed
    assert list(found["formats"]) == ["ros1", "ros2", "mcap"]
    # Memory holds them all here, so each is read once.
    assert all(
        0.9 < read / case["recording_bytes"] < 1.9
        for case in found["formats"].values()
        for read in case["read_bytes"].values()
    )


@pytest.mark.skipif(missing_program() is not None, reason=str(missing_program()))
@pytest.mark.skipif(PROGRAMS is None, reason="PostgreSQL is not installed")
def test_slurm(tmp_path):
    result = tmp_path / "slurm.json"
    few = ("--numbers", "2", "4", "--many", "0", "--beside", "2", "--runs", "1", "--stale", "3")
    run("-m", "benchmarks.slurm", *few, "--json", result)
    found = json.loads(result.read_text("utf-8"))
    assert [one["recordings"] for one in found["builds"]] == [2, 2, 4, 4]
    assert all(seconds >= 0 for seconds in found["one"].values())
    parts = list(found["one"].values())
    assert sum(parts[:-1]) == pytest.approx(parts[-1], abs=0.05)
    assert "left out of the fit" in scaling_table(found)
    assert f"| 2 | 2 | fork server | {found['beside']['local_s']:.1f} |" in slurm_table(found)
    assert "3 runs launched in a row" in slurm_table(found)
