"""A dataset that has nothing of its recordings is no success: the build ends with the reason and the way out."""

import json
from types import SimpleNamespace

import pytest

from bagassets.assets.quality.scene_rules import scenes_made, too_short_s
from bagassets.engine.freshness.decide import nothing_to_do
from bagassets.formats import dataset_build
from bagassets.formats.emptiness import why_empty
from bagassets.recipe import load_recipe
from bagassets_tests.in_process import QUICK, build, make_project
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once


def test_recordings_too_short_for_a_scene_fail_the_build_and_the_way_out_gives_scenes(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path, (), text=QUICK.replace("min_length_s: 0.5", "min_length_s: 1"))
    for key, duration_s in (("a.bag", 0.6), ("b.bag", 0.8)):
        write_drive(tmp_path / "bags" / key, "ros1", duration_s)  # clouds each 0.1 s, of 0.4 and 0.6 s
    line = recipe_file.read_text().splitlines().index("scenes: {min_length_s: 1}") + 1
    report, _ = build(recipe_file, monkeypatch, jobs=1)
    assert report.dataset_problem == (
        "nuscenes: 0 scenes from 2 recordings: all, of 0.4 to 0.6 s, are shorter than scenes.min_length_s (1); to have a "
        f"scene of each, set it to 0.39 ({recipe_file}:{line}: scenes.min_length_s)."
    )
    assert (report.dataset, report.succeeded) == ("updated", False)  # exit status 1, also of the next one:
    assert nothing_to_do(["build", "--recipe", str(recipe_file)]) is None
    recipe_file.write_text(recipe_file.read_text().replace("min_length_s: 1", "min_length_s: 0.39"))
    report, _ = build(recipe_file, monkeypatch, jobs=1)
    assert (report.dataset_problem, report.succeeded) == ("", True)
    assert len(json.loads((report.dataset_path / "v1.0-test" / "scene.json").read_text())) == 2


FEW = {"scenes": 0, "dropped_keyframes": 0, "remainder_s": 0.0, "samples": 0}


def facts(**counts):
    channels = {"LIDAR_TOP": {"without_pose": counts.pop("without_pose", 0)}}
    return {"reference": "LIDAR_TOP", "counts": FEW | {"channels": channels} | counts}


SHORT, DROPPED, NO_POSES, LONG = (
    facts(remainder_s=0.3), facts(dropped_keyframes=3), facts(without_pose=9), facts(scenes=2),
)  # fmt: skip


@pytest.fixture
def why(tmp_path, monkeypatch):
    """Return what is said of a dataset whose recordings have these facts."""
    recipe_file = tmp_path / "recipe.yaml"
    recipe_file.write_text(QUICK.format(name="x", root="bags").replace("scenes: {min_length_s: 0.5}\n", ""))

    def said(*found, assets=("nuscenes_dataset",), more=""):
        bags = {
            str(number): SimpleNamespace(
                artifact=one, counts={"scenes": one["counts"]["scenes"], "samples": 0}
            )
            for number, one in enumerate(found)
        }
        monkeypatch.setattr(dataset_build, "read_lock", lambda _: SimpleNamespace(bags=bags))
        store = SimpleNamespace(artifact=lambda one: SimpleNamespace(read_json=lambda _: one))
        recipe_file.write_text(recipe_file.read_text() + more)
        said = why_empty(load_recipe(recipe_file), recipe_file, store, assets)
        return said.replace(str(recipe_file), "FILE")

    return said


def test_a_recipe_without_the_field_is_told_what_to_add(why):
    assert why(SHORT) == (
        "nuscenes: 0 scenes from 1 recording: all, of 0.3 s, are shorter than scenes.min_length_s (1); to have a scene of "
        "each, add `scenes: {min_length_s: 0.29}` to FILE."
    )


def test_other_reasons_are_left_to_the_check_that_knows_them(why):
    assert why(DROPPED, NO_POSES) == "nuscenes: 0 scenes from 2 recordings: `bagassets check` says why."
    assert why(SHORT, DROPPED, facts()).startswith(
        "nuscenes: 0 scenes from 3 recordings: 2, of 0 to 0.3 s, are shorter"
    )
    assert why(SHORT, DROPPED).endswith("`bagassets check` says why the others have none.")


def images(number, strided=0, without_pose=0, breaks=0):
    left = number - strided - without_pose
    counts = {"images": number, "remainder": left, "sequences": 0}
    return counts | {"strided": strided, "without_pose": without_pose, "breaks": breaks}


@pytest.mark.parametrize(
    ("cameras", "but"),
    [
        ([images(20), images(3)], ""),
        ([images(29, breaks=4)], ", 4 breaks between them (vision.max_gap_s, or no ego pose)"),
        ([images(60, strided=31), images(19)], ", 31 skipped by vision.stride"),
        ([images(60, without_pose=40), images(30, without_pose=29)], ", 40 without an ego pose"),
    ],
)
def test_vision_names_its_section_and_counts_the_images_that_it_could_use(cameras, but, why):
    channels = {f"CAM_{number}": one for number, one in enumerate(cameras)}
    left = cameras[0]["remainder"]
    none = SHORT | {"channels": {"CAM_0": images(0)}}
    assert why(
        none, SHORT | {"channels": channels}, none, assets={"vision_dataset"}, more="vision: {}\n"
    ) == (
        f"vision: 0 scenes from 3 recordings: no camera has 25 images (vision.frames) in a row; the most are {left} of CAM_0{but} (FILE:11: vision)."
    )


def test_a_recording_without_a_sequence_is_reported_by_each_build(tmp_path, monkeypatch):
    text = QUICK.replace("nuscenes: {{version: v1.0-test}}", "vision: {{frames: 8}}")
    recipe_file = make_project(tmp_path, ("long.bag",), text=text, duration_s=1.5)
    write_drive(tmp_path / "bags" / "short.bag", "ros1", duration_s=0.7)
    said = "it has no sequence: no camera has 8 images (vision.frames) in a row; the most are 6 of CAM_FRONT"
    for _ in range(2):
        report, _ = build(recipe_file, monkeypatch, jobs=1)
        (remark,) = [one for one in report.remarks if one.check == "sequences_made"]
        assert (remark.key, remark.severity, remark.problem) == ("short.bag", "warn", said)
        assert report.succeeded


def test_a_dataset_with_a_single_scene_is_none_of_these(why):
    assert why(SHORT, SHORT, LONG, DROPPED) == ""
    assert why() == ""
    assert why(SHORT, assets=()) == ""


@pytest.mark.parametrize("found", [SHORT, DROPPED, NO_POSES, LONG, facts()], ids=str)
def test_the_check_of_a_recording_and_the_dataset_mean_the_same_recordings(found):
    found["counts"]["channels"]["LIDAR_TOP"] |= {"lacking_at_keyframes": {"keyframes": 0}, "span_ns": [0, 0]}
    said = " ".join(scenes_made(found | {"tolerance_s": 0.1}, None, 1.0).problems)
    assert (too_short_s(found) is not None) == ("min_length_s" in said)
