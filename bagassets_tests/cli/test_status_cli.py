"""`bagassets status`, `explain`, `build --dry-run` and `--check` on a real project."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from rich.console import Console

from bagassets.cli import summary
from bagassets.cli.explain import _action_lines
from bagassets.cli.main import root
from bagassets.cli.summary import print_summary
from bagassets.defs.records.events import Records, all_assets, event_database
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.engine.build_report import BuildReport, SummaryRow
from bagassets_tests.in_process import QUICK, build, make_project, survey

pytestmark = pytest.mark.once

GOOD, SHORT, BROKEN = "a.bag", "b.mcap", "c.bag"
ALL_WELL, FAILED, USAGE, STALE = 0, 1, 2, 3
MIN_DURATION = "settle_s: 0, min_duration_s: 1.5"


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """One recording that is fine, one that is skipped, one that fails; all dealt with."""
    folder = tmp_path_factory.mktemp("status")
    recipe_file = make_project(
        folder, [GOOD], text=QUICK.replace("settle_s: 0", MIN_DURATION), duration_s=2.0
    )
    make_project(folder / "short", [SHORT], duration_s=1.0)
    (folder / "short" / "bags" / SHORT).rename(folder / "bags" / SHORT)
    (folder / "bags" / BROKEN).write_bytes(b"#ROSBAG V2.0\n" + b"x" * 100)
    return recipe_file


@pytest.fixture
def built(project, monkeypatch):
    build(project, monkeypatch)
    return project


@pytest.fixture
def edited(built):
    """The project with another JPEG quality in its recipe."""
    text = built.read_text()
    built.write_text(text.replace("topic: /cam/image_raw", "topic: /cam/image_raw, quality: 33"))
    yield built
    built.write_text(text)


def run(*args, recipe):
    return CliRunner().invoke(root, [*map(str, args), "--recipe", str(recipe)])


def output(*args, recipe):
    done = run(*args, "--json", recipe=recipe)
    return done.exit_code, json.loads(done.stdout)


def test_a_new_recording_is_missing_and_makes_ci_fail(project):
    # Before anything was built; the module's first test.
    code, value = output("status", recipe=project)
    assert code == STALE
    assert {s["state"] for s in value["recordings"][GOOD]["assets"].values()} == {"missing"}
    assert value["recordings"][GOOD]["registered"] is False
    assert run("build", "--check", recipe=project).exit_code == STALE


def test_after_a_build_every_state_has_its_reason(built):
    code, value = output("status", recipe=built)
    assert code == FAILED, "nothing to do, but one recording failed"
    states = {key: {n: s["state"] for n, s in r["assets"].items()} for key, r in value["recordings"].items()}
    assert set(states[GOOD].values()) == {"fresh"}
    assert states[SHORT]["bag"] == states[SHORT]["inventory"] == "fresh"
    assert {state for name, state in states[SHORT].items() if name not in {"bag", "inventory"}} == {"skipped"}
    assert "bags.min_duration_s asks for 1.5" in value["recordings"][SHORT]["assets"]["frames"]["reason"]
    broken = value["recordings"][BROKEN]["assets"]
    assert broken["inventory"]["state"] == "failed"
    assert "rosbag reindex" in broken["inventory"]["reason"]
    assert broken["nuscenes_tables"]["state"] == "unknown"
    assert broken["nuscenes_tables"]["reason"].startswith("waits for inventory — ")
    assert value["datasets"] == {"nuscenes_dataset": "fresh"}


@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-", pytest.param("2>&-", marks=pytest.mark.long)])
def test_a_closed_stream_is_no_defect(built, closed):
    """The shell closes it; whatever is opened next would have its number."""
    command = [sys.executable, "-m", "bagassets", "status", "--recipe", str(built)]
    shell = ["sh", "-c", f'exec "$@" {closed}', "sh"]
    whole = subprocess.run(command, capture_output=True, text=True, check=False)
    done = subprocess.run([*shell, *command], capture_output=True, text=True, check=False)
    assert done.returncode == whole.returncode == FAILED
    assert done.stdout == (whole.stdout if ">&-" not in closed.split() else "")
    assert done.stderr == ""


@pytest.mark.parametrize("command", [["status"], ["build", "-n"], ["check"]])
def test_long_plans_say_how_far_they_are(edited, monkeypatch, command):
    monkeypatch.setattr("bagassets.engine.planner.AT_A_TIME", 1)
    assert run(*command, recipe=edited).stderr.startswith("Planned 1 of 3 recordings\n")


def test_the_table_names_reasons_once(built):
    done = run("status", recipe=built)
    assert done.exit_code == FAILED
    assert f"{SHORT}: all but bag and inventory skipped: 1.0 s long" in done.stdout
    assert "3 recordings: " in done.stdout
    assert "1 failed" in done.stdout.splitlines()[-1]


def test_in_a_narrow_terminal_no_letter_is_lost(built, monkeypatch):
    wide = run("status", "--bag", GOOD, recipe=built).stdout
    monkeypatch.setattr(summary, "summary_console", lambda: Console(highlight=False, width=30))
    narrow = run("status", "--bag", GOOD, recipe=built).stdout
    assert wide.endswith("assets of 1 recording: 8 fresh.\n")
    assert narrow.count("fresh") == wide.count("fresh")


def test_nor_in_the_table_of_a_build(capsys):
    counts = {"images": 240, "sweeps": 200, "poses": 1000, "boxes": 300, "scenes": 1, "keyframes": 40}
    rows = [SummaryRow(f"drive_{n}.bag", "ros1", 20.0, counts, "built", "") for n in (1, 2)]
    print_summary(
        BuildReport(None, {}), rows, Path("recipe.yaml"), Console(highlight=False, width=60, file=sys.stdout)
    )
    lines = capsys.readouterr().out.splitlines()
    for text in ("drive_1.b", "drive_2.b", "ros1", "20.0 s", "240", "1000", "300", "40 built"):
        assert any(text in line for line in lines), f"{text} in {lines}"


def test_a_dataset_that_nothing_can_be_part_of_is_not_called_fresh(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path, [])
    (tmp_path / "bags").mkdir()
    (tmp_path / "bags" / BROKEN).write_bytes(b"#ROSBAG V2.0\n" + b"x" * 100)
    report, _ = build(recipe_file, monkeypatch)
    assert report.dataset == "not made"
    code, value = output("status", recipe=recipe_file)
    assert code == FAILED
    assert value["datasets"] == {"nuscenes_dataset": "blocked"}
    why = "never made, as no recording can be part of it yet"
    assert f"nuscenes_dataset blocked: {why}\n" in run("status", recipe=recipe_file).stdout
    shown = run("build", "--dry-run", recipe=recipe_file).stdout
    assert f"nuscenes_dataset\n  waits    {why}\nnothing to do:" in shown
    _, runs = build(recipe_file, monkeypatch)
    assert runs == [], "nothing runs again and again"


def test_many_recordings_in_the_same_states_share_a_row(edited, monkeypatch):
    monkeypatch.setattr("bagassets.cli.status.MOST_ROWS", 1)
    new = [edited.parent / "bags" / name for name in ("d.bag", "e.bag", "f.bag", "g.bag")]
    for path in new:
        shutil.copy(path.with_name(BROKEN), path)
    shown = run("status", recipe=edited).stdout
    every = run("status", "--all", recipe=edited).stdout.splitlines()
    for path in new:
        path.unlink()
    (row,) = (line for line in shown.splitlines() if line.startswith(" 4 recordings (d.bag,"))
    assert set(row.split()[-8:]) == {"missing"}
    assert sum(line.startswith(f" {GOOD} ") for line in shown.splitlines()) == 1
    assert [line.split()[0] for line in every if line.split() and line.split()[-1] == "missing"][:4] == [
        "d.bag", "e.bag", "f.bag", "g.bag"
    ]  # fmt: skip


def test_reasons_lead_back_to_what_changed_first(edited):
    code, value = output("status", "--bag", GOOD, recipe=edited)
    assert code == STALE
    assets = value["recordings"][GOOD]["assets"]
    assert (assets["frames"]["state"], assets["frames"]["reason"]) == ("stale", "CAM_FRONT: quality 90 -> 33")
    tables = assets["nuscenes_tables"]
    assert tables["state"] == "unknown"
    assert tables["reason"] == "waits for frames — CAM_FRONT: quality 90 -> 33"
    assert assets["sweeps"]["state"] == "fresh"
    told = [
        line for line in run("status", "--bag", GOOD, recipe=edited).stdout.splitlines() if "90 -> 33" in line
    ]
    assert told == [f"{GOOD}: frames stale: CAM_FRONT: quality 90 -> 33"], (
        "what waits for it need not repeat it"
    )


def test_that_all_recordings_are_gone_is_said_as_the_build_takes_it(built):
    bags, away = built.parent / "bags", built.parent / "away"
    bags.rename(away)
    bags.mkdir()
    try:
        shown = run("status", recipe=built).stdout
        planned = run("build", "--dry-run", recipe=built).stdout
    finally:
        bags.rmdir()
        away.rename(bags)
    then = "the next build, with --allow-empty, removes its partition and its scenes"
    assert f"{GOOD}: the recording is gone; {then}\n" in shown
    assert (
        f"{GOOD}\n  is gone: its partition and scenes would be removed with --allow-empty only\n" in planned
    )


def test_a_dry_run_runs_nothing_and_shows_what_would(edited):
    with open_instance(str(edited.parent)) as instance:
        before = (
            Records(instance, Naming("test")).latest_ids(all_assets()),
            event_database(instance).stat().st_size,
        )
    done = run("build", "--dry-run", recipe=edited)
    assert done.exit_code == ALL_WELL
    lines = [line.split() for line in done.stdout.splitlines()]
    assert ["run", "frames", "CAM_FRONT:", "quality", "90", "->", "33"] in lines
    assert ["may", "run", "nuscenes_tables", "waits", "for", "frames"] in lines, "the cause stands above"
    assert "failed before and is not retried" in done.stdout
    code, value = output("build", "-n", recipe=edited)
    assert code == ALL_WELL
    assert value["settled"] is False
    assert list(value["recordings"]) == [GOOD, SHORT]  # that skips are of this recipe is recorded, too
    with open_instance(str(edited.parent)) as instance:
        assert (
            Records(instance, Naming("test")).latest_ids(all_assets()),
            event_database(instance).stat().st_size,
        ) == before


def test_a_check_looks_only_at_what_is_asked_for(edited):
    assert run("build", "--check", recipe=edited).exit_code == STALE
    assert run("build", "--check", "--select", "sweeps", "--bag", GOOD, recipe=edited).exit_code == ALL_WELL
    assert run("build", "--check", "--select", "frames", "--bag", "a*", recipe=edited).exit_code == STALE
    assert run("build", "--check", "--bag", BROKEN, "--select", "bag", recipe=edited).exit_code in {0, FAILED}


def test_selecting_assets_runs_them_and_what_they_read(edited, monkeypatch):
    report, runs = build(edited, monkeypatch, bags=(GOOD,), select=("frames",))
    assert runs == [(GOOD, ("bag", "inventory", "calibration", "frames"))]
    assert report.outcomes.keys() == {GOOD}
    assert report.outcomes[GOOD].result == "built"
    assert report.dataset == "not selected"
    after = survey(edited)
    assert after.plan.bags[GOOD].assets["frames"].state == "fresh"
    assert after.todo[GOOD], "its tables are still to be made"


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["build", "--check", "--bag", "nothing"], "no such recording"),
        (["build", "-n", "--bag", "a.bog"], "did you mean a.bag"),
        (["build", "-n", "--select", "frame"], "did you mean frames"),
        (["status", "--bag", "z*"], "no such recording"),
        (["explain", "nothing", "frames"], "no such recording"),
        (["explain", GOOD, "nothing"], "no such asset"),
        (["explain"], "name an asset: bag, inventory, "),
        (["explain", "frame"], "frame: no such asset; did you mean frames?"),
        (["explain", "a.*"], "a.* is a recording; name one of its assets, too: bag, inventory, "),
        (["explain", GOOD], f"{GOOD} is a recording; name one of its assets, too: bag, inventory, "),
        (["explain", "*", "frames"], "matches 3 recordings"),
        (["build", "--jobs", "0"], "0 is not in the range"),
    ],
)
def test_what_does_not_exist_is_wrong_usage(built, arguments, word):
    done = run(*arguments, recipe=built)
    assert done.exit_code == USAGE
    assert word in done.stderr


@pytest.mark.parametrize("bag", [GOOD, "a.*", "bags/a.bag"])
def test_a_recording_may_be_named_by_key_glob_or_path(built, bag, monkeypatch):
    monkeypatch.chdir(built.parent)
    code, value = output("status", "--bag", bag, recipe=built)
    assert (code, list(value["recordings"])) == (ALL_WELL, [GOOD])


def test_more_jobs_than_make_sense_are_lowered_with_a_word(built, monkeypatch):
    monkeypatch.setattr("bagassets.cli.build.os.cpu_count", lambda: 2)
    done = run("build", "--jobs", "500", "--check", recipe=built)
    assert "this machine has 2 processors; using 4" in done.stderr


def test_explain_shows_both_actions_and_marks_what_differs(edited):
    done = run("explain", GOOD, "frames", recipe=edited)
    assert done.exit_code == ALL_WELL
    marked = [line.strip() for line in done.stdout.splitlines() if line.startswith("  * ")]
    assert "* param quality: 90 -> 33" in marked
    assert [line.split(":")[0] for line in marked] == [
        "* data version",
        "* code version",
        "* digest",
        "* param quality",
    ]
    assert "    input topic:/cam/image_raw: " in done.stdout
    _, value = output("explain", GOOD, "frames", recipe=edited)
    (pair,) = value["actions"]
    assert pair["channel"] == "CAM_FRONT"
    assert pair["changes"] == [{"group": "params", "name": "quality", "before": 90, "now": 33}]
    assert pair["now"]["digest"] != pair["last"]["digest"]
    assert pair["now"]["inputs"] == pair["last"]["inputs"]


def test_explain_shows_what_is_in_an_object_and_not_that_it_was_empty():
    action = {"step": "annotations", "version": 1, "libraries": {}, "inputs": {}}
    empty = {**action, "params": {"labels": {}, "tf": [], "files": {}}}
    filled = {**action, "params": {"labels": {"boxes.json": "a1", "more": {}}, "tf": ["/tf"], "files": {}}}
    told = [
        [
            line.strip()
            for line in _action_lines({"channel": None, "last": last, "now": now})
            if "param" in line
        ]
        for last, now in ((empty, filled), (filled, empty))
    ]
    assert told == [
        [
            "param files: {}",
            "* param labels.boxes.json: a1 (new)",
            "* param labels.more: {} (new)",
            '* param tf: [] -> ["/tf"]',
        ],
        [
            "param files: {}",
            "* param labels.boxes.json: a1 -> none",
            "* param labels.more: {} -> none",
            '* param tf: ["/tf"] -> []',
        ],
    ]


def test_explain_puts_no_parentheses_into_others(edited):
    for key, asset in (
        (GOOD, "nuscenes_tables"),
        (BROKEN, "inventory"),
        (BROKEN, "nuscenes_tables"),
        (SHORT, "frames"),
    ):
        lines = run("explain", key, asset, recipe=edited).stdout.splitlines()
        expected = "has failed: " if (key, asset) == (BROKEN, "inventory") else "is "
        assert lines[0].startswith(f"{asset} of {key} {expected}")
        assert not [line for line in lines if re.search(r"\([^)]*\(", line)]


def test_a_dataset_says_which_result_it_waits_for(edited):
    assert output("status", recipe=edited)[1]["dataset_reasons"] == {
        "nuscenes_dataset": f"waits for nuscenes_tables of {GOOD}"
    }
    assert (
        f"nuscenes_dataset unknown: waits for nuscenes_tables of {GOOD}\n"
        in run("status", recipe=edited).stdout
    )
    done = run("build", "-n", recipe=edited)
    assert f"nuscenes_dataset\n  may run  waits for nuscenes_tables of {GOOD}\n" in done.stdout
    assert (
        done.stdout.splitlines()[-1]
        == "to do: build 1 recording, record 1 skipped recording, update nuscenes_dataset."
    )


def test_a_recording_that_takes_part_again_is_named(built):
    text = built.read_text()
    built.write_text(text.replace("min_duration_s: 1.5", "min_duration_s: 0.5"))
    _, value = output("status", recipe=built)
    dry = run("build", "-n", recipe=built).stdout
    whole = run("explain", "nuscenes_dataset", recipe=built).stdout.splitlines()
    built.write_text(text)
    why = f"its recordings changed since it was made; waits for nuscenes_tables of {SHORT}"
    assert value["dataset_reasons"] == {"nuscenes_dataset": why}
    assert f"nuscenes_dataset\n  run      {why}\n" in dry
    assert whole[0] == f"nuscenes_dataset is stale: {why}"
    assert [line.split(" (")[0] for line in whole[-2:]] == [
        f"left out: {BROKEN}", f"no longer left out: {SHORT}"
    ]  # fmt: skip


def test_what_has_no_part_in_a_dataset_leaves_it_fresh(built):
    text = built.read_text()
    built.write_text(text.replace("preview: {enabled: false}", ""))
    code, value = output("status", recipe=built)
    mapped = run("explain", GOOD, "trajectory_map", recipe=built).stdout
    whole = run("explain", "trajectory_map", recipe=built).stdout.splitlines()
    last_line = run("build", "-n", recipe=built).stdout.splitlines()[-1]
    built.write_text(text)
    assert value["recordings"][GOOD]["assets"]["preview"]["state"] == "missing"
    assert value["datasets"] == {"nuscenes_dataset": "fresh", "trajectory_map": "missing"}
    assert (code, value["dataset_reasons"]) == (STALE, {"trajectory_map": "never made"})
    assert mapped.startswith("trajectory_map is missing: never made\n")
    assert f"made from ego_poses of 1 recording\n    {GOOD}: " in mapped
    assert [line.split(" (")[0] for line in whole[-2:]] == [f"left out: {SHORT}", f"left out: {BROKEN}"]
    assert last_line == "to do: build 1 recording, record 1 skipped recording, update trajectory_map."


def test_explain_says_what_a_dataset_is_made_from(edited, monkeypatch):
    assert run("explain", "frames", recipe=edited).exit_code == USAGE
    waiting = run("explain", "nuscenes_dataset", recipe=edited).stdout.splitlines()
    assert waiting[0] == f"nuscenes_dataset is unknown: waits for nuscenes_tables of {GOOD}"
    assert "made from nuscenes_tables of 1 recording, 1 as before" in waiting
    assert [line.split(" (")[0] for line in waiting[-2:]] == [f"left out: {SHORT}", f"left out: {BROKEN}"]
    build(edited, monkeypatch, select=("nuscenes_tables",))
    whole = run("explain", "nuscenes_dataset", recipe=edited).stdout
    assert whole.startswith("nuscenes_dataset is stale: its recordings changed since it was made\n")
    assert re.search(rf"^  \* {GOOD}: \w{{16}} -> \w{{16}}$", whole, re.MULTILINE)
    one = run("explain", GOOD, "nuscenes_dataset", recipe=edited).stdout
    assert f"  * {GOOD}: " in one
    assert SHORT not in one
    _, value = output("explain", SHORT, "nuscenes_dataset", recipe=edited)
    assert list(value["left_out"]) == list(value["recordings"]) == [SHORT]


def test_named_datasets_are_explained_and_named_at_the_end_of_a_build(built, monkeypatch, capsys):
    text = built.read_text()
    named = text + "datasets: [{name: all, min_speed_mps: 0.0}, {name: fast, min_speed_mps: 99.0}]\n"
    built.write_text(named)
    fast = run("explain", "dataset_fast", recipe=built).stdout
    report, _ = build(built, monkeypatch)
    again, _ = build(built, monkeypatch)
    made = [run("explain", name, recipe=built).stdout for name in ("dataset_all", "dataset_fast")]
    built.write_text(text)
    assert fast.startswith("dataset_fast is missing: never made\n")
    assert f"  * {GOOD}: " in fast
    assert "1 as before" in made[0]
    assert f"left out: {GOOD} (" in made[1]
    names = ["nuscenes_dataset", "dataset_all", "dataset_fast"]
    assert [(name, one["state"]) for name, one in report.datasets.items()] == [
        (name, "updated") for name in names
    ]
    assert {one["state"] for one in again.datasets.values()} == {"fresh"}
    print_summary(BuildReport.from_json(report.as_json()), [], built)
    printed = capsys.readouterr().out
    assert [
        one for one in report.datasets.values() if f"dataset: {one['path']} (updated)\n" not in printed
    ] == []


def test_explain_says_what_is_not_known_yet(edited):
    edited.write_text(edited.read_text().replace("quality: 33", "quality: 34"))  # never built
    done = run("explain", GOOD, "nuscenes_tables", recipe=edited)
    assert "the current one is not known yet" in done.stdout
    assert " * param" not in done.stdout, "nothing to compare with"
    done = run("explain", SHORT, "frames", recipe=edited)
    assert "the recording is skipped" in done.stdout
    _, value = output("explain", GOOD, "bag", recipe=edited)
    assert value["actions"] == []
    assert value["recorded"]["data_version"] == value["data_version"]


def test_fresh_is_what_dagster_calls_fresh(built):
    """Our states and Dagster's own markers agree once a build is done."""
    import dagster as dg
    from dagster._core.definitions.data_version import CachingStaleStatusResolver, StaleStatus
    from dagster._core.loader import LoadingContextForTest

    from bagassets.defs.graph.location import build_definitions

    graph = build_definitions(built).resolve_asset_graph()
    with open_instance(str(built.parent)) as instance:
        context = LoadingContextForTest(instance)
        resolver = CachingStaleStatusResolver(instance=instance, asset_graph=graph, loading_context=context)
        for asset, state in survey(built).plan.bags[GOOD].assets.items():
            assert state.state == "fresh"
            assert resolver.get_status(dg.AssetKey(asset), GOOD) == StaleStatus.FRESH, asset
