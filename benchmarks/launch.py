"""How long a run takes to start from the web UI: the fork server against Dagster's own launcher.

Starts a real `dagster-webserver` per launcher on a throw-away instance with ten small assets,
clicks (a GraphQL mutation), and prints when the first step began and when all was done::

    python benchmarks/launch.py [--json FILE]
"""

import argparse
import contextlib
import json
import os
import socket
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

ASSETS = 10
RUNS = 8
DEFINITIONS = f"""
import dagster as dg

recordings = dg.DynamicPartitionsDefinition(name="recordings")


def small_asset(number):
    @dg.asset(name=f"a{{number}}", partitions_def=recordings, deps=[f"a{{number - 1}}"] if number else [])
    def made():
        return dg.MaterializeResult(data_version=dg.DataVersion(str(number)))

    return made


defs = dg.Definitions(assets=[small_asset(n) for n in range({ASSETS})], executor=dg.in_process_executor)
"""
LAUNCHERS = {
    "fork server": "run_launcher: {module: bagassets.defs.launcher, class: BagAssetsRunLauncher}\n",
    "default": "",
}
COORDINATOR = "run_coordinator: {module: dagster._core.run_coordinator, class: DefaultRunCoordinator}\n"
REPOSITORY = {"repositoryLocationName": "timed_definitions", "repositoryName": "__repository__"}
READY = "{ repositoriesOrError { ... on RepositoryConnection { nodes { name } } } }"
REGISTER = """
mutation Register($repository: RepositorySelector!, $key: String!) {
  addDynamicPartition(repositorySelector: $repository, partitionsDefName: "recordings", partitionKey: $key) {
    __typename
  }
}
"""
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


def main() -> None:
    parser = argparse.ArgumentParser(description="Time from the click to the first step, per launcher.")
    parser.add_argument("--json", type=Path, help="write the figures here")
    arguments = parser.parse_args()
    figures = {name: measure(config) for name, config in LAUNCHERS.items()}
    print(
        f"{'launcher':<14}{'first launch':>14}{'click to step':>15}{'one run done':>14}{f'{RUNS} runs done':>14}"
    )
    for name, found in figures.items():
        columns = [("cold", 14), ("step", 15), ("one", 14), ("many", 14)]
        print(f"{name:<14}" + "".join(f"{found[key]:>{width - 2}.2f} s" for key, width in columns))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n", "utf-8")


def measure(launcher: str) -> dict[str, float]:
    """Return seconds from the click to the first step (cold and warm), and until one and many runs are done."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        home = Path(folder)
        (home / "timed_definitions.py").write_text(DEFINITIONS, "utf-8")
        settings = "telemetry: {enabled: false}\n" + COORDINATOR + launcher
        (home / "dagster.yaml").write_text(settings, "utf-8")
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        search = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
        server = subprocess.Popen(
            [sys.executable, "-m", "dagster_webserver", "-m", "timed_definitions", "-p", str(port)],
            cwd=home,
            env={**os.environ, "DAGSTER_HOME": str(home), "PYTHONPATH": search},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            return _measure(f"http://127.0.0.1:{port}/graphql")
        finally:
            server.terminate()
            server.wait()
            _end_fork_servers(home)


def _measure(url: str) -> dict[str, float]:
    _wait_for(url)
    for number in range(RUNS):
        _ask(url, REGISTER, {"repository": REPOSITORY, "key": f"r{number}"})
    cold, _ = _click(url, 1)
    warm = [_click(url, 1) for _ in range(3)]
    _, many = _click(url, RUNS)
    return {
        "cold": cold,
        "step": statistics.median(step for step, _ in warm),
        "one": statistics.median(done for _, done in warm),
        "many": many,
    }


def _click(url: str, count: int) -> tuple[float, float]:
    """Launch runs; return seconds until the first began its first step, and until all were done."""
    start = time.time()
    runs = [_launch(url, f"r{number}") for number in range(count)]
    first, last = [], []
    for run in runs:
        while (found := _ask(url, FOLLOW, {"run": run})["runOrError"])["endTime"] is None:
            time.sleep(0.2)
        if found["status"] != "SUCCESS":
            raise SystemExit(f"run {run}: {found['status']}")
        first.append(min(step["startTime"] for step in found["stepStats"]))
        last.append(found["endTime"])
    return min(first) - start, max(last) - start


def _launch(url: str, key: str) -> str:
    params = {
        "selector": {
            **REPOSITORY,
            "pipelineName": "__ASSET_JOB",
            "assetSelection": [{"path": [f"a{number}"]} for number in range(ASSETS)],
        },
        "executionMetadata": {"tags": [{"key": "dagster/partition", "value": key}]},
    }
    answer = _ask(url, LAUNCH, {"params": params})["launchRun"]
    return str(answer["run"]["runId"])


def _wait_for(url: str) -> None:
    deadline = time.time() + 120
    while time.time() < deadline:
        with contextlib.suppress(OSError):
            if _ask(url, READY, {})["repositoriesOrError"].get("nodes"):
                return
        time.sleep(0.2)
    raise SystemExit("the web server did not start")


def _ask(url: str, query: str, variables: dict[str, Any]) -> Any:
    body = json.dumps({"query": query, "variables": variables}).encode()
    request = urllib.request.Request(url, body, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=120) as answer:
        return json.load(answer)["data"]


def _end_fork_servers(state_folder: Path) -> None:
    for client in Client.all_of(state_folder):
        client.shutdown()


if __name__ == "__main__":
    main()
