"""A LeRobot dataset through `bagassets build`: from the recipe to the table, and again with one recording more and less."""

import json

import pytest

from bagassets.formats.emptiness import why_empty
from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets.store.store import Store
from bagassets_tests.arm_recordings import RECIPE, arm_messages, write_arm
from bagassets_tests.in_process import build
from bagassets_tests.recorded_bags import NOON_NS, text


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A project that was built once: its folder, the report, and what the dataset said then, as a test changes it."""
    folder = tmp_path_factory.mktemp("project")
    for number, name in enumerate("abc"):
        write_arm(folder, name, seconds=1.0, first=100 * number)
    write_arm(folder, "stops", seconds=4.0, skip=lambda topic, time: topic == "/wrist" and time > 2)
    write_project(folder, RECIPE)
    with pytest.MonkeyPatch.context() as patch:
        report, _ = build(folder / "recipe.yaml", patch)
    return folder, report, info(folder)


def info(project):
    return json.loads((project / "dataset/lerobot/v3.0/meta/info.json").read_text())


def test_all_that_keep_the_rules_are_built_and_others_are_named(built):
    _, report, made = built
    assert report.dataset == "updated"
    assert {key: one.result for key, one in report.outcomes.items()} == dict.fromkeys(
        ("a.mcap", "b.mcap", "c.mcap", "stops.mcap"), "built"
    )
    (remark,) = [one for one in report.remarks if one.check == "episodes_kept"]
    assert remark.key == "stops.mcap"
    assert "observation.images.wrist (CAM_WRIST) ends at 2.000 s already" in remark.problem
    assert (made["total_episodes"], made["total_frames"]) == (3, 3 * 29)


def test_a_pause_of_the_commands_is_said_with_a_way_out(tmp_path, monkeypatch):
    write_arm(tmp_path, "a", seconds=2.0, skip=lambda topic, time: topic == "/command" and 0.8 < time < 1.4)
    write_project(tmp_path, RECIPE)
    report, _ = build(tmp_path / "recipe.yaml", monkeypatch)
    (remark,) = [one for one in report.remarks if one.check == "episodes_kept"]
    assert remark.problem.startswith(
        "the episode that begins at 0.000 s is left out: action (command) has no value within"
    )
    assert remark.problem.endswith(
        "; `gap` of the feature can end the episode there, or hold the value before"
    )


def test_a_dataset_without_episodes_says_what_messages_said(tmp_path, monkeypatch):
    event = [text(NOON_NS, "begin", "/event")]
    write_arm(tmp_path, "a", sorted([*arm_messages(1.0), *event], key=lambda one: one.log_time_ns))
    write_project(tmp_path, RECIPE + "  episodes: {topic: /event, start: [go]}\n")
    report, _ = build(tmp_path / "recipe.yaml", monkeypatch)
    why = "no message of /event begins one: they say 'begin'; correct `start`"
    (remark,) = [one for one in report.remarks if one.check == "episodes_kept"]
    assert f"no episodes: {why}" in remark.problem
    recipe = load_recipe(tmp_path / "recipe.yaml")
    said = why_empty(recipe, tmp_path / "recipe.yaml", Store(recipe.store_path), {"lerobot_dataset"})
    assert said.startswith(f"lerobot: 0 episodes from 1 recording: {why} (")


def test_a_warning_about_what_an_older_recipe_made_is_not_shown_beside_a_failure(tmp_path, monkeypatch):
    write_arm(tmp_path, "a", seconds=1.0)
    write_project(tmp_path, RECIPE + "  episodes: {topic: /episode, start: [go]}\n")
    build(tmp_path / "recipe.yaml", monkeypatch)
    write_project(tmp_path, RECIPE.replace("topic: /command", "topic: /nowhere"))
    for _ in range(2):  # the second tries nothing again
        report, _ = build(tmp_path / "recipe.yaml", monkeypatch)
        assert report.outcomes["a.mcap"].result == "failed"
        assert not [one for one in report.remarks if one.check == "episodes_kept"]


def test_a_topic_that_is_not_there_is_answered_with_those_that_are(tmp_path, monkeypatch):
    write_arm(tmp_path, "a", seconds=1.0)
    write_project(tmp_path, RECIPE + "  episodes: {topic: /episode, start: [go]}\n")
    report, _ = build(tmp_path / "recipe.yaml", monkeypatch)
    (remark,) = [one for one in report.remarks if one.check == "episodes_kept"]
    topics = "/command, /joint_states, /wrist"
    assert remark.problem.endswith(f"no episodes: /episode has no messages; there are {topics}")


def test_a_camera_slower_than_the_dataset_is_named(tmp_path, monkeypatch):
    """Nearest, images of 10 Hz are near enough for 30 frames a second: each is three frames. What is held was asked for."""
    write_arm(tmp_path, "slow", seconds=1.0, camera_hz=10)
    write_arm(tmp_path, "right", seconds=1.0, first=100)
    write_arm(
        tmp_path,
        "pauses",
        seconds=1.0,
        first=200,
        skip=lambda topic, time: topic == "/wrist" and 0.2 < time < 0.8,
    )
    camera = "{camera: CAM_WRIST, at: nearest, gap: hold}"
    write_project(tmp_path, RECIPE.replace("{camera: CAM_WRIST}", camera))
    report, _ = build(tmp_path / "recipe.yaml", monkeypatch)
    (remark,) = [one for one in report.remarks if one.check == "episodes_kept"]
    assert (remark.key, remark.severity) == ("slow.mcap", "warn")
    assert remark.problem.startswith(
        "observation.images.wrist: 19 of 30 frames repeat the image before: the camera is slower than lerobot.fps"
    )


@pytest.mark.parametrize(
    ("skipped", "episodes", "said"),
    [
        (False, "{min_length_s: 3}", "it has 29 frames, and must have 90 (lerobot.episodes.min_length_s)"),
        (
            True, "{}",
            "it comes at 5 Hz and fps is 30; lower fps, or raise its tolerance_s, or set `at: hold` if each value holds until the next",
        ),
    ],
)  # fmt: skip
def test_what_an_episode_lacks_is_said_with_the_setting(skipped, episodes, said, tmp_path, monkeypatch):
    def skip(topic, time):
        return topic == "/command" and skipped and (time + 0.001) % 0.2 > 0.01

    write_arm(tmp_path, "a", seconds=1.0, skip=skip)
    write_project(tmp_path, f"{RECIPE}  episodes: {episodes}\n")
    report, _ = build(tmp_path / "recipe.yaml", monkeypatch)
    (remark,) = [one for one in report.remarks if one.check == "episodes_kept"]
    assert remark.problem.endswith(said), remark.problem


def test_ranges_of_no_recording_are_named_with_file_row_and_key(tmp_path, monkeypatch):
    rows = "a.mcap,0,0.5\nb.mcap,0,0.5\nc.mcap,0,0.5\n,,\n"  # the last is what spreadsheets leave
    (tmp_path / "ranges.csv").write_text(f"recording,start_s,end_s\n{rows}")
    write_arm(tmp_path, "a", seconds=1.0)
    write_project(tmp_path, RECIPE + "  episodes: {ranges: ranges.csv}\n")
    for _ in range(2):  # the second has nothing to do
        report, _ = build(tmp_path / "recipe.yaml", monkeypatch)
        (remark,) = [one for one in report.remarks if one.check == "unknown_recordings"]
        assert remark.problem == (
            f"{tmp_path}/ranges.csv:3: there is no recording b.mcap (nor what 1 more of its rows name), so it has no episodes; "
            "`bagassets status --all` lists the keys."
        )


def test_ranges_of_no_name_are_told(tmp_path, monkeypatch):
    (tmp_path / "ranges.csv").write_text("recording,start_s,end_s\na.mcap,0,0.5\n,0.5,0.9\n")
    write_arm(tmp_path, "a", seconds=1.0)
    write_project(tmp_path, RECIPE + "  episodes: {ranges: ranges.csv}\n")
    report, _ = build(tmp_path / "recipe.yaml", monkeypatch)
    (remark,) = [one for one in report.remarks if one.check == "unknown_recordings"]
    assert remark.problem.startswith(f"{tmp_path}/ranges.csv:3: there is no recording '', so it")


def test_nothing_runs_again_and_one_more_runs_alone(built, monkeypatch):
    project, _, _ = built
    report, ran = build(project / "recipe.yaml", monkeypatch)
    assert (report.dataset, ran) == ("fresh", [])
    write_arm(project, "b2", seconds=1.0, first=900)
    report, ran = build(project / "recipe.yaml", monkeypatch)
    assert [key for key, _ in ran if key] == ["b2.mcap"]
    assert info(project)["total_episodes"] == 4
    (project / "bags" / "a.mcap").unlink()
    build(project / "recipe.yaml", monkeypatch)
    assert info(project)["total_episodes"] == 3
