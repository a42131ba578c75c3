"""Why an asset is in its state, in the words that `bagassets status` prints."""

import os
import shutil

import pytest

from bagassets.recipe import load_recipe
from bagassets.store.store import Store
from bagassets_tests.in_process import build, make_project, survey
from bagassets_tests.label_files import box_entries, box_json, write_boxes_json
from bagassets_tests.small_drive import RECIPE

pytestmark = pytest.mark.once

KEY = "a.bag"
TWO = RECIPE.replace(
    "      LIDAR_TOP:", "      CAM_BACK: {{modality: camera, topic: /cam/image_raw, extrinsics: {{translation: [0, 0, 1], rotation: [1, 0, 0, 0]}}}}\n      LIDAR_TOP:"
) + "preview: {{enabled: false}}\n"  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reasons")
    recipe = make_project(folder, [KEY], text=TWO)
    with pytest.MonkeyPatch.context() as patch:
        report, _ = build(recipe, patch)
    assert report.succeeded
    return recipe


@pytest.fixture
def recipe(made):
    text = made.read_text()
    yield made
    made.write_text(text)


def refuse(file, monkeypatch):
    """Deny access to a file; its mode would not stop tests that run as root."""
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: path != file and access(path, mode))


def output(recipe, **options):
    """Asset -> its state and why."""
    return {
        name: (asset.state, asset.reason)
        for name, asset in survey(recipe, **options).plan.bags[KEY].assets.items()
    }


def edit(recipe, old, new):
    text = recipe.read_text()
    assert text.count(old) == 1
    recipe.write_text(text.replace(old, new))


def test_all_is_as_it_was(recipe):
    states = output(recipe)
    assert states.pop("bag") == ("fresh", "size and time unchanged")
    assert set(states.values()) == {("fresh", "up to date")}


def test_a_parameter_of_one_camera(recipe):
    edit(recipe, "CAM_FRONT: {modality: camera,", "CAM_FRONT: {modality: camera, quality: 40,")
    states = output(recipe)
    assert states["frames"] == ("stale", "CAM_FRONT: quality 90 -> 40")
    assert states["sweeps"] == ("fresh", "up to date")
    assert states["nuscenes_tables"] == ("unknown", "waits for frames — CAM_FRONT: quality 90 -> 40")


def test_parameters_of_both_cameras(recipe):
    edit(recipe, "CAM_FRONT: {modality: camera,", "CAM_FRONT: {modality: camera, quality: 40,")
    edit(recipe, "CAM_BACK: {modality: camera,", "CAM_BACK: {modality: camera, quality: 41,")
    assert output(recipe)["frames"] == ("stale", "CAM_BACK: quality 90 -> 41; CAM_FRONT: quality 90 -> 40")


def test_a_channel_more(recipe):
    line = "      CAM_LEFT: {modality: camera, topic: /cam/image_raw, quality: 33}\n      LIDAR_TOP:"
    edit(recipe, "      LIDAR_TOP:", line)
    states = output(recipe)
    assert states["calibration"][0] == "stale"
    assert states["frames"] == ("unknown", f"waits for calibration — {states['calibration'][1]}")
    assert states["nuscenes_tables"] == states["frames"], "one chain of reasons, not one in another"


def test_a_change_that_cannot_matter(recipe):
    """A channel that the recording lacks is part of the code version, and of no action of it."""
    lacking = "      CAM_LEFT: {modality: camera, topic: /nowhere}\n      CAM_BACK:"
    edit(recipe, "      CAM_BACK:", lacking)
    states = output(recipe)
    assert states["frames"] == ("record-only", "the recipe or a library version changed, the result did not")
    assert states["inventory"] == states["sweeps"] == ("fresh", "up to date")


def test_which_recordings_the_only_rig_made_matters_to_no_asset(recipe):
    edit(recipe, "  - name: car\n", "  - name: car\n    match: ['*.bag']\n")
    assert {state for state, _ in output(recipe).values()} == {"fresh"}


def test_label_files_are_named_and_not_how_they_are_read(tmp_path, monkeypatch):
    files = "    annotation_files: [{{format: boxes, path: '{{stem}}.boxes.json'}}]\n    channels:"
    text = RECIPE.replace("    channels:", files) + "preview: {{enabled: false}}\n"
    recipe = make_project(tmp_path, [KEY], text=text)
    assert build(recipe, monkeypatch)[0].succeeded
    write_boxes_json(tmp_path / "bags")
    assert output(recipe)["annotations"] == (
        "stale",
        "labels {stem}.boxes.json is new, topic /tf_static is new",
    )
    assert build(recipe, monkeypatch)[0].succeeded
    (tmp_path / "bags" / "a.boxes.json").write_text(box_json(box_entries()[:2]))
    assert output(recipe)["annotations"] == ("stale", "labels {stem}.boxes.json changed")


def test_a_result_that_is_gone_from_the_store(recipe):
    store = Store(load_recipe(recipe).store_path)
    digest = survey(recipe).plan.bags[KEY].assets["calibration"].data_version
    aside = shutil.move(store.artifact_folder(digest), recipe.parent / "aside")
    states = output(recipe)
    shutil.move(aside, store.artifact_folder(digest))
    assert states["calibration"] == ("stale", "its artifact is gone from the store")
    assert states["annotations"] == ("unknown", "waits for calibration — its artifact is gone from the store")


@pytest.mark.parametrize(
    ("asset", "step", "channel"), [("calibration", "calibration", ""), ("frames", "frames", "CAM_FRONT: ")]
)
def test_a_record_that_is_gone_from_the_store(recipe, asset, step, channel):
    store = Store(load_recipe(recipe).store_path)
    path = next(
        p
        for p in sorted((store.root / "actions").glob("*/*.json"))
        if f'"step": "{step}"' in (text := p.read_text()) and channel.strip(": ") in text
    )
    text = path.read_text()
    path.unlink()
    states = output(recipe)
    path.write_text(text)
    assert states[asset] == ("stale", f"{channel}the record of the action that made it is gone")


def test_what_can_be_told_without_a_run_did_not_fail_before(recipe, monkeypatch):
    edit(recipe, "topic: /odom}", "topic: /nowhere}")
    state, reason = output(recipe)["ego_poses"]
    report, _ = build(recipe, monkeypatch)
    assert state == report.outcomes[KEY].result == "failed"
    assert report.outcomes[KEY].reason == reason
    assert "/nowhere" in reason


def test_another_input_and_the_same_result(recipe, monkeypatch):
    """Where annotations have no boxes, they are the same whatever the calibration."""
    before = recipe.read_text()
    edit(recipe, "translation: [0, 0, 1]", "translation: [0, 0, 2]")
    assert build(recipe, monkeypatch)[0].succeeded
    recipe.write_text(before)
    states = output(recipe)
    assert build(recipe, monkeypatch)[0].succeeded
    why = "the store has the result for the new inputs"
    assert states["calibration"] == ("record-only", why)
    assert states["annotations"] == ("record-only", f"calibration changed ({why}), but the result did not")


def test_a_new_recording_was_never_made(recipe):
    other = recipe.parent / "bags" / "b.bag"
    shutil.copy(recipe.parent / "bags" / KEY, other)
    plan = survey(recipe).plan.bags["b.bag"]
    other.unlink()
    assert plan.assets["bag"].state in {"missing", "stale"}
    assert plan.assets["bag"].reason.startswith("new recording")


def test_a_new_recording_that_cannot_be_read(recipe, monkeypatch):
    """As `build` will say."""
    other = recipe.parent / "bags" / "b.bag"
    shutil.copy(recipe.parent / "bags" / KEY, other)
    other.write_bytes(other.read_bytes() + b"\0")  # its digest is not on record
    refuse(other, monkeypatch)
    plan = survey(recipe).plan
    other.unlink()
    assert plan.bags["b.bag"].assets["bag"].reason == (
        f"new recording, but {other} cannot be read; correct its permissions"
    )
    assert plan.bags[KEY].assets["bag"].state == "fresh"


def test_a_recording_that_was_touched_has_to_be_read(recipe, monkeypatch):
    """The last one here: even with its old time the file is doubted from now on."""
    (recipe.parent / "bags" / KEY).touch()
    why = "size or time changed; its content has to be read"
    states = output(recipe)
    assert states.pop("bag") == ("stale", why)
    assert set(states.values()) == {("unknown", f"waits for bag — {why}")}
    path = recipe.parent / "bags" / KEY
    refuse(path, monkeypatch)
    why += f", but {path} cannot be read; correct its permissions"
    assert output(recipe)["bag"] == ("stale", why)
