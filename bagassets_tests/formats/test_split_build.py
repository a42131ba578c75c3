"""By the command: small sets leave no split empty, and a recording that a new one moves is named, before and after."""

import json
import shutil
from collections import Counter
from pathlib import Path

import pytest

from bagassets.engine.splits import deal, moves
from bagassets.formats.dataset_build import DatasetInputs, deal_contents
from bagassets.formats.format import Part
from bagassets.recipe import load_recipe
from bagassets.recipe.model_splits import Splits
from bagassets.sample.drive import Target, write_arm_recordings
from bagassets_tests.in_process import QUICK, build, make_project, run_command
from bagassets_tests.series import write_parts
from bagassets_tests.small_drive import START_NS, write_drive

pytestmark = [pytest.mark.xdist_group("split_build"), pytest.mark.once]

FIRST = ("a.mcap", "b.mcap")
STALE = 3
ARM = """\
name: {name}
bags: {{root: {root}, settle_s: 0}}
rigs:
  - name: arm
    channels:
      CAM_WRIST: {{modality: camera, topic: /wrist/image_raw, undistort: false}}
    signals: {{joints: {{topic: /joint_states, field: position}}}}
preview: {{enabled: false}}
lerobot:
  fps: 10
  features: {{observation.state: {{signals: [joints], at: linear}}, observation.images.wrist: {{camera: CAM_WRIST, at: nearest}}}}
"""


def arriving():
    """Return the name of a recording that moves one of `FIRST`."""
    names = (f"c{number}.mcap" for number in range(100))
    before = deal(FIRST, Splits())
    return next(name for name in names if moves(before, deal([*FIRST, name], Splits())))


def run(folder, *args):
    return run_command("build", "--recipe", folder / "recipe.yaml", *args)


def splits_of(folder):
    return json.loads((folder / "dataset" / "nuscenes" / "v1.0-test" / "splits.json").read_bytes())


def write(folder, name, number):
    # Recordings with the same content would enter once.
    write_drive(folder / "bags" / name, "mcap", duration_s=1.4 + 0.1 * number)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("splits")
    for number, name in enumerate(FIRST):
        write(folder, name, number)
    (folder / "recipe.yaml").write_text(QUICK.format(name="splits", root="bags"))
    return folder, run(folder)


def test_two_recordings_are_one_in_train_and_one_in_val_and_the_build_says_so(project):
    folder, done = project
    assert done.returncode == 0, done.stderr
    found = splits_of(folder)
    assert sorted(len(scenes) for scenes in found.values()) == [1, 1]
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("splits:")]
    assert line.startswith("splits:  train 1 (")
    assert "% of the time, 80% asked for), val 1 (" in line
    assert line.endswith("; in the devkit custom_train, custom_val")


def test_a_recording_that_moves_is_named_before_and_after_and_a_pin_stops_it(project):
    folder, _ = project
    name = arriving()
    write(folder, name, 2)
    ((key, (was, now)),) = moves(deal(FIRST, Splits()), deal([*FIRST, name], Splits())).items()
    checked = run(folder, "--check")
    assert checked.returncode == STALE
    assert (
        f"{key} would move from {was} to {now}; pin it in `splits.pinned` to keep it where it is."
        in checked.stdout
    )
    assert json.loads(run(folder, "--check", "--json").stdout)["moved"] == {key: [was, now]}
    built = run(folder)
    assert (
        f"moved {key}: from {was} to {now}; pin it in `splits.pinned` to keep it where it is" in built.stdout
    )
    assert f"{Path(key).name}_000" in splits_of(folder)[f"custom_{now}"]

    text = (folder / "recipe.yaml").read_text()
    (folder / "recipe.yaml").write_text(text + f"splits: {{pin: {{{key}: {was}}}}}\n")
    reported = json.loads(run(folder, "--json").stdout)
    assert reported["moved"][key] == [now, was]
    assert f"{Path(key).name}_000" in splits_of(folder)[f"custom_{was}"]
    assert reported["splits"][was]["is_far"] in {True, False}
    assert run(folder, "--check").returncode == 0


def test_a_copy_goes_where_its_original_goes_and_does_not_count():
    contents = {f"drive_{number}": str(number) for number in range(5)}
    copies = contents | {f"copy_{number}": str(number) for number in range(5)}
    dealt = deal_contents(copies, Splits())
    assert sorted(dealt[f"copy_{number}"] for number in range(5)) == ["train"] * 4 + ["val"]
    assert all(dealt[f"copy_{number}"] == dealt[f"drive_{number}"] for number in range(5))


def test_recordings_without_scenes_fill_no_split():
    contents = {f"drive_{number}": str(number) for number in range(9)}
    for first in range(8):
        full = {f"drive_{first}", f"drive_{first + 1}"}
        dealt = deal_contents(contents, Splits(), contents.keys() - full)
        assert sorted(dealt[key] for key in full) == ["train", "val"]
        assert dealt.keys() == contents.keys()
        assert Counter(dealt.values())["val"] <= 3, "all others count, too"


def test_no_split_of_a_dataset_is_empty_beside_recordings_too_short_for_scenes(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path, ["a.bag"], duration_s=2.0)
    write_drive(tmp_path / "bags" / "b.bag", "ros1", duration_s=2.2)
    for number in range(3):
        write_drive(tmp_path / "bags" / f"short_{number}.bag", "ros1", duration_s=0.4 + 0.1 * number)
    report, _ = build(recipe_file, monkeypatch)
    assert report.succeeded
    folder = load_recipe(recipe_file).nuscenes.output / "v1.0-test"
    splits = json.loads((folder / "splits.json").read_text())
    assert sorted(len(scenes) for scenes in splits.values()) == [1, 1], splits


def test_names_of_no_recording_in_pins_and_named_datasets_are_told(tmp_path, monkeypatch):
    """Else `val` would lack a recording, and a dataset be empty, without a word."""
    named = """\
splits: {pinned: {day/a.bag: val, b.bag: val, day__a.bag: train}}
datasets:
  - {name: known, recordings: ["day*", day__a.bag], scenes: [day__a.bag_000, "day*_000", "day__a.bag_0*", "*_00[01]"]}
  - {name: unknown, recordings: ["night*"], scenes: [c.bag_000, "eve*_000"]}
"""
    recipe_file = make_project(
        tmp_path, ["day/a.bag"], text=QUICK + named.replace("{", "{{").replace("}", "}}")
    )
    for _ in range(2):  # the second has nothing to do
        report, _ = build(recipe_file, monkeypatch)
        assert report.succeeded
        pins, datasets = (one.problem for one in report.remarks if one.check == "unknown_recordings")
        more = "(nor what {} more of its names stand for); "
        assert (
            pins == f"splits.pinned: there is no recording day/a.bag {more.format(1)}did you mean day__a.bag?"
        )
        keys = "`bagassets status --all` lists the keys."
        assert datasets == f"datasets: unknown: there is no recording night* {more.format(2)}{keys}"


@pytest.mark.parametrize("glob", ["day", "day/"])
def test_a_folder_in_exclude_that_leaves_nothing_out_is_told(glob, tmp_path, monkeypatch):
    text = QUICK.replace("settle_s: 0", f"settle_s: 0, exclude: [{glob}, b.bag, '*/c.bag']")
    recipe_file = make_project(tmp_path, ["day/a.bag", "day/c.bag", "b.bag"], text=text)
    for _ in range(2):  # the second has nothing to do
        report, _ = build(recipe_file, monkeypatch)
        assert [one.problem for one in report.remarks if one.check == "unknown_recordings"] == [
            f"bags.exclude: {glob} is a folder, whose recordings it does not leave out; day/** does"
        ]


def test_limits_of_a_topic_of_no_recording_are_told(tmp_path, monkeypatch):
    limits = "{/odm: {{min_hz: 40}}, /cam/camera_info: {{min_hz: 5}}, /points: {{min_hz: 5}}, /no: {{required: true}}}}"
    text = f"{QUICK}checks: {{{{topic_rates: {{{{limits: {{{limits}}}}}}}}}\n"
    recipe_file = make_project(tmp_path, ["a.bag", "b.bag"], text=text)
    for _ in range(2):  # the second has nothing to do
        report, _ = build(recipe_file, monkeypatch)
        (remark,) = [one for one in report.remarks if one.check == "unknown_topics"]
        assert remark.problem == (
            "checks.topic_rates.limits: there is no topic /odm in the recordings (2 of 2 were looked at); did you mean /odom?"
        )


def write_arm(path, kind, seconds):
    write_arm_recordings([Target(path, kind)], duration_s=seconds)


@pytest.mark.parametrize(("text", "write"), [(QUICK, write_drive), (ARM, write_arm)], ids=["car", "arm"])
def test_a_recording_that_was_converted_beside_its_original_is_told(text, write, tmp_path, monkeypatch):
    """Its files differ, so it is in the dataset twice, and may be in `train` and `val`; what is too short is in none."""
    recipe_file = make_project(tmp_path, [], text=text)
    for name, seconds in {"a": 2.0, "short": 0.1}.items():
        write(tmp_path / "bags" / f"{name}.bag", "ros1", seconds)
        write(tmp_path / "bags" / f"{name}.mcap", "mcap", seconds)
    for _ in range(2):  # the second has nothing to do
        report, _ = build(recipe_file, monkeypatch)
        (remark,) = [one for one in report.remarks if one.check == "same_content"]
        assert remark.problem == (
            "a.bag, a.mcap hold the same data in different files, so each is in the dataset, perhaps in different splits; "
            "keep one, and name the others in bags.exclude or remove them."
        )


def test_an_excerpt_beside_the_whole_is_told(tmp_path, monkeypatch):
    """So is a file of a folder; not so what is in no dataset."""
    recipe_file, bags = make_project(tmp_path, []), tmp_path / "bags"
    first, second = write_parts(bags / "day.mcap", [6.0], 12.0)
    shutil.copy(first, bags / "best.mcap")
    shutil.copy(second, bags / "late.mcap")  # without its transforms, which are in the first
    write_drive(
        bags / "cut.bag", "ros1", 12.0, lambda topic, ns: topic == "/tf_static" or ns > START_NS + 4e9
    )
    for _ in range(2):  # the second has nothing to do
        report, _ = build(recipe_file, monkeypatch)
        (remark,) = [one for one in report.remarks if one.check == "same_content"]
        assert remark.problem == (
            "best.mcap, cut.bag hold parts of what day.mcap holds, so this is in the dataset twice, perhaps in different splits; "
            "keep the whole or the parts, and name the others in bags.exclude or remove them."
        )


def test_no_split_of_a_vision_dataset_is_empty_beside_recordings_too_short_for_sequences(
    tmp_path, monkeypatch
):
    drives = [f"{name}.bag" for name in "abcdefgh"]
    text = QUICK.replace("nuscenes: {{version: v1.0-test}}", "vision: {{frames: 8}}")
    recipe_file = make_project(tmp_path, [], text=text)
    for number, name in enumerate(drives):
        write_drive(tmp_path / "bags" / name, "ros1", duration_s=(0.4 if number < 6 else 1.0) + 0.05 * number)
    report, _ = build(recipe_file, monkeypatch)
    assert report.succeeded
    of_split = {
        split: len(json.loads((tmp_path / f"dataset/vision/annotations/{split}.json").read_text()))
        for split in ("train", "val")
    }
    assert min(of_split.values()) > 0, of_split


def test_all_datasets_have_the_same_splits_even_if_one_lacks_a_recording(tmp_path):
    keys = [f"drive_{number}" for number in range(7)]
    inputs = DatasetInputs(
        {
            "nuscenes": tuple(Part(key, key, "tables") for key in keys[1:]),
            "vision": tuple(Part(key, key, "sequences") for key in keys),
        },
        failed={"nuscenes": {keys[0]: "why"}},
    )
    recipe = load_recipe(make_project(tmp_path, []))
    assert inputs.dealt(recipe) == deal(keys, Splits())
