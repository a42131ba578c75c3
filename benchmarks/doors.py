"""The same folder through each door: the command, the sensor, the web UI, `dagster asset materialize` and `dg launch`.

Each door has a new project, and its folder of recordings appears once everything is up: one recording is too short for the
recipe, one cut off, one has no poses, two are equal, one is in two parts; the others are fine. What came of it is compared
with what the command makes: files of the datasets, states, what the web UI shows, reasons::

    python -m benchmarks.doors [--recordings 20] [--json FILE]
    python -m benchmarks.doors --tiny 1000 [--limit 120] [--json FILE]

With `--tiny`, all recordings are fine and as small as can be, and a door that takes longer than the limit is left then: how
long it would have taken follows from the recordings that it made meanwhile. Beside the doors stands what runs cost in plain
Dagster: assets that do nothing, in a backfill of as many partitions as there are recordings, with Dagster's own settings.
`--json` replaces what the file has of the same kind, with `--doors` of the same doors, and keeps the rest.
"""

import argparse
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from itertools import combinations, islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import dagster as dg  # noqa: TID251  (asks for its records, as a user's script would)
from sqlalchemy import text

from bagassets.defs.builds.pending_work import find_pending_work, open_project
from bagassets.defs.records.events import Records
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import add_partitions
from bagassets.engine.build_report import BuildOptions
from bagassets.forkserver.client import Client
from bagassets.store.canonical import digest_json
from bagassets_tests import doors as _doors
from bagassets_tests import services as _services
from bagassets_tests.small_drive import START_NS, write_drive
from benchmarks.common import machine, markdown
from benchmarks.resources import cpu_s_so_far, mark_children
from benchmarks.web_ui import wait_until, web_ui

__all__ = ["doors_table", "tiny_table"]

# Tests have no annotations.
doors: Any = _doors
services: Any = _services
BIN: Path = _services.BIN

COMMAND, PLAIN = "bagassets build", "plain Dagster, empty assets"
_REPOSITORY = {"repositoryName": "__repository__", "repositoryLocationName": "bagassets.definitions"}
_SETTLE_S = 5
_QUIET = 0.15  # of a processor
_LATEST_S = 290.0
_ENDED = {"COMPLETED_SUCCESS", "COMPLETED_FAILED", "FAILED", "CANCELED"}
_ASSETS = "{ assetNodes { assetKey { path } isMaterializable } }"
_BACKFILL = """mutation($params: LaunchBackfillParams!) { launchPartitionBackfill(backfillParams: $params) {
    __typename ... on LaunchBackfillSuccess { backfillId } ... on PythonError { message } } }"""
_RUN = """mutation($params: ExecutionParams!) { launchRun(executionParams: $params) {
    __typename ... on LaunchRunSuccess { run { runId } } ... on PythonError { message } } }"""
_CANCEL = "mutation($id: String!) { cancelPartitionBackfill(backfillId: $id) { __typename } }"
_STATUS = "query($id: String!) { partitionBackfillOrError(backfillId: $id) { ... on PartitionBackfill { status } } }"
_SENSOR = """query($selector: SensorSelector!) { sensorOrError(sensorSelector: $selector) {
    ... on Sensor { sensorState { id } } } }"""
_STOP = "mutation($id: String!) { stopSensor(id: $id) { __typename } }"
# Twelve assets in a row, as a recording has, and one of all of them.
_EMPTY = """
import dagster as dg

parts = dg.DynamicPartitionsDefinition(name="parts")


def empty(number):
    @dg.asset(name=f"a{number}", deps=[f"a{number - 1}"] if number else [], partitions_def=parts)
    def nothing():
        return None

    return nothing


@dg.asset(deps=[dg.AssetDep("a11", partition_mapping=dg.AllPartitionMapping())])
def joined():
    return None


defs = dg.Definitions(assets=[*map(empty, range(12)), joined], executor=dg.in_process_executor)
"""


Began = tuple[float, float]
"""When a door was entered (seconds of the monotonic clock), and the processor time until then (seconds)."""


@dataclass
class Found:
    """What a door came to.

    Attributes:
        seconds: from the first click, command or file to the datasets.
        cpu_s: processor time of all processes meanwhile, without those of the benchmark itself.
        by_hand: clicks on *Launch* or commands that it took.
        runs: runs of Dagster that have ended by themselves.
        events: entries in its event log.
        backfill: how the backfill ended; "" without one.
        made: recordings that are made.
        datasets: a digest of all files of the dataset.
        differs: what is not as the command has it.
    """

    seconds: float = 0.0
    cpu_s: float = 0.0
    by_hand: int = 1
    runs: int = 0
    events: int = 0
    backfill: str = ""
    made: int = 0
    datasets: str = ""
    differs: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Door:
    """A project whose recordings are to be made.

    Attributes:
        recipe: its recipe file.
        bags: the bag root, empty before that; the same for all doors, as reasons name files.
        away: where the recordings are until then.
        keys: their partition keys.
        limit_s: seconds after which the door is left.
    """

    recipe: Path
    bags: Path
    away: Path
    keys: tuple[str, ...]
    limit_s: float

    def appear(self, *, register: bool = True) -> Began:
        """Have all recordings appear at once, and register them if asked to; return when that was."""
        if register:
            with open_project(self.recipe) as workspace:
                instance = workspace.instance
                add_partitions(Records(instance, Naming("test")), self.keys)
        self.bags.rmdir()
        self.away.rename(self.bags)
        return time.monotonic(), cpu_s_so_far()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--recordings", type=int, default=20, help="their number, at least 7 (default 20)")
    parser.add_argument("--tiny", type=int, help="so many tiny ones instead")
    parser.add_argument(
        "--limit", type=float, default=120.0, help="seconds for each door with --tiny (default 120)"
    )
    parser.add_argument(
        "--doors", nargs="+", metavar="NAME", help="only doors whose names begin so, and the command"
    )
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    if options.recordings < len(doors.KEYS) + 1 or (options.tiny is not None and options.tiny < 1):
        parser.error(f"at least {len(doors.KEYS) + 1} recordings, please")
    chosen = {
        name: door
        for name, door in (TINY if options.tiny else ALL).items()
        if (name == COMMAND or options.doors is None or name.startswith(tuple(options.doors)))
        and (name != DG or (BIN / "dg").exists())
    }
    with tempfile.TemporaryDirectory(prefix="doors-", ignore_cleanup_errors=True) as folder:
        source, limit_s = Path(folder) / "recordings", options.limit if options.tiny else _LATEST_S
        keys = write_tiny(source, options.tiny) if options.tiny else write_all(source, options.recordings)
        found = measure(
            Path(folder), source, keys, chosen, limit_s, doors.RECIPE if options.tiny else doors.ALL
        )
    kind = "tiny" if options.tiny else "doors"
    figures = {kind: {"machine": machine(), "recordings": len(keys), "doors": found}}
    print(tiny_table(figures) if options.tiny else doors_table(figures), flush=True)
    if options.json is not None:
        kept = json.loads(options.json.read_text("utf-8")) if options.json.exists() else {}
        if options.doors is not None and kind in kept:
            all_found = {**kept[kind]["doors"], **found}
            figures[kind]["doors"] = {
                name: all_found[name] for name in (TINY if options.tiny else ALL) if name in all_found
            }
        options.json.write_text(json.dumps({**kept, **figures}, indent=1) + "\n", "utf-8")


def doors_table(figures: dict[str, Any]) -> str:
    """Return the table of all doors in `doors.json`."""
    found = figures.get("doors", {}).get("doors", {})
    rows = [
        [
            name,
            str(one["by_hand"]),
            f"{one['runs']:,}",
            f"{one['events']:,}",
            f"{one['seconds']:.0f} s",
            one["backfill"] or "none",
            ", ".join(one["differs"]) or "the same",
        ]
        for name, one in found.items()
    ]
    header = [
        "door",
        "clicks on *Launch*, or commands",
        "runs",
        "events",
        "time",
        "backfill",
        "datasets, states, pages",
    ]
    return markdown(header, rows)


def tiny_table(figures: dict[str, Any]) -> str:
    """Return the table of many tiny recordings in `doors.json`."""
    tiny = figures.get("tiny", {"recordings": 0, "doors": {}})
    number, rows = tiny["recordings"], []
    for name, one in tiny["doors"].items():
        is_over = one["made"] >= number
        seconds = one["seconds"] if is_over else one["seconds"] * number / max(one["made"], 1)
        rows.append(
            [
                name,
                f"{one['made']:,}",
                f"{one['seconds']:.0f} s",
                f"{seconds:.0f} s" if is_over else f"about {seconds:.0f} s",
                f"{one['runs'] / max(one['made'], 1):.2f}",
                f"{one['events'] / max(one['made'], 1):.0f}",
                *([f"{1000 * one['cpu_s'] / max(one['made'], 1):,.0f} ms"] if "cpu_s" in one else []),
            ]
        )
    header = ["door", "recordings made", "in", f"all {number:,}", "runs for each", "events for each"]
    header += ["processor time for each"] if all("cpu_s" in one for one in tiny["doors"].values()) else []
    return markdown(header, rows)


def measure(
    folder: Path,
    source: Path,
    keys: Sequence[str],
    chosen: Mapping[str, Callable[[Door], Found]],
    limit_s: float,
    text: str,
) -> dict[str, Any]:
    """Bring the recordings through each door; return door -> what came of it."""
    mark_children()
    found: dict[str, Any] = {}
    expected: dict[str, Any] = {}
    bags = folder / "bags"
    for number, (name, enter) in enumerate(chosen.items()):
        project = folder / f"door{number}"
        recipe = doors.make_door(project, bags, text.replace("settle_s: 0", f"settle_s: {_SETTLE_S}"))
        bags.mkdir()
        came = enter(Door(recipe, bags, source, tuple(keys), limit_s))
        if name != PLAIN:
            result = doors.result(recipe)
            expected = expected or result
            came.differs = [part for part, value in expected.items() if result[part] != value]
            came.datasets = _digest(result["dataset"])
            came.made = len(result["shown"]["nuscenes_tables"]["made"])
            with open_project(recipe) as workspace:
                instance = workspace.instance
                came.runs, came.events = _runs(instance), _events(instance)
        found[name] = asdict(came)
        print(f"{name}: {found[name]}", flush=True)
        for client in Client.all_of(project / ".bagassets"):
            client.shutdown(grace_s=1.0)
        shutil.rmtree(project, ignore_errors=True)
        if bags.exists() and not source.exists():
            bags.rename(source)
        else:
            bags.rmdir()
    return found


def write_all(folder: Path, number: int) -> list[str]:
    """Write every kind of recording, and fine ones until there are so many; return the partition keys."""
    doors.write_recordings(folder)
    more = [f"drive_of_day_{chr(ord('a') + one)}.bag" for one in range(number - len(doors.KEYS))]
    for one, name in enumerate(more):
        write_drive(folder / name, "ros1", duration_s=1.2 + 0.1 * one)
    return sorted({*doors.KEYS, *more})


def write_tiny(folder: Path, number: int) -> list[str]:
    """Write tiny recordings, each without two other messages of its poses; return the partition keys."""
    left_out = islice(combinations(range(2, 48), 2), number)
    names = [f"{one:04}.bag" for one in range(number)]
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        list(pool.map(_write_tiny, [folder / name for name in names], left_out, chunksize=10))
    return names


def _write_tiny(path: Path, left_out: tuple[int, int]) -> None:
    missing = {START_NS + 20_000_000 * one for one in left_out}
    write_drive(path, "ros1", 1.0, lambda topic, stamp_ns: topic != "/odom" or stamp_ns not in missing)


# --- doors -----------------------------------------------------------------------------------


def by_command(door: Door) -> Found:
    """Run `bagassets build`."""
    began = door.appear(register=False)
    _run(door, [BIN / "bagassets", "build", "--recipe", door.recipe])
    return _found(began)


def by_sensor(door: Door) -> Found:
    """Copy the recordings into the folder, where the sensor of `bagassets ui` finds them."""
    with web_ui([BIN / "bagassets"], door.recipe):
        _wait_until_quiet()
        began = door.appear(register=False)
        _wait(lambda: _is_done(door), door)
        return _found(began, by_hand=0)


def by_web_ui(door: Door) -> Found:
    """Materialize all in `bagassets ui`, with the sensor switched off."""
    with web_ui([BIN / "bagassets"], door.recipe) as url:
        _stop_sensor(url)
        return _materialize_all(door, url)


def beside_sensor(door: Door) -> Found:
    """Materialize all in `bagassets ui`, with the sensor on, which makes the datasets if Dagster requests none."""
    with web_ui([BIN / "bagassets"], door.recipe) as url:
        return _materialize_all(door, url, has_sensor=True)


def by_dagster_dev(door: Door) -> Found:
    """Materialize all in `dagster dev`, with the sensor switched off."""
    project, port = door.recipe.parent, services.free_port()
    url = f"http://127.0.0.1:{port}"
    with services.running([BIN / "dagster", "dev", "-p", port], project, project / "dev.log"):
        wait_until(lambda: _ask(url, "{ version }"), "`dagster dev` answers")
        _stop_sensor(url)
        return _materialize_all(door, url)


def by_materialize(door: Door) -> Found:
    """Run `dagster asset materialize` for each recording, and for the datasets."""
    began = door.appear(register=False)
    common = [BIN / "dagster", "asset", "materialize", "-m", "bagassets.definitions", "--select"]
    for key in door.keys:
        _run(door, [*common, "group:recording", "--partition", key])
    _run(door, [*common, "dataset_inputs*"])
    return _found(began, by_hand=len(door.keys) + 1)


def by_range(door: Door) -> Found:
    """Run `dagster asset materialize` once, for all recordings from the first to the last and the datasets."""
    began = door.appear(register=False)
    common = [BIN / "dagster", "asset", "materialize", "-m", "bagassets.definitions", "--select", "*"]
    _run(door, [*common, "--partition-range", f"{door.keys[0]}...{door.keys[-1]}"])
    return _found(began)


def by_dg(door: Door) -> Found:
    """Run `dg launch` for each recording, and for the datasets."""
    began = door.appear(register=False)
    for key in door.keys:
        _run(door, [BIN / "dg", "launch", "--assets", "group:recording", "--partition", key])
    _run(door, [BIN / "dg", "launch", "--assets", "dataset_inputs*"])
    return _found(began, by_hand=len(door.keys) + 1)


def by_plain_dagster(door: Door) -> Found:
    """Materialize as many partitions of assets that do nothing, with `dagster dev` as it comes."""
    home, port = door.recipe.parent / "plain", services.free_port()
    home.mkdir()
    (home / "empty.py").write_text(_EMPTY, "utf-8")
    (home / "dagster.yaml").write_text("telemetry: {enabled: false}\n", "utf-8")
    url, environment = f"http://127.0.0.1:{port}", {"DAGSTER_HOME": str(home)}
    command = [BIN / "dagster", "dev", "-m", "empty", "-p", port]
    with (
        services.running(command, home, home / "dev.log", environment),
        dg.DagsterInstance.from_config(str(home)) as instance,
    ):
        wait_until(lambda: _ask(url, "{ version }"), "`dagster dev` answers")
        instance.add_dynamic_partitions("parts", list(door.keys))
        _wait_until_quiet()
        began = time.monotonic(), cpu_s_so_far()
        status = _backfill(door, url, began[0])
        found = _found(began)
        found.runs, found.events, found.backfill = _runs(instance), _events(instance), status
        found.made = len(instance.get_materialized_partitions(dg.AssetKey("a11")))
        return found


DG = "`dg launch`, each, and the datasets"
ALL = {
    COMMAND: by_command,
    "sensor": by_sensor,
    "*Materialize all* in `bagassets ui`": by_web_ui,
    "*Materialize all* in `bagassets ui`, beside the sensor": beside_sensor,
    "*Materialize all* in `dagster dev`": by_dagster_dev,
    "`dagster asset materialize`, each, and the datasets": by_materialize,
    "`dagster asset materialize`, a range": by_range,
    DG: by_dg,
    PLAIN: by_plain_dagster,
}
TINY = {
    COMMAND: by_command,
    "sensor": by_sensor,
    "*Materialize all* in `bagassets ui`": by_web_ui,
    PLAIN: by_plain_dagster,
}


# --- what doors share ------------------------------------------------------------------------


def _materialize_all(door: Door, url: str, *, has_sensor: bool = False) -> Found:
    _wait_until_quiet()
    began = door.appear()
    status, by_hand = _backfill(door, url, began[0]), 1
    if status == "COMPLETED_FAILED" and not has_sensor:
        _launch(
            url,
            _materializable(url, "dataset_inputs", "nuscenes_dataset", "vision_dataset", "trajectory_map"),
        )
        by_hand += 1
    if status != "CANCELED":
        _wait(lambda: _is_done(door), door)
    return replace(_found(began, by_hand), backfill=status)


def _found(began: Began, by_hand: int = 1) -> Found:
    return Found(time.monotonic() - began[0], cpu_s_so_far() - began[1], by_hand)


def _wait_until_quiet() -> None:
    """Return once servers have started, and prepared what they can."""
    before, now = -_QUIET, cpu_s_so_far()
    while now - before >= _QUIET:
        time.sleep(1.0)
        before, now = now, cpu_s_so_far()


def _backfill(door: Door, url: str, began: float) -> str:
    """Launch a backfill of all assets and recordings; return how it ended, cancelled if it took too long."""
    params = {"partitionNames": list(door.keys), "assetSelection": _materializable(url), "fromFailure": False}
    launched, status = _ask(url, _BACKFILL, params=params)["launchPartitionBackfill"], ""
    if launched["__typename"] != "LaunchBackfillSuccess":
        raise SystemExit(f"the backfill was refused: {launched}")
    backfill = launched["backfillId"]
    while status not in _ENDED and time.monotonic() - began < door.limit_s:
        time.sleep(0.2)
        status = _ask(url, _STATUS, id=backfill)["partitionBackfillOrError"]["status"]
    if status not in _ENDED:
        _ask(url, _CANCEL, id=backfill)
        return "CANCELED"
    return str(status)


def _materializable(url: str, *names: str) -> list[dict[str, Any]]:
    nodes = [node for node in _ask(url, _ASSETS)["assetNodes"] if node["isMaterializable"]]
    return [node["assetKey"] for node in nodes if not names or node["assetKey"]["path"][-1] in names]


def _launch(url: str, assets: list[dict[str, Any]]) -> None:
    params = {"selector": {**_REPOSITORY, "pipelineName": "__ASSET_JOB", "assetSelection": assets}}
    launched = _ask(url, _RUN, params=params)["launchRun"]
    if launched["__typename"] != "LaunchRunSuccess":
        raise SystemExit(f"the run was refused: {launched}")


def _stop_sensor(url: str) -> None:
    selector = {**_REPOSITORY, "sensorName": "recordings"}
    sensor = wait_until(lambda: _ask(url, _SENSOR, selector=selector)["sensorOrError"], "the sensor is known")
    _ask(url, _STOP, id=sensor["sensorState"]["id"])


def _is_done(door: Door) -> bool:
    """Return whether all recordings are registered, no run is active, and the datasets are of all of them."""
    busy = [
        status
        for status in dg.DagsterRunStatus
        if status.value in ("QUEUED", "NOT_STARTED", "STARTING", "STARTED")
    ]
    with open_project(door.recipe) as workspace:
        instance = workspace.instance
        if instance.get_runs_count(dg.RunsFilter(statuses=busy)):
            return False
        pending = find_pending_work(workspace, BuildOptions())
        bags = pending.plan.bags
        return (
            bags.keys() == set(door.keys)
            and not any(bag.to_run() for bag in bags.values())
            and pending.dataset_is_current
        )


def _wait(condition: Callable[[], bool], door: Door) -> None:
    """Wait until something holds; with a limit, no longer than that."""
    until = time.monotonic() + door.limit_s
    while not condition() and time.monotonic() < until:
        time.sleep(0.5)


def _run(door: Door, command: Sequence[object]) -> None:
    """Run a command in the project folder, whatever it ends with: a recording that cannot be made is an error."""
    with (door.recipe.parent / "command.log").open("ab") as log:
        subprocess.run(
            [str(part) for part in command],
            check=False,
            cwd=door.recipe.parent,
            env=services.bare_environment(),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
        )


def _runs(instance: dg.DagsterInstance) -> int:
    """Return how many runs have ended by themselves; those of a backfill that was left may still be queued."""
    ended = [dg.DagsterRunStatus.SUCCESS, dg.DagsterRunStatus.FAILURE]
    return instance.get_runs_count(dg.RunsFilter(statuses=ended))


def _events(instance: dg.DagsterInstance) -> int:
    storage: Any = instance.event_log_storage
    with storage.index_connection() as connection:
        return int(connection.execute(text("SELECT count(*) FROM event_logs")).scalar())


def _digest(files: dict[str, bytes]) -> str:
    return digest_json(sorted([path, content.hex()] for path, content in files.items()))


def _ask(url: str, query: str, **variables: Any) -> Any:
    body = json.dumps({"query": query, "variables": variables}).encode()
    request = urllib.request.Request(f"{url}/graphql", body, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=120) as answer:
        found = json.load(answer)
    if "errors" in found:
        raise SystemExit(f"Dagster refuses {query}: {found['errors']}")
    return found["data"]


if __name__ == "__main__":
    main()
