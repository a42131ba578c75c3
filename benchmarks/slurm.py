"""What runs cost on Slurm: beside the local fork server, from submission to the first step, and for how many recordings.

Starts a real Slurm on this machine (root only), whose nodes share its processors, and PostgreSQL for the records::

    python -m benchmarks.slurm [--json benchmarks/results/slurm.json] [--many 300] [--stale 1000]

A model of the time is fitted to builds of some numbers of recordings with one worker and with two, and compared with the
largest of them, which is left out of the fit. Small recordings share runs by fours there, so that jobs end together.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from datetime import datetime
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).parents[1]))
from bagassets.defs.launchers.slurm.spool import Spool
from bagassets.defs.records.instances import open_instance
from bagassets.defs.runs.code_server import LaunchWorkspace
from bagassets.defs.runs.execution import CodeLocation, create_run
from bagassets.forkserver.client import Client
from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets_tests import small_definitions, small_drive
from bagassets_tests.in_process import QUICK
from bagassets_tests.postgres_server import Postgres, running_postgres, use_postgres
from bagassets_tests.slurm_cluster import running_cluster
from benchmarks.common import machine

DRIVE_S = 1.0
NUMBERS, WORKERS = (16, 32, 48, 80), (1, 2)
PER_RUN = 4
BESIDE = 40
PREDICTED = 10_000


def main() -> None:
    parser = argparse.ArgumentParser(description="Cost of runs on Slurm.")
    parser.add_argument("--json", type=Path, help="write the figures here")
    parser.add_argument(
        "--many", type=int, default=300, help="recordings of the largest build; 0 leaves it out"
    )
    parser.add_argument("--stale", type=int, default=1000, help="runs that one process launches in a row")
    parser.add_argument("--numbers", type=int, nargs="+", default=list(NUMBERS), help="multiples of 8")
    parser.add_argument("--beside", type=int, default=BESIDE, help="recordings built beside the fork server")
    parser.add_argument("--runs", type=int, default=3, help="builds beside the fork server, by turns")
    arguments = parser.parse_args()
    found: dict[str, Any] = {"machine": machine(), "builds": []}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True, prefix="bagassets-") as folder:
        work = Path(folder)
        with running_cluster() as cluster, running_postgres() as postgres:
            os.environ |= cluster.environment
            found["one"] = one_run(work, postgres)
            print(found["one"], flush=True)
            found["beside"] = beside(work, arguments.beside, arguments.runs, postgres)
            print(found["beside"], flush=True)
            found["launches"] = launches(work, arguments.stale, postgres)
            print(found["launches"], flush=True)
            for number in arguments.numbers:
                for workers in WORKERS:
                    seconds = on_slurm(work / f"s{number}-{workers}", number, workers, postgres)
                    found["builds"].append({"recordings": number, "workers": workers, "seconds": seconds})
                    print(found["builds"][-1], flush=True)
            if arguments.many:
                recipe_file = make(work / "many", arguments.many, postgres, cpus=1)
                seconds = build(recipe_file, arguments.many)
                with open_instance(str(recipe_file.parent)) as instance:
                    nodes = {run.tags["slurm/node"] for run in instance.get_runs()}
                found["many"] = {"recordings": arguments.many, "workers": len(nodes), "seconds": seconds}
    found["model"] = model(found["builds"], (max(arguments.numbers), 2))
    print(slurm_table(found), flush=True)
    print(scaling_table(found), flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n", "utf-8")


def make(folder: Path, number: int, postgres: Postgres, /, **launcher: Any) -> Path:
    """Write a project of small recordings with its records in a database of its own."""
    start_ns = small_drive.START_NS
    for index in range(number):
        # The same drive a minute later: other content, the same work.
        small_drive.START_NS = start_ns + index * 60 * 10**9
        small_drive.write_drive(folder / "bags" / f"r{index:04}.bag", "ros1", duration_s=DRIVE_S)
    small_drive.START_NS = start_ns
    write_project(folder, QUICK.format(name=folder.name.replace("-", "_"), root="bags"))
    recipe_file = folder / "recipe.yaml"
    name = "b_" + re.sub(r"\W", "_", folder.name)
    postgres.create_database(name)
    use_postgres(recipe_file, postgres.url_of(name))
    if launcher:
        file = folder / "dagster.yaml"
        config = yaml.safe_load(file.read_text())
        config["run_launcher"] = {
            "module": "bagassets.defs.slurm.launcher",
            "class": "SlurmRunLauncher",
            "config": launcher,
        }
        file.write_text(yaml.safe_dump(config))
    return recipe_file


def build(recipe_file: Path, number: int, *options: str) -> float:
    """Build from nothing; return the seconds."""
    began = time.monotonic()
    command = [sys.executable, "-m", "bagassets", "build", "--recipe", str(recipe_file), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    seconds = time.monotonic() - began
    for client in Client.all_of(load_recipe(recipe_file).state):
        client.shutdown(grace_s=1.0)
    if done.returncode != 0 or f"{number} built" not in done.stdout:
        raise SystemExit(done.stdout + done.stderr)
    return round(seconds, 2)


def on_slurm(folder: Path, number: int, workers: int, postgres: Postgres) -> float:
    """Return how long a build takes with as many jobs of one processor as there are workers."""
    config = {"cpus": 1, "runs_per_job": number // workers, "recordings_per_run": PER_RUN}
    return build(make(folder, number, postgres, **config), number)


def beside(work: Path, number: int, runs: int, postgres: Postgres) -> dict[str, Any]:
    """Return the medians of builds by a job of two processors and by two workers of the fork server, by turns."""
    slurm, local = [], []
    for turn in range(runs):
        slurm.append(build(make(work / f"b{turn}", number, postgres, cpus=2), number))
        local.append(build(make(work / f"l{turn}", number, postgres), number, "--jobs", "2"))
    warm = [nothing_to_do(work / "b0" / "recipe.yaml") for _ in range(5)]
    return {
        "recordings": number,
        "slurm_s": median(slurm),
        "local_s": median(local),
        "nothing_to_do_s": median(warm),
    }


def nothing_to_do(recipe_file: Path) -> float:
    """Return how long a build takes that finds everything fresh."""
    began = time.monotonic()
    command = [sys.executable, "-m", "bagassets", "build", "--recipe", str(recipe_file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "nothing to do" not in done.stdout:
        raise SystemExit(done.stdout + done.stderr)
    return time.monotonic() - began


def launches(work: Path, number: int, postgres: Postgres) -> dict[str, Any]:
    """Return how long the launcher holds its caller for each of many runs, whose jobs Slurm keeps waiting."""
    recipe_file = make(work / "stale", 1, postgres, options=["--begin=now+1hour"], folder=str(work / "spool"))
    os.environ["SMALL_DEFINITIONS"] = str(work)
    location = CodeLocation("small_definitions", working_directory=str(Path(small_drive.__file__).parent))
    keys = [f"r{index:04}.bag" for index in range(number)]
    held: list[float] = []
    with open_instance(str(recipe_file.parent)) as instance:
        instance.add_dynamic_partitions(str(small_definitions.recordings.name), keys)
        workspace = LaunchWorkspace(instance, location, work / "log")
        for key in keys:
            run_id = create_run(instance, ["first"], partition_key=key, location=location)
            began = time.monotonic()
            instance.launch_run(run_id, workspace.for_launcher())
            held.append(time.monotonic() - began)
        spool = Spool(work / "spool")
        while spool.waiting():
            time.sleep(0.1)
        workspace.close()
        jobs = len(spool.jobs())
    subprocess.run(["scancel", "--me"], check=True)
    return {"runs": number, "jobs": jobs, "median_ms": 1000 * median(held), "most_ms": 1000 * max(held)}


def one_run(work: Path, postgres: Postgres) -> dict[str, float]:
    """Return where the time goes from the submission of one run to its first step, in seconds."""
    recipe_file = make(work / "one", 1, postgres, cpus=1)
    build(recipe_file, 1)
    spool = load_recipe(recipe_file).state / "slurm"
    with open_instance(str(recipe_file.parent)) as instance:
        *_, run = instance.get_runs()  # the first one
        logs = instance.all_logs(run.run_id)
        steps = [
            entry.timestamp
            for entry in logs
            if entry.dagster_event is not None and entry.dagster_event.event_type_value == "STEP_START"
        ]
        log = Path(run.tags["slurm/log"]).read_text()
    (job,) = (
        path
        for path in [*(spool / "jobs").iterdir(), *(spool / "ended").iterdir()]
        if run.run_id in str(list(path.rglob("*")))
    )
    since = json.loads((job / "begun" / f"{run.run_id}.json").read_text())["since"]
    submitted = json.loads((job / "submitted.json").read_text())["at"]
    ready = re.search(r"^(\S+ \S+) .*ready after ([\d.]+) s", log, re.MULTILINE)
    assert ready is not None
    ready_at = datetime.strptime(ready[1], "%Y-%m-%d %H:%M:%S,%f").astimezone().timestamp()
    started = ready_at - float(ready[2])
    return {
        "waiting for others to share the job, and sbatch": round(submitted - since, 2),
        "Slurm starts the job, and Python": round(started - submitted, 2),
        "imports": round(float(ready[2]), 2),
        "fork, and opening the records": round(min(steps) - ready_at, 2),
        "in all": round(min(steps) - since, 2),
    }


def model(builds: list[dict[str, Any]], left_out: tuple[int, int]) -> dict[str, Any]:
    """Fit seconds = fixed + recordings * (serial + work / workers) to all builds but one, which it has to predict."""
    rows = [(one["recordings"], one["workers"], one["seconds"]) for one in builds]
    fitted = [row for row in rows if row[:2] != left_out]
    matrix = np.array([[1.0, number, number / workers] for number, workers, _ in fitted])
    fixed, serial, work = np.linalg.lstsq(matrix, np.array([row[2] for row in fitted]), rcond=None)[0]
    (measured,) = (row[2] for row in rows if row[:2] == left_out)
    return {
        "fixed_s": round(float(fixed), 3),
        "serial_s": round(float(serial), 4),
        "work_s": round(float(work), 4),
        "left_out": {
            "recordings": left_out[0],
            "workers": left_out[1],
            "measured_s": measured,
            "predicted_s": round(float(fixed + left_out[0] * (serial + work / left_out[1])), 2),
        },
    }


def slurm_table(found: dict[str, Any]) -> str:
    """Return the table of the builds, and of where the time of one run goes."""
    lines = ["| recordings | workers | launcher | seconds |", "|--:|--:|---|--:|"]
    both = found["beside"]
    rows = [
        (both["recordings"], 2, "fork server", both["local_s"]),
        (both["recordings"], 2, "Slurm", both["slurm_s"]),
    ]
    builds = found["builds"] + ([found["many"]] if "many" in found else [])
    rows += [(one["recordings"], one["workers"], "Slurm", one["seconds"]) for one in builds]
    lines += [f"| {number} | {workers} | {name} | {seconds:.1f} |" for number, workers, name, seconds in rows]
    lines[-len(builds) - 1] = (
        lines[-len(builds) - 1].rstrip("|") + f"({both['slurm_s'] / both['local_s']:.2f} times) |"
    )
    lines += ["", "| from submission to the first step | seconds |", "|---|--:|"]
    lines += [f"| {name} | {seconds:.2f} |" for name, seconds in found["one"].items()]
    held = found["launches"]
    sentence = (
        f"With nothing to do, a build of {both['recordings']} recordings takes {both['nothing_to_do_s']:.2f} s. "
        f"{held['runs']:,} runs launched in a row, by one process: each holds it for {held['median_ms']:.0f} ms (at most "
        f"{held['most_ms']:.0f} ms), whatever Slurm does meanwhile; they became {held['jobs']} jobs."
    )
    lines += ["", sentence]
    return "\n".join(lines)


def scaling_table(found: dict[str, Any]) -> str:
    """Return the model, its check, and what it says of many recordings."""
    fitted, check = found["model"], found["model"]["left_out"]
    serial, work = max(0.0, fitted["serial_s"]), fitted["work_s"]
    law = f"Seconds = {fitted['fixed_s']:.1f} + recordings * ({serial:.3f} + {work:.3f} / workers)."
    proof = (
        f"For {check['recordings']} recordings and {check['workers']} workers, left out of the fit, it predicts "
        f"{check['predicted_s']:.1f}; measured: {check['measured_s']:.1f}."
    )
    lines = [f"{law} {proof}", "", f"| workers | hours for {PREDICTED:,} such recordings |", "|--:|--:|"]
    for workers in (1, 4, 16, 64, 256):
        seconds = fitted["fixed_s"] + PREDICTED * (serial + work / workers)
        lines.append(f"| {workers} | {seconds / 3600:.2f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
