"""A wrong recipe is refused with file, line, field and a sentence; a right one means the same everywhere."""

import os
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bagassets.base.errors import RecipeError
from bagassets.recipe import load_recipe, parse_recipe
from bagassets.recipe.model_checks import Checks

GOOD = """\
name: yard
bags:
  root: bags
rigs:
  - name: van
    ego_frame: base_link
    ego_pose:
      source: odometry
      topic: /odom
    channels:
      CAM_FRONT:
        modality: camera
        topic: /front/image_raw
        quality: 80
      LIDAR_TOP:
        modality: lidar
        topic: /points
scenes:
  keyframe_hz: 2
"""


def refused(text, tmp_path):
    """Return the lines of the refusal without the path."""
    path = tmp_path / "recipe.yaml"
    with pytest.raises(RecipeError) as caught:
        parse_recipe(text, path)
    lines = str(caught.value).splitlines()
    assert all(line.startswith(f"{path}:") for line in lines)
    return [line.removeprefix(f"{path}:") for line in lines]


def edited(old, new):
    assert GOOD.count(old) == 1
    return GOOD.replace(old, new)


def test_good_recipe_has_absolute_paths_whatever_the_current_folder(tmp_path, monkeypatch):
    project = tmp_path / "project"
    project.mkdir()
    (project / "recipe.yaml").write_text(GOOD)
    monkeypatch.chdir(tmp_path)
    relative = load_recipe("project/recipe.yaml")
    monkeypatch.chdir("/")
    absolute = load_recipe(project / "recipe.yaml")
    assert relative == absolute
    assert absolute.bags.root == project / "bags"
    assert absolute.state == project / ".bagassets"
    assert absolute.nuscenes.output == project / "dataset" / "nuscenes"
    assert absolute.rigs[0].channels["CAM_FRONT"].quality == 80


def test_environment_changes_nothing(tmp_path, monkeypatch):
    before = parse_recipe(GOOD, tmp_path / "recipe.yaml")
    monkeypatch.setenv("HOME", "/elsewhere")
    for name in ("NAME", "CLOCK", "BAGASSETS_RECIPE", "BAGS", "STATE", "bags__root"):
        monkeypatch.setenv(name, "from the environment")
    assert parse_recipe(GOOD, tmp_path / "recipe.yaml") == before


@pytest.mark.parametrize(
    ("old", "new", "line", "field", "words"),
    [
        ("quality: 80", "quality: high", 14, "rigs[van].channels.CAM_FRONT.quality", "whole number; found 'high'"),
        ("quality: 80", 'quality: "80"', 14, "rigs[van].channels.CAM_FRONT.quality", "without quotes"),
        ("quality: 80", "quality: 80.5", 14, "rigs[van].channels.CAM_FRONT.quality", "whole number; found the number"),
        ("quality: 80", "quality: 101", 14, "rigs[van].channels.CAM_FRONT.quality", "not be greater than 100"),
        ("quality: 80", "quality: true", 14, "rigs[van].channels.CAM_FRONT.quality", "whole number; found true"),
        ("quality: 80", "qualitty: 80", 14, "rigs[van].channels.CAM_FRONT.qualitty", "did you mean quality?"),
        ("quality: 80", "undistort: 1", 14, "rigs[van].channels.CAM_FRONT.undistort", "true or false"),
        ("quality: 80", "output: jpg", 14, "rigs[van].channels.CAM_FRONT.output", "jpeg, png or as_recorded"),
        (
            "quality: 80", "intrinsics: cam.yaml", 14, "rigs[van].channels.CAM_FRONT.intrinsics",
            "expected a mapping with `file`; found 'cam.yaml'",
        ),
        (
            "quality: 80", "extrinsics: {file: a.yaml, relativ_to: imu}", 14,
            "rigs[van].channels.CAM_FRONT.extrinsics.relativ_to", "did you mean relative_to?",
        ),
        ("quality: 80", "extrinsics: [0]", 14, "rigs[van].channels.CAM_FRONT.extrinsics", "a transform; found a list"),
        (
            "quality: 80", "extrinsics: {rotation: [1, 0, 0]}", 14,
            "rigs[van].channels.CAM_FRONT.extrinsics.rotation", "a list of 4 numbers; found a list of 3",
        ),
        (
            "quality: 80", "extrinsics: {rotation: [1, 0, 0, 1]}", 14,
            "rigs[van].channels.CAM_FRONT.extrinsics.rotation", "unit quaternion",
        ),
        (
            "quality: 80", "extrinsics: {translation: [1, x, 3]}", 14,
            "rigs[van].channels.CAM_FRONT.extrinsics.translation[1]", "a number; found 'x'",
        ),
        ("quality: 80", "to_8bit: {range: [9, 3]}", 14, "rigs[van].channels.CAM_FRONT.to_8bit.range", "smaller than"),
        ("modality: camera", "modality: camra", 12, "rigs[van].channels.CAM_FRONT.modality", "did you mean camera?"),
        ("modality: camera", "frame: x", 11, "rigs[van].channels.CAM_FRONT.modality", "camera, lidar or radar"),
        ("modality: lidar", "modality:", 16, "rigs[van].channels.LIDAR_TOP.modality", "camera, lidar or radar"),
        ("CAM_FRONT:", "cam-front:", 11, "rigs[van].channels.cam-front", "capitals"),
        ("/points", "", 17, "rigs[van].channels.LIDAR_TOP.topic", "needs a value: topic with the data"),
        ("source: odometry", "source: odometri", 8, "rigs[van].ego_pose.source", "did you mean odometry?"),
        ("source: odometry", "max_gap_s: 1", 7, "rigs[van].ego_pose.source", "odometry, pose, tf, navsat, ncom or fixed"),
        ("source: odometry", "source: fixed", 9, "rigs[van].ego_pose.topic", "no such field"),
        # `pose` is a field here and a tag elsewhere; `tf` likewise.
        ("      topic: /odom", "      pose: {}", 9, "rigs[van].ego_pose.pose", "no such field"),
        ("    ego_frame: base_link", "    tf: /tf", 6, "rigs[van].tf", "a list, each entry text; found '/tf'"),
        ("    ego_frame: base_link", "    required: [CAM_BACK]", 6, "rigs[van].required[0]", "CAM_FRONT, LIDAR_TOP"),
        ("    ego_frame: base_link", "    match: []\n    pose: 1", 7, "rigs[van].pose", "no such field"),
        ("name: yard", "name: 5", 1, "name", "text; found the number 5; put it in quotes"),
        ("name: yard", "name: a/b", 1, "name", "found 'a/b'"),
        ("name: yard", "nmae: yard", 1, "nmae", "did you mean name?"),
        ("  root: bags", "  include: ['**']", 2, "bags.root", "required: folder searched for recordings"),
        ("  root: bags", "  root: [bags]", 3, "bags.root", "a path; found a list"),
        ("scenes:\n  keyframe_hz: 2", "scenes: [2]", 18, "scenes", "a mapping; found a list"),
        ("keyframe_hz: 2", "keyframe_hz: 0", 19, "scenes.keyframe_hz", "greater than 0"),
        ("keyframe_hz: 2", "keyframe_hz: .inf", 19, "scenes.keyframe_hz", "finite"),
        ("keyframe_hz: 2", "keyframe_hz: 12:30", 19, "scenes.keyframe_hz", "a number; found '12:30'"),
    ],
)  # fmt: skip
def test_wrong_field_is_named_with_its_line(old, new, line, field, words, tmp_path):
    found = refused(edited(old, new), tmp_path)
    assert any(entry.startswith(f"{line}: {field}: ") and words in entry for entry in found), found


def test_extrinsics_without_value_are_refused_with_the_other_open_questions(tmp_path):
    """As `init` leaves them where only the user knows them; a `urdf` or a `frame` answers as well."""
    text = edited("/points", "/points\n        extrinsics:")
    (reported,) = refused(text, tmp_path)
    assert reported.startswith(
        "18: rigs[van].channels.LIDAR_TOP.extrinsics: needs a value: transform `ego <- sensor`"
    )
    text = text.replace("ego_frame: base_link", "ego_frame:").replace("quality: 80", "extrinsics: ~")
    assert [int(entry.split(":")[0]) for entry in refused(text, tmp_path)] == [6, 14, 18]
    (tmp_path / "van.urdf").write_text("<robot name='van'/>")
    for answer in ("/points\n        frame: laser\n        extrinsics:", "/points\n        extrinsics: {}"):
        parse_recipe(edited("/points", answer), tmp_path / "recipe.yaml")
    named = edited("/points", "/points\n        extrinsics:").replace(
        "ego_frame:", "urdf: van.urdf\n    ego_frame:"
    )
    parse_recipe(named, tmp_path / "recipe.yaml")


CART = """\
  - name: cart
    match: ["cart/**"]
    ego_pose: {source: fixed}
    channels: {LIDAR_TOP: {modality: lidar, topic: /scan}}
"""


def test_open_questions_of_a_rig_leave_the_others_alone(tmp_path):
    good = edited("rigs:\n", f"rigs:\n{CART}")
    text = good.replace("      source: odometry\n      topic: /odom\n", "").replace(
        "quality: 80", "extrinsics:"
    )
    cart, van = parse_recipe(text, tmp_path / "recipe.yaml").rigs
    assert cart.questions == ()
    assert [
        question.removeprefix(f"{tmp_path}/recipe.yaml:").split(": ")[:2] for question in van.questions
    ] == [
        ["11", "rigs[van].ego_pose"],
        ["16", "rigs[van].channels.CAM_FRONT.extrinsics"],
    ]
    gone = text.replace("    ego_pose:\n", "")
    (question, _) = parse_recipe(gone, tmp_path / "recipe.yaml").rigs[1].questions
    assert "rigs[van].ego_pose: this field is required" in question
    # With anything else that is wrong, or without a rig to build, all of it is reported.
    assert len(refused(text.replace("keyframe_hz: 2", "keyframe_hz: 0"), tmp_path)) == 3
    assert len(refused(text.replace("name: van", "name: cart"), tmp_path)) == 3
    assert len(refused(text.replace("ego_pose: {source: fixed}", "ego_pose:"), tmp_path)) == 3
    assert [rig.questions for rig in parse_recipe(good, tmp_path / "recipe.yaml").rigs] == [(), ()]


def test_only_a_camera_has_extrinsics_from_a_file(tmp_path):
    for place in ("{file: calib.yaml}", "{file: calib.yaml, relative_to: imu, camera: cam0}"):
        (reported,) = refused(edited("/points", f"/points\n        extrinsics: {place}"), tmp_path)
        assert reported.startswith(
            "18: rigs[van].channels.LIDAR_TOP.extrinsics: only a camera's extrinsics can come from a file"
        )


@pytest.mark.parametrize(
    ("names", "reported"),
    [
        (("van", "yard"), "rigs[yard].ego_pose"), (("van", "van"), "rigs[1].ego_pose"), (("van", ""), "rigs[1].ego_pose"),
    ],
)  # fmt: skip
def test_a_rig_is_named_if_its_name_is_its_own(tmp_path, names, reported):
    rigs = "".join(
        f"  - {{name: {name}, ego_pose: {pose}, channels: {{CAM: {{modality: camera, topic: /cam}}}}}}\n"
        for name, pose in zip(names, ("{source: fixed}", "4"), strict=True)
    )
    found = refused(f"name: yard\nbags: {{root: bags}}\nrigs:\n{rigs}", tmp_path)
    assert [entry.split(": ")[1] for entry in found if "ego_pose" in entry] == [reported]


def test_all_mistakes_are_reported_at_once_in_order_of_lines(tmp_path):
    text = edited("quality: 80", "quality: high").replace("name: yard", "name: 5").replace("hz: 2", "hz: -2")
    assert [int(entry.split(":")[0]) for entry in refused(text, tmp_path)] == [1, 14, 19]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("name: x\nbags: {root: a}\nname: y\n", 3, "name: given twice, first in line 1"),
        ("bags:\n  root: a\n  root: b\n", 3, "bags.root: given twice, first in line 2"),
        ("name: x\nbags:\n\troot: a\n", 3, "tab"),
        ("name: [x\nbags: 4\n", 2, "not valid YAML"),
        ("name: 'x\n", 2, "not valid YAML"),
        ("name: x\n---\nname: y\n", 2, "one YAML document"),
        (
            "name: x\n<<<<<<< HEAD\nbags: a\n=======\nbags: b\n>>>>>>> branch\n",
            2,
            "a merge in git left both sides here",
        ),
        (
            "<<<<<<< HEAD\nname: x\n=======\nname: y\n>>>>>>> branch\n",
            1,
            "a merge in git left both sides here",
        ),
        ("name: !env USER\n", 1, "tag !env"),
        ("name: !!python/object:os.system x\n", 1, "tag"),
        ("name: !!int x\n", 1, "'x' is not a number"),
        ("a: &a\n  b: *a\n", 2, "refers to a value that contains it"),
        ("a: &a\n  <<: *a\n", 2, "refers to a value that contains it"),
        ("a: *b\n", 1, "undefined alias"),
        ("? [x, y]\n: 3\n", 1, "name must be plain text"),
        ("name: \x07\n", 1, "character"),
        ("- name: x\n", 1, "starts with a list"),
        ("just words\n", 1, "starts with a text"),
        ("", 1, "is empty"),
        ("# nothing but a comment\n", 1, "is empty"),
    ],
)
def test_what_is_no_recipe_at_all(text, line, words, tmp_path):
    (found,) = refused(text, tmp_path)
    assert found.startswith(f"{line}:"), found
    assert words in found


def test_deep_nesting_is_refused_not_a_crash(tmp_path):
    assert "nested" in refused("a: " + "[" * 5000, tmp_path)[0]


def test_anchors_and_merges_mean_what_yaml_says(tmp_path):
    text = GOOD.replace("      CAM_FRONT:", "      CAM_FRONT: &camera").replace(
        "      LIDAR_TOP:",
        "      CAM_BACK:\n        <<: *camera\n        topic: /back/image_raw\n      LIDAR_TOP:",
    )
    channels = parse_recipe(text, tmp_path / "r.yaml").rigs[0].channels
    assert channels["CAM_BACK"].quality == 80
    assert channels["CAM_BACK"].topic == "/back/image_raw"
    wrong = text.replace("quality: 80", "quality: 800")
    # Both users of the anchor are wrong, and both for what stands in line 14.
    assert [entry.split(": ")[0] for entry in refused(wrong, tmp_path)] == ["14", "14"]


def test_scalars_without_the_surprises_of_yaml_1_1(tmp_path):
    text = edited("name: yard", "name: 2024-05-01").replace("keyframe_hz: 2", "keyframe_hz: 1e0")
    text = text.replace(
        "    ego_frame: base_link", "    annotations:\n      - {topic: /b, categories: {1: car, yes: bus}}"
    )
    recipe = parse_recipe(text, tmp_path / "r.yaml")
    assert recipe.name == "2024-05-01"
    assert recipe.scenes.keyframe_hz == 1.0
    assert recipe.rigs[0].annotations[0].categories == {"1": "car", "yes": "bus"}
    assert "found '010'" in refused(edited("quality: 80", "quality: 010"), tmp_path)[0]


def test_a_check_that_is_named_without_fields_is_as_if_it_were_not():
    """Then `bagassets docs recipe` says of each check what its severity is."""
    for name, field in Checks.model_fields.items():
        if name != "enabled":
            assert field.default == type(field.default)(), name


def test_byte_order_mark_and_windows_line_ends(tmp_path):
    path = tmp_path / "recipe.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    assert load_recipe(path).name == "yard"


def test_frames_lose_their_leading_slash(tmp_path):
    recipe = parse_recipe(edited("ego_frame: base_link", "ego_frame: /base_link"), tmp_path / "r.yaml")
    assert recipe.rigs[0].ego_frame == "base_link"


def test_missing_folder_unreadable_and_binary_files(tmp_path):
    with pytest.raises(RecipeError, match=r"no recipe here; make one with `bagassets init"):
        load_recipe(tmp_path / "recipe.yaml")
    with pytest.raises(RecipeError, match="this is a folder"):
        load_recipe(tmp_path)
    path = tmp_path / "latin.yaml"
    path.write_bytes(b"name: x\n# caf\xe9\n")
    with pytest.raises(RecipeError, match=r"latin.yaml:2: .*UTF-8"):
        load_recipe(path)
    if os.geteuid() != 0:
        path.chmod(0)
        with pytest.raises(RecipeError, match="cannot be read"):
            load_recipe(path)


@given(st.text(max_size=60))
def test_any_text_gives_a_recipe_or_a_recipe_error(text):
    try:
        parse_recipe(text, Path("/nowhere/recipe.yaml"))
    except RecipeError as err:
        assert re.match(r"/nowhere/recipe\.yaml:\d+: ", str(err))  # noqa: PT017  (no error is right too)


@given(
    st.sampled_from(GOOD.splitlines()),
    st.sampled_from(["null", "[]", "{}", "''", "[[1]]", "{a: 1}", "-1", "yes", "x"]),
)
def test_any_field_with_any_value_gives_a_recipe_or_a_line(line, value):
    text = GOOD.replace(line, f"{line.partition(':')[0]}: {value}", 1)
    try:
        parse_recipe(text, Path("/nowhere/recipe.yaml"))
    except RecipeError as err:
        for entry in str(err).splitlines():
            assert re.match(r"/nowhere/recipe\.yaml:\d+: ", entry), entry


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("{topic: /j, field: position}", "{topic: /j, field: 5}",
         ["12: rigs[arm].signals.joints.field: expected text or a list, each entry text; found the number 5."]),
        ("field: position", "field: [a, 5]",
         ["12: rigs[arm].signals.joints.field[1]: expected text; found the number 5; put it in quotes if it is meant as text."]),
        ("field: position", 'field: "a[["',
         ["12: rigs[arm].signals.joints.field: must be the path of a field, as in `position`, `pose.position` or `axes[2]`; found 'a[['."]),
        ("task: Push it.", "task: [Push it.]", ["19: lerobot.task: expected text or a mapping; found a list of 1."]),
        ("task: Push it.", "task: {topik: /task, topic: /task}",
         ["19: lerobot.task.topik: no such field here; the fields are topic, field. `bagassets docs recipe` explains them."]),
        ("a.bag: true", "a.bag: joined",
         ["5: bags.series.a.bag: expected true or false or a list, each entry text; found 'joined'."]),
        ("a.bag: true", "a.bag: [a_0.bag]",
         ["5: bags.series.a.bag: must have at least 2 entries; found a list of 1."]),
        ("camera, topic: /wrist, undistort: false", "lidar, topic: /p, point_times: ignored",
         ["10: rigs[arm].channels.CAM_WRIST.point_times: expected a mapping or `ignore`; found 'ignored'."]),
        ("camera, topic: /wrist, undistort: false", "lidar, topic: /p, point_times: {unit: h, since: clock}",
         ["10: rigs[arm].channels.CAM_WRIST.point_times.unit: must be s, ms, us or ns; found 'h'."]),
    ],
)  # fmt: skip
def test_of_a_field_that_takes_several_types_one_sentence_says_which(old, new, said, tmp_path):
    """Pydantic has an error for each of them, in terms of its own."""
    text = """
name: arm
bags:
  root: bags
  series: {a.bag: true}
rigs:
  - name: arm
    channels:
      CAM_WRIST:
        {modality: camera, topic: /wrist, undistort: false}
    signals:
      joints: {topic: /j, field: position}
lerobot:
  fps: 30
  features:
    action:
      signals:
        [joints]
  task: Push it.
"""
    assert text.count(old) == 1
    parse_recipe(text, tmp_path / "recipe.yaml")
    assert refused(text.replace(old, new), tmp_path) == said
