"""`bagassets build`: its table, progress and exit codes, on real projects."""

import copy
import io
import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner
from rich.console import Console

from bagassets.base.quantities import span_text
from bagassets.cli import progress
from bagassets.cli.main import root
from bagassets.cli.summary import counts_line, print_summary, splits_text, ui_command
from bagassets.engine.build_report import BagOutcome, BuildReport, Event, Remark, SummaryRow, remark_lines
from bagassets.engine.plan import AssetState, BagPlan, Plan
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.engine.run_action import run_action
from bagassets.engine.summary_rows import summary_rows
from bagassets.store.store import Store
from bagassets_tests.recording_build import ASSETS as EVERY
from bagassets_tests.recording_build import RECORDING_ASSETS

# Those that a build has counted from the beginning.
_COUNTING = {"inventory", "calibration", "ego_poses", "annotations", "frames", "sweeps", "nuscenes_tables"}
ASSETS = RecordingAssets(EVERY.recipe, [asset for asset in EVERY if asset.name in _COUNTING])


def bag_plan(key, versions=None):
    states = {
        name: AssetState("fresh", "up to date", (versions or {}).get(name)) for name in RECORDING_ASSETS
    }
    return BagPlan(key, states, "mcap")


def artifact(store, summary):
    from bagassets.store.action import Action

    action = Action("test", 1, params={"summary": json.dumps(summary)})
    return run_action(store, action, lambda _out: summary).artifact.digest


@pytest.fixture
def report(tmp_path):
    store = Store(tmp_path / "store")
    channels = {"A": {"read": 3, "written": 3}, "B": {"read": 3, "written": 2, "lost": {"torn": 1}}}
    versions = {
        "inventory": artifact(store, {"duration_s": 75.2}),
        "frames": artifact(store, {"channels": channels}),
        "sweeps": artifact(store, {"channels": {}}),
        "ego_poses": artifact(store, {"count": 7}),
        "annotations": artifact(store, {"boxes": 11}),
        "nuscenes_tables": artifact(store, {"counts": {"scenes": 2, "samples": 13}}),
    }
    plan = Plan({"a": bag_plan("a", versions), "b": bag_plan("b")}, {}, ())
    outcomes = {"a": BagOutcome("built"), "b": BagOutcome("failed", "b.bag: [torn] at its end.")}
    return store, BuildReport(
        plan,
        outcomes,
        {"c.bag": "its key a is that of a"},
        ("old",),
        moved={"a": ("val", "train")},
        splits={
            "train": {"asked": 0.8, "recordings": 2, "duration_s": 9.0, "share": 0.83, "is_far": False},
            "val": {"asked": 0.2, "recordings": 1, "duration_s": 9.0, "share": 0.17, "is_far": False},
        },
        dataset="updated",
        dataset_path=Path("/data set"),
        datasets={"nuscenes_dataset": {"path": "/data set", "state": "updated"}},
    )


def rows_of(built, store, **options):
    ASSETS.store = store
    return summary_rows(built, ASSETS, **options)


def test_a_row_holds_what_the_current_artifacts_say(report):
    store, built = report
    a, b = rows_of(built, store)
    assert a.as_json() == {
        "recording": "a",
        "format": "mcap",
        "span_s": 75.2,
        "images": 5,
        "sweeps": 0,
        "poses": 7,
        "boxes": 11,
        "scenes": 2,
        "keyframes": 13,
        "result": "built",
        "reason": "",
        "lost": {"B": {"torn": 1}},
    }
    assert (b.images, b.keyframes, b.result) == (None, None, "failed")


def test_losses_are_listed_by_source_and_reason(report):
    """The loss that is there is named; sources without one are not, and what two kinds lost alike adds up."""
    store, built = report
    cameras = {"CAM_FRONT": {"written": 1, "lost": {"damaged": 2}}, "CAM_REAR": {"written": 1, "lost": {}}}
    boxes = {"messages": {"lost": {"late": 1}}, "boxes": {"lost": {"no pose": 3, "late": 1}}}
    versions = {
        "frames": artifact(store, {"channels": cameras}),
        "ego_poses": artifact(store, {"source": "tf", "counts": {"lost": {"not finite": 4}}}),
        "annotations": artifact(store, {"counts": {"/boxes": boxes}}),
    }
    built.plan.bags["a"] = bag_plan("a", versions)
    assert rows_of(built, store)[0].lost == {
        "CAM_FRONT": {"damaged": 2}, "ego_poses": {"not finite": 4}, "/boxes": {"late": 2, "no pose": 3}
    }  # fmt: skip


def test_a_row_survives_being_sent_and_has_its_counts_as_attributes(report):
    store, built = report
    for row in rows_of(built, store):
        same = SummaryRow.from_json(json.loads(json.dumps(row.as_json())))
        assert same == row == copy.copy(row)
        assert same.keyframes == row.counts["keyframes"]
    with pytest.raises(AttributeError):
        _ = row.wheels


def test_an_artifact_that_is_gone_leaves_its_cells_empty(report):
    store, built = report
    for folder in (store.root / "artifacts").glob("*/*/manifest.json"):
        folder.unlink()
    assert rows_of(built, store)[0].images is None


def test_with_many_recordings_only_those_where_something_happened_are_read(report):
    store, built = report
    built.outcomes["b"] = BagOutcome("fresh")
    assert [row.recording for row in rows_of(built, store, most=1)] == ["a"]


def test_the_table_fits_80_columns_and_shows_everything(report):
    store, built = report
    stream = io.StringIO()
    print_summary(built, rows_of(built, store), Path("/p/recipe.yaml"), Console(file=stream, width=80))
    text = stream.getvalue()
    assert "keyframes result" in text
    (row,) = [line for line in text.splitlines() if line.lstrip().startswith("a ")]
    assert row.split() == ["a", "mcap", "1:15", "min", "5", "0", "7", "11", "2", "13", "built"]
    assert "failed b: b.bag: [torn] at its end." in text
    assert "left out c.bag: its key a is that of a" in text
    assert "removed old" in text
    assert "moved a: from val to train; pin it in `splits.pinned` to keep it where it is" in text
    assert "dataset: /data set (updated)" in text
    assert (
        "splits:  train 2 (83% of the time), val 1 (17% of the time); in the devkit custom_train, custom_val"
        in text
    )
    assert "bagassets ui --recipe /p/recipe.yaml" in text


def test_recordings_that_are_not_listed_are_counted_beside_those_that_are(report):
    store, built = report

    def lines(rows):
        stream = io.StringIO()
        print_summary(built, rows, Path("/p/recipe.yaml"), Console(file=stream, width=80))
        return stream.getvalue()

    rows = rows_of(built, store)
    assert len(rows) == 2
    assert "1 more recording; `bagassets status` lists all." in lines(rows[:1])
    assert "lists all" not in lines(rows)
    assert "lists all" not in lines([]), "more than none"


@pytest.mark.parametrize(("recordings", "is_said"), [(0, True), (1, False)])
def test_an_empty_dataset_is_called_so(report, recordings, is_said):
    store, built = report
    for share in built.splits.values():
        share["recordings"] = recordings
    stream = io.StringIO()
    print_summary(built, rows_of(built, store), Path("/p/recipe.yaml"), Console(file=stream, width=80))
    assert ("It is empty: no recording can be part of it" in stream.getvalue()) == is_said


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (None, ""),
        (0.0, "0.0 s"),
        (59.94, "59.9 s"),
        (61.0, "1:01 min"),
        (3723.4, "1:02:03 h"),
        (1749801205.0, "20,252 days"),
    ],
)
def test_durations_are_written_for_people(seconds, text):
    assert span_text(seconds) == text


def test_the_line_that_opens_the_ui_can_be_pasted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert ui_command(Path("recipe.yaml")) == "bagassets ui"
    assert ui_command(tmp_path / "my demo" / "recipe.yaml") == "bagassets ui --recipe 'my demo/recipe.yaml'"
    assert ui_command(Path("/elsewhere/recipe.yaml")) == "bagassets ui --recipe /elsewhere/recipe.yaml"


def test_a_finding_about_the_file_of_a_recording_has_its_name_once():
    (line,) = remark_lines(
        [Remark("a.bag", "warn", "recording_whole", "a.bag: nothing says where it ended.")]
    )
    assert line == "warn a.bag: nothing says where it ended. (recording_whole)"
    (other,) = remark_lines([Remark("a", "warn", "recording_whole", "a_0.bag: it has no index.")])
    assert other == "warn a: a_0.bag: it has no index. (recording_whole)"


def test_a_share_far_from_what_was_asked_for_is_said():
    night = {"asked": 0.5, "recordings": 0, "duration_s": 0.0, "share": 0.0, "is_far": True}
    day = {"asked": 0.5, "recordings": 2, "duration_s": 9.0, "share": 1.0, "is_far": True}
    assert splits_text({"day": day, "night": night}) == (
        "day 2 (100% of the time, 50% asked for), night 0 (0% of the time, 50% asked for)"
    )
    without_episodes = night | {"recordings": 1}
    assert splits_text({"day": day, "night": without_episodes}) == (
        "day 2 (100% of the time, 50% asked for), night 1 (with nothing for the dataset, 50% asked for)"
    )


def test_of_recordings_without_duration_no_shares_are_said():
    moments = {"asked": 0.5, "recordings": 1, "duration_s": 0.0, "share": 0.0, "is_far": True}
    assert splits_text({"day": moments, "night": moments}) == "day 1, night 1"
    assert splits_text({"train": moments}) == "train 1; in the devkit custom_train"
    assert splits_text({"train": moments}, of_nuscenes=False) == "train 1"


def test_counts_name_what_there_is():
    assert counts_line(BuildReport(Plan({}, {}, ()))) == "no recordings in 0.0 s"


def test_without_a_terminal_progress_is_plain_lines(capsys):
    show = progress.LinesProgress()
    with show:
        show(Event("planned", sizes={"a": 1, "b": 2}))
        show(Event("started", "a"))
        show(Event("failed", "a", "a.bag: broken."))
        show(Event("started"))
        show(Event("done"))
        show(Event("done", "b", "made ahead"))
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "2 recordings need a run."
    # The sentence stands in the summary that follows, where it is read.
    assert re.fullmatch(r"failed   1/2 a \(\d\.\d s\)", lines[2])
    assert lines[4].startswith("done     dataset")
    assert re.fullmatch(r"done     2/2 b \(\d\.\d s, made ahead\)", lines[5])


def test_a_log_says_once_that_it_takes_long_to_plan_and_to_read(capsys):
    show = progress.LinesProgress()
    for event in (
        Event("planning", message="Planned 200 of 401 recordings"),
        Event("planning", message="Planned 400 of 401 recordings"),
        Event("reading", message="Reading 2 recordings, 1 %"),
        Event("reading", message="Reading 2 recordings, 2 %"),
    ):
        show(event)
    assert capsys.readouterr().err.splitlines() == [
        "Planned 200 of 401 recordings",
        "Reading 2 recordings, 1 %",
    ]


def drawn(show):
    stream = io.StringIO()
    Console(file=stream, width=100).print(show.render())
    return stream.getvalue()


def test_on_a_terminal_it_shows_what_is_in_progress_done_and_left(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    show = progress.LiveProgress()
    assert "scanning" in drawn(show)
    show(Event("planning", message="Planned 200 of 401 recordings"))
    assert drawn(show) == "Planned 200 of 401 recordings\n"
    show(Event("planned", sizes={"small": 0, "big": 3_000_000}))
    show(Event("started", "small"))
    show(Event("started", "big"))
    now[0] += 10
    assert "0/2 recordings, 0:10" in drawn(show)
    assert "left" not in drawn(show), "nothing is known yet"
    show(Event("done", "small"))
    text = drawn(show)
    # A recording weighs its bytes and 1 MB: one of five parts took 10 s.
    assert "1/2 recordings, 0:10, about 0:40 left" in text
    assert "0:10  big" in text
    assert "small" not in text
    show(Event("failed", "big", "no"))
    assert "2/2 recordings, 0:10, 1 failed" in drawn(show)
    show(Event("planning", message="Planned 200 of 401 recordings"))
    assert "2/2 recordings, 0:10, 1 failed" in drawn(show)
    assert "Planned 200 of 401 recordings" in drawn(show)
    show(Event("started"))
    assert "Planned" not in drawn(show), "it has come to the dataset"


def test_on_a_terminal_a_failure_is_named_and_left_to_the_summary_to_explain(capsys):
    with progress.LiveProgress() as show:
        show(Event("failed", "big", "big.bag: broken."))
    output = capsys.readouterr().err
    assert "failed big\n" in output
    assert "broken" not in output


def run(*args):
    return CliRunner().invoke(root, [str(arg) for arg in args])


def test_a_missing_recipe_is_refused_in_one_sentence(tmp_path):
    done = run("build", "--recipe", tmp_path / "recipe.yaml")
    assert done.exit_code == 1
    assert "no recipe here" in str(done.exception)


@pytest.mark.parametrize("jobs", ["0", "-1", "two"])
def test_jobs_that_make_no_sense_are_wrong_usage(jobs):
    assert run("build", "--jobs", jobs).exit_code == 2
