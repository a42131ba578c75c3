"""How long it takes from a click in the web UI to the first step and to the end, and from an upload to the dataset.

Starts `bagassets ui` for a project as `bagassets init` makes it, with the shipped `dagster.yaml` and assets, whose
recordings are built. So what a click asks for is known, and the times are those of Dagster, the launcher and the checks
that everything is still there; an upload (a recording is moved into the folder) is real work, of a small drive. For
comparison the same with Dagster's own launcher, which starts a process per run::

    python benchmarks/launch.py [--times 5] [--json benchmarks/results/launch.json]
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
from bagassets.forkserver.client import Client
from bagassets.formats.dataset_build import datasets_of
from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from benchmarks.common import machine
from benchmarks.web_ui import wait_until, web_ui

ROOT = Path(__file__).parents[1]
DRIVE_S = 3.0
SHIPPED, DEFAULT = "as shipped", "Dagster's launcher"
REPOSITORY = {"repositoryLocationName": "bagassets.definitions", "repositoryName": "__repository__"}
ASSETS = "{ assetNodes { assetKey { path } partitionDefinition { name } } }"
LAUNCH = """
mutation Launch($params: ExecutionParams!) {
  launchRun(executionParams: $params) {
    __typename
    ... on LaunchRunSuccess { run { runId } }
    ... on PythonError { message stack }
  }
}
"""
FOLLOW = """
query Follow($run: ID!) { runOrError(runId: $run) { ... on Run { status endTime stepStats { startTime } } } }
"""
FAILURES = """
query Failures($run: ID!) { runOrError(runId: $run) { ... on Run { eventConnection { events {
  ... on RunFailureEvent { message } ... on ExecutionStepFailureEvent { error { message } } } } } } }
"""


def main() -> None:
    parser = argparse.ArgumentParser(description="Time from a click to the first step and to the end.")
    parser.add_argument("--json", type=Path, help="write the figures here")
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--recordings", type=int, default=8, help="how many are clicked at once")
    arguments = parser.parse_args()
    figures: dict[str, Any] = {"recordings": arguments.recordings, "trials": arguments.times, "seconds": {}}
    for launcher in (SHIPPED, DEFAULT):
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            found = measure(Path(folder), launcher, arguments.times, arguments.recordings)
        figures["seconds"][launcher] = found
    print(launch_table(figures), flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps({"machine": machine(), **figures}, indent=1) + "\n", "utf-8")


def launch_table(figures: dict[str, Any]) -> str:
    """Return the table of `launch.json`; medians."""
    launchers = figures["seconds"]
    lines = [f"| | {' | '.join(launchers)} |", "|---|" + "--:|" * len(launchers)]
    for row in launchers[SHIPPED]:
        cells = [
            f"{statistics.median(found[row]):.2f} s" if found.get(row) else "not measured"
            for found in launchers.values()
        ]
        lines.append(f"| {row} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def measure(folder: Path, launcher: str, times: int, number: int) -> dict[str, list[float]]:
    """Return what is measured -> seconds of each time."""
    project, uploads = folder / "project", folder / "uploads"
    write_project(project, sample_recipe())
    # As `bagassets init` leaves it, but for the launcher.
    if launcher == DEFAULT:
        _remove_section(project / "dagster.yaml", "run_launcher:")
    recordings = project / "recordings"
    for seed in range(number):
        write_recordings([Target(recordings / f"drive{seed}.bag", "ros1")], seed, "small", DRIVE_S)
    for upload in range(times):
        write_recordings([Target(uploads / f"upload{upload}.bag", "ros1")], number + upload, "small", DRIVE_S)
    recipe = project / "recipe.yaml"
    subprocess.run(
        [sys.executable, "-m", "bagassets", "build", "--recipe", str(recipe)],
        check=True,
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        with web_ui([sys.executable, "-m", "bagassets"], recipe) as url:
            nodes = _ask(url, ASSETS, {})["assetNodes"]
            assets = [node["assetKey"] for node in nodes if node["partitionDefinition"] is not None]
            first = _click(url, assets, ["drive0.bag"])
            one = [_click(url, assets, ["drive0.bag"]) for _ in range(times)]
            keys = [f"drive{seed}.bag" for seed in range(number)]
            many = [_click(url, assets, keys) for _ in range(times)]
            return {
                "the first click to the first step": [first[0]],
                "click to the first step": [begun for begun, _ in one],
                "click to success, everything known": [done for _, done in one],
                f"{number} clicks at once to the last success": [done for _, done in many],
                "upload to dataset": [
                    _upload(project, recordings, path)
                    for path in sorted(uploads.iterdir())
                    if path.suffix == ".bag"
                ],
            }
    finally:
        for client in Client.all_of(load_recipe(recipe).state):
            client.shutdown(grace_s=1.0)


def _remove_section(file: Path, head: str) -> None:
    """Remove a section of a YAML file: its first line and the indented ones after it."""
    kept, inside = [], False
    for line in file.read_text("utf-8").splitlines(keepends=True):
        inside = line.startswith(head) or (inside and line.startswith(" "))
        if not inside:
            kept.append(line)
    file.write_text("".join(kept), "utf-8")


def _click(url: str, assets: list[dict[str, Any]], keys: list[str]) -> tuple[float, float]:
    """Materialize recordings; return seconds until the first step of any began, and until all runs were done."""
    start = time.time()
    runs = [_launch(url, assets, key) for key in keys]
    first, last = [], []
    for run in runs:
        found = wait_until(lambda run=run: _ended(url, run), f"run {run} ends")
        if found["status"] != "SUCCESS":
            said = _ask(url, FAILURES, {"run": run})["runOrError"]["eventConnection"]["events"]
            raise SystemExit(f"run {run}: {found['status']}: {[event for event in said if event]}")
        first.append(min(step["startTime"] for step in found["stepStats"]))
        last.append(found["endTime"])
    return min(first) - start, max(last) - start


def _launch(url: str, assets: list[dict[str, Any]], key: str) -> str:
    selector = {
        **REPOSITORY,
        "pipelineName": "__ASSET_JOB",
        "assetSelection": [{"path": asset["path"]} for asset in assets],
    }
    params = {
        "selector": selector,
        "executionMetadata": {"tags": [{"key": "dagster/partition", "value": key}]},
    }
    answer = _ask(url, LAUNCH, {"params": params})["launchRun"]
    if answer["__typename"] != "LaunchRunSuccess":
        raise SystemExit(f"the click was refused: {answer}")
    return str(answer["run"]["runId"])


def _ended(url: str, run: str) -> dict[str, Any] | None:
    found: dict[str, Any] = _ask(url, FOLLOW, {"run": run})["runOrError"]
    return None if found["endTime"] is None else found


def _upload(project: Path, recordings: Path, path: Path) -> float:
    """Move a recording into the folder; return seconds until the dataset on disk has it."""
    recipe = load_recipe(project / "recipe.yaml")
    lock = datasets_of(recipe)["nuscenes_dataset"].folder / "dataset.lock.json"
    start = time.time()
    path.rename(recordings / path.name)
    wait_until(lambda: path.name in lock.read_text("utf-8"), f"{path.name} is in the dataset", pause_s=0.02)
    return time.time() - start


def _ask(url: str, query: str, variables: dict[str, Any]) -> Any:
    body = json.dumps({"query": query, "variables": variables}).encode()
    request = urllib.request.Request(f"{url}/graphql", body, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=120) as answer:
        return json.load(answer)["data"]


if __name__ == "__main__":
    main()
