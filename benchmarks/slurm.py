"""What runs cost on Slurm: beside the local fork server, from submission to the first step, and for how many recordings.

Starts a real Slurm on this machine (root only), whose nodes share its processors, and PostgreSQL for the records::

    python -m benchmarks.slurm [--json benchmarks/results/slurm.json] [--many 300]

A model of the time is fitted to builds of some numbers of recordings with one worker and with two, and compared with the
largest of them, which is left out of the fit.
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
from typing import Any

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).parents[1]))
from bagassets.defs.runs import open_instance
from bagassets.forkserver.client import Client
from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets_tests import small_drive
from bagassets_tests.in_process import QUICK
from bagassets_tests.postgres_server import Postgres, running_postgres, use_postgres
from bagassets_tests.slurm_cluster import running_cluster
from benchmarks.common import machine

DRIVE_S = 1.0
NUMBERS, WORKERS = (5, 10, 20, 40), (1, 2)
LEFT_OUT = (40, 2)
PREDICTED = 10_000


def main() -> None:
    parser = argparse.ArgumentParser(description="Cost of runs on Slurm.")
    parser.add_argument("--json", type=Path, help="write the figures here")
    parser.add_argument(
        "--many", type=int, default=300, help="recordings of the largest build; 0 leaves it out"
    )
    parser.add_argument("--numbers", type=int, nargs="+", default=list(NUMBERS))
    arguments = parser.parse_args()
    found: dict[str, Any] = {"machine": machine(), "builds": []}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True, prefix="bagassets-") as folder:
        work = Path(folder)
        with running_cluster() as cluster, running_postgres() as postgres:
            os.environ |= cluster.environment
            found["one"] = one_run(work, postgres)
            for number in arguments.numbers:
                for workers in WORKERS:
                    seconds = on_slurm(work / f"s{number}-{workers}", number, workers, postgres)
                    found["builds"].append({"recordings": number, "workers": workers, "seconds": seconds})
                    print(found["builds"][-1], flush=True)
            largest = max(arguments.numbers)
            found["local"] = {
                "recordings": largest,
                "workers": 2,
                "seconds": locally(work / "local", largest, postgres),
            }
            print(found["local"], flush=True)
            if arguments.many:
                seconds = on_slurm(work / "many", arguments.many, 2, postgres)
                found["many"] = {"recordings": arguments.many, "workers": 2, "seconds": seconds}
    found["model"] = model(found["builds"], (largest, 2))
    print(slurm_table(found), flush=True)
    print(scaling_table(found), flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n", "utf-8")


def make(folder: Path, number: int, postgres: Postgres, **launcher: Any) -> Path:
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
    subprocess.run(
        [
            "psql",
            "--host",
            str(postgres.folder),
            "--port",
            "5439",
            "--username",
            "postgres",
            "-q",
            "-c",
            f"CREATE DATABASE {name}",
        ],
        check=True,
    )
    use_postgres(recipe_file, postgres.url.replace("/dagster?", f"/{name}?"))
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
    share = -(-number // workers)
    return build(make(folder, number, postgres, cpus=1, runs_per_job=share), number)


def locally(folder: Path, number: int, postgres: Postgres) -> float:
    """Return how long the same build takes on the fork server, with two workers."""
    return build(make(folder, number, postgres), number, "--jobs", "2")


def one_run(work: Path, postgres: Postgres) -> dict[str, float]:
    """Return where the time goes from the submission of one run to its first step, in seconds."""
    recipe_file = make(work / "one", 1, postgres, cpus=1)
    build(recipe_file, 1)
    spool = load_recipe(recipe_file).state / "slurm"
    with open_instance(str(recipe_file.parent)) as instance:
        (run,) = (run for run in instance.get_runs() if "dagster/partition" in run.tags)
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
    rows = [("Slurm", one) for one in found["builds"]]
    rows += [("fork server", found["local"])] + ([("Slurm", found["many"])] if "many" in found else [])
    lines += [
        f"| {one['recordings']} | {one['workers']} | {name} | {one['seconds']:.1f} |" for name, one in rows
    ]
    lines += ["", "| from submission to the first step | seconds |", "|---|--:|"]
    lines += [f"| {name} | {seconds:.2f} |" for name, seconds in found["one"].items()]
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
