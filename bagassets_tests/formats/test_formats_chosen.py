"""A recipe asks for the formats that it names: without nuScenes, without ego poses where no format asks for them."""

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

import bagassets
from bagassets.base.errors import DatasetError, RecipeError
from bagassets.cli.main import root
from bagassets.engine.freshness.decide import nothing_to_do
from bagassets.formats.catalogue import recording_assets
from bagassets.formats.dataset_build import datasets_of
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.formats.vision.settings import Vision
from bagassets.recipe import load_recipe, parse_recipe
from bagassets_tests.in_process import QUICK, build, make_project, states, survey
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

VISION = QUICK.replace("nuscenes: {{version: v1.0-test}}\n", "vision: {{frames: 4}}\n")
POSED = "    ego_pose: {{source: odometry, topic: /odom}}\n"
UNPOSED = VISION.replace(POSED, "").replace("frames: 4", "frames: 4, trajectories: ['CAM_FRONT:ego']")
MINIMAL = """\
name: test
bags: {root: bags}
rigs:
  - name: arm
    channels: {CAM_WRIST: {modality: camera, topic: /wrist}}
"""


def parsed(text, tmp_path):
    return parse_recipe(text, tmp_path / "recipe.yaml")


def refusal(text, tmp_path):
    with pytest.raises(RecipeError) as caught:
        parsed(text, tmp_path)
    return str(caught.value).replace(f"{tmp_path}/", "")


def command(*arguments, recipe, status=0):
    result = CliRunner().invoke(root, [*arguments, "--recipe", str(recipe)])
    assert result.exit_code == status, result.output
    return result.output


class TestWhichFormats:
    POSE = "    ego_pose: {source: fixed}\n"

    @pytest.mark.parametrize(
        ("sections", "asked"),
        [
            ("", ["nuscenes_dataset"]),
            ("nuscenes: {}\n", ["nuscenes_dataset"]),
            ("vision: {}\n", ["vision_dataset"]),
            ("vision: {}\nnuscenes: {}\n", ["nuscenes_dataset", "vision_dataset"]),
            ("datasets: [{name: day}]\n", ["nuscenes_dataset", "dataset_day"]),
            ("vision: {}\ndatasets: [{name: day}]\n", ["nuscenes_dataset", "vision_dataset", "dataset_day"]),
        ],
    )
    def test_those_that_are_named_else_nuscenes(self, sections, asked, tmp_path):
        recipe = parsed(MINIMAL + self.POSE + sections, tmp_path)
        assert list(datasets_of(recipe)) == asked
        has_tables = "nuscenes_dataset" in asked
        assert ("nuscenes_tables" in recording_assets(recipe).names) is has_tables
        assert (recipe.settings(NuScenes) is not None) is has_tables
        assert (recipe.settings(Vision) is not None) is ("vision_dataset" in asked)
        assert recipe.output == next(iter(datasets_of(recipe).values())).settings.output

    def test_an_empty_section_is_refused_and_one_in_the_wrong_place(self, tmp_path):
        assert refusal(MINIMAL + self.POSE + "nuscenes:\n", tmp_path) == (
            "recipe.yaml:7: nuscenes: needs a value: the nuScenes dataset."
        )
        for name in ("vision", "lerobot"):  # there was a nuScenes dataset in its place
            assert f"recipe.yaml:7: {name}: needs a value: " in refusal(
                MINIMAL + self.POSE + f"{name}:\n", tmp_path
            )
        assert refusal(MINIMAL + self.POSE + "formats: {vision: {output: v}}\n", tmp_path) == (
            "recipe.yaml:7: formats.vision: vision is a section at the top level of the recipe; move it there."
        )


class TestPosesAreAskedForByFormats:
    def test_nuscenes_asks_for_them(self, tmp_path):
        for text in (MINIMAL, MINIMAL + "nuscenes: {}\n", MINIMAL + "datasets: [{name: day}]\n"):
            assert refusal(text, tmp_path) == (
                "recipe.yaml:4: rigs[arm].ego_pose: this field is required by nuscenes: source of ego poses; for a rig that stands "
                "still, `source: fixed`."
            )

    def test_vision_does_for_the_global_frame(self, tmp_path):
        assert refusal(MINIMAL + "vision: {}\n", tmp_path) == (
            "recipe.yaml:4: rigs[arm].ego_pose: this field is required by vision (unless it has `trajectories` without `global`, such as `trajectories: []`): source of "
            "ego poses; for a rig that stands still, `source: fixed`."
        )
        pairs = "trajectories: ['tool:base_link', 'CAM_WRIST : global']"
        assert "required by vision" in refusal(f"{MINIMAL}vision: {{{pairs}}}\n", tmp_path)
        assert (
            "required by nuscenes and vision (unless it has `trajectories` without `global`, such as `trajectories: []`):"
            in refusal(f"{MINIMAL}vision: {{}}\nnuscenes: {{}}\n", tmp_path)
        )
        for pairs in ("[]", "['tool:base_link']"):
            recipe = parsed(f"{MINIMAL}vision: {{trajectories: {pairs}}}\n", tmp_path)
            assert recipe.rigs[0].ego_pose is None

    def test_one_that_is_left_open_is_still_asked_for(self, tmp_path):
        text = f"{MINIMAL}    ego_pose:\nvision: {{trajectories: []}}\n"
        assert "rigs[arm].ego_pose: needs a value: source of ego poses" in refusal(text, tmp_path)

    @pytest.mark.parametrize(
        ("channel", "words"),
        [
            ("LIDAR_TOP: {modality: lidar, topic: /l, deskew: true}", "deskew: needs poses of a moving rig, but there is no ego_pose"),
            ("RADAR: {modality: radar, topic: /r}", "velocities: need the poses of the rig, unless they are over ground: give it an ego_pose"),
        ],
    )  # fmt: skip
    def test_so_do_channels(self, channel, words, tmp_path):
        text = MINIMAL.replace("CAM_WRIST: {modality: camera, topic: /wrist}", channel)
        assert words in refusal(text + "vision: {trajectories: []}\n", tmp_path)

    def test_and_boxes(self, tmp_path):
        text = f"{MINIMAL}    annotations: [{{topic: /boxes}}]\nvision: {{trajectories: []}}\n"
        assert "annotations: needs the poses of the rig, to place boxes in the world" in refusal(
            text, tmp_path
        )


def test_a_project_of_vision_alone(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path, ("a.bag", "b.mcap"), text=VISION)
    report, runs = build(recipe_file, monkeypatch)
    assert (report.dataset, report.dataset_problem) == ("updated", "")
    assert [one.check for one in report.remarks] == ["same_content"]  # one drive, in two formats
    assert report.dataset_path == tmp_path / "dataset" / "vision"
    assert {asset for _, assets in runs for asset in assets}.isdisjoint(
        {"nuscenes_tables", "nuscenes_dataset"}
    )
    assert set(report.splits) == {"train", "val"}
    assert [path.name for path in (tmp_path / "dataset").iterdir()] == ["vision"]
    dataset = bagassets.open_dataset(tmp_path / "dataset" / "vision")
    assert len(dataset.scenes) == 4
    assert dataset[1].global_SE3_ego("CAM_FRONT").shape == (4, 4)

    pending = survey(recipe_file)
    assert set(states(pending, "a.bag").values()) == {"fresh"}
    assert "nuscenes_tables" not in states(pending, "a.bag")
    assert build(recipe_file, monkeypatch)[1] == []

    assert "nuscenes" not in command("status", "--json", recipe=recipe_file)
    assert "vision_dataset" in command("explain", "vision_dataset", recipe=recipe_file)
    assert "fresh" in command("explain", "a.bag", "vision_sequences", recipe=recipe_file)
    command("check", recipe=recipe_file)
    page = tmp_path / "report.html"
    command("report", "--output", str(page), recipe=recipe_file)
    assert "a.bag" in page.read_text()
    assert (load_recipe(recipe_file).state / "report.html").is_file()  # which the first dataset writes
    assert "only scenes of such a dataset can be shown" in command(
        "view", "--list", recipe=recipe_file, status=2
    )


def test_definitions_of_vision_alone(tmp_path):
    from bagassets.defs.graph.location import build_definitions

    definitions = build_definitions(make_project(tmp_path, (), text=VISION))
    names = {key.to_user_string() for key in definitions.resolve_all_asset_keys()}
    assert "vision_dataset" in names
    assert names.isdisjoint({"nuscenes_tables", "nuscenes_dataset"})
    assert not [key for key in definitions.resolve_asset_graph().asset_check_keys if "nuscenes" in str(key)]


def test_a_rig_without_poses(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path, text=UNPOSED.replace("preview: {{enabled: false}}\n", ""))
    report, _ = build(recipe_file, monkeypatch)
    assert (report.dataset, report.dataset_problem) == ("updated", "")
    assert {outcome.result for outcome in report.outcomes.values()} == {"built"}
    output = tmp_path / "dataset" / "vision"
    (rows,) = output.glob("recordings/*/CAM_FRONT/0000.json")
    assert [frame["pose"] for frame in json.loads(rows.read_text())["frames"]] == [None] * 4
    (table,) = output.glob("recordings/*/trajectories/*.csv")
    assert table.name == "CAM_FRONT-ego.csv"
    assert len(table.read_text().splitlines()) == 2  # where the camera sits, which never changes

    dataset = bagassets.open_dataset(output)
    sample = dataset[0]
    assert sample.image("CAM_FRONT").shape[2] == 3
    with pytest.raises(
        DatasetError, match="these images have no poses, because the recipe gives the rig no ego_pose"
    ):
        sample.global_SE3_ego("CAM_FRONT")
    command("check", recipe=recipe_file)
    command("report", "--output", str(tmp_path / "report.html"), recipe=recipe_file)


def test_a_dataset_that_nothing_asks_for_any_more_is_not_forgotten(tmp_path, monkeypatch):
    """Before formats could be chosen, every recipe made a nuScenes dataset."""
    recipe_file = make_project(tmp_path)
    build(recipe_file, monkeypatch)
    text = recipe_file.read_text()
    recipe_file.write_text(text.replace("nuscenes: {version: v1.0-test}", "vision: {frames: 4}"))
    dataroot = tmp_path / "dataset" / "nuscenes"
    report, _ = build(recipe_file, monkeypatch)
    (remark,) = [one for one in report.remarks if one.check == "left_behind"]
    assert remark.problem.startswith(f"{dataroot}: this dataset is no longer brought up to date")
    assert "add `nuscenes: {}` to it, or remove the folder" in remark.problem
    assert f"warning: {remark.problem}\n" in command("status", recipe=recipe_file)
    shutil.rmtree(dataroot)
    report, _ = build(recipe_file, monkeypatch)
    assert [one for one in report.remarks if one.check == "left_behind"] == []
    assert not Path(dataroot).exists()


MONDAY = "datasets: [{name: monday, scenes: ['*']}]\n"


@pytest.mark.parametrize(
    ("removed", "folder", "again"),
    [
        ("vision: {frames: 4}\n", "vision", "add `vision: {}` to it"),
        (MONDAY, "monday", "name it in its `datasets`"),
    ],
)
def test_a_section_that_was_removed_from_the_recipe_leaves_its_dataset(
    removed, folder, again, tmp_path, monkeypatch
):
    recipe_file = make_project(
        tmp_path, text=QUICK + "vision: {{frames: 4}}\n" + MONDAY.replace("{", "{{").replace("}", "}}")
    )
    build(recipe_file, monkeypatch)
    recipe_file.write_text(recipe_file.read_text().replace(removed, ""))
    left = tmp_path / "dataset" / folder
    before = sorted(left.rglob("*"))
    report, _ = build(recipe_file, monkeypatch)
    (remark,) = [one for one in report.remarks if one.check == "left_behind"]
    assert remark.problem == (
        f"{left}: this dataset is no longer brought up to date and stays as it is, because the recipe does not ask for it; "
        f"{again}, or remove the folder."
    )
    assert sorted(left.rglob("*")) == before
    assert f"warning: {remark.problem}\n" in command("status", recipe=recipe_file)
    build(recipe_file, monkeypatch)
    quick = ["build", "--recipe", str(recipe_file)]
    assert any(remark.problem in line for line in nothing_to_do(quick))
    shutil.rmtree(left)
    assert nothing_to_do(quick) is None
    report, _ = build(recipe_file, monkeypatch)
    assert [one for one in report.remarks if one.check == "left_behind"] == []
    assert nothing_to_do(quick)


def test_a_dataset_at_another_output_and_one_beside_others_are_left_behind_too(tmp_path, monkeypatch):
    named = "datasets: [{{name: one, output: dataset/nuscenes, version: v1.0-one}}]\n"
    recipe_file = make_project(tmp_path, ("a.bag",), text=QUICK + named)
    build(recipe_file, monkeypatch)
    text = recipe_file.read_text().replace(named.format(), "")
    dataroot, moved = tmp_path / "dataset" / "nuscenes", tmp_path / "moved"

    def told(text, *, built=True):
        recipe_file.write_text(text)
        if built:
            build(recipe_file, monkeypatch)
        warned = command("status", recipe=recipe_file, status=0 if built else 3).split("warning: ")[1:]
        return {line.partition(": this dataset is no longer")[0]: line.strip() for line in warned}

    beside = dataroot / "v1.0-one"
    assert list(told(text)) == [str(beside)]
    elsewhere = text.replace("{version: v1.0-test}", f"{{version: v1.0-test, output: {moved}}}")
    for built in (False, True):  # the folder is told as a whole: nothing in it is brought up to date any more
        (left,) = told(elsewhere, built=built).values()
        assert left.startswith(f"{dataroot}: ")
        assert left.endswith("; name it as an `output`, or remove the folder.")
    assert list(told(text)) == [str(beside), str(moved)]
    shutil.rmtree(moved)
    shutil.rmtree(beside)
    assert told(text) == {}
    again = named.format()
    assert told(text + again) == {}
    (left,) = told(text + again.replace("dataset/nuscenes", "one")).values()
    assert left.startswith(f"{beside}: ")


def test_each_dataset_and_the_map_say_what_of_theirs_changed(tmp_path, monkeypatch):
    text = QUICK.replace("preview: {{enabled: false}}\n", "preview: {{columns: 1}}\nvision: {{frames: 4}}\n")
    recipe_file = make_project(tmp_path, ("a.bag",), text=text)
    build(recipe_file, monkeypatch)
    mapped = command("explain", "trajectory_map", recipe=recipe_file)
    assert "made from ego_poses of 1 recording, 1 as before\n" in mapped
    recipe_file.write_text(
        recipe_file.read_text().replace("min_length_s: 0.5", "min_length_s: 0.2, length_s: 0.5")
    )
    build(recipe_file, monkeypatch, select=("nuscenes_tables", "vision_sequences"))
    told = json.loads(command("status", "--json", recipe=recipe_file, status=3))["dataset_reasons"]
    assert told == {
        "nuscenes_dataset": "its recordings changed since it was made",
        "vision_dataset": "only what is left out, or in other datasets, changed since it was made",
        "trajectory_map": "its recordings changed since it was made",
    }
    write_drive(tmp_path / "bags" / "b.bag", "ros1", duration_s=1.3)
    build(recipe_file, monkeypatch, select=("nuscenes_tables", "vision_sequences"))
    told = json.loads(command("status", "--json", recipe=recipe_file, status=3))["dataset_reasons"]
    assert told["vision_dataset"] == told["nuscenes_dataset"] == "its recordings changed since it was made"
    mapped = command("explain", "trajectory_map", recipe=recipe_file)
    assert "made from ego_poses of 2 recordings, 1 as before\n  * b.bag: " in mapped
