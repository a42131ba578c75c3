"""What a well-formed recipe cannot ask for, each refused at its line."""

import re

import pytest
import yaml

from bagassets.base.errors import RecipeError
from bagassets.recipe import parse_recipe

pytestmark = pytest.mark.once

CAMERA = {"modality": "camera", "topic": "/front"}
LIDAR = {"modality": "lidar", "topic": "/points"}


def rig(**fields):
    channels = {"CAM_FRONT": CAMERA, "LIDAR_TOP": LIDAR}
    return {
        "name": "van",
        "channels": channels,
        "ego_pose": {"source": "odometry", "topic": "/odom"},
    } | fields


def recipe(*rigs, **fields):
    return {"name": "yard", "bags": {"root": "bags"}, "rigs": list(rigs) or [rig()]} | fields


def problems(value, tmp_path):
    """Return field -> sentence of the refusal; {} if the recipe loads. Check that the line is the field's."""
    text = yaml.safe_dump(value, sort_keys=False)
    try:
        parse_recipe(text, tmp_path / "recipe.yaml")
    except RecipeError as err:
        found = {}
        for entry in str(err).splitlines():
            line, field, sentence = entry.removeprefix(f"{tmp_path / 'recipe.yaml'}:").split(": ", 2)
            shown = text.splitlines()[int(line) - 1]
            # The line of the field itself or, if it is not given, of what holds it; `- ` starts an entry.
            assert shown.strip().startswith(("- ", *re.split(r"[.\[]", field)))
            found[field] = sentence
        return found
    return {}


def camera(**fields):
    return rig(channels={"CAM_FRONT": CAMERA | fields})


def lidar(pose=None, **fields):
    changed = {} if pose is None else {"ego_pose": pose}
    return rig(channels={"LIDAR_TOP": LIDAR | fields}, **changed)


FIXED = {"source": "fixed"}
INTRINSICS = {"width": 4, "height": 3, "fx": 1, "fy": 1, "cx": 2, "cy": 1}


@pytest.mark.parametrize(
    "value",
    [
        recipe(),
        recipe(camera(undistort=True, target={"fx": 1, "fy": 1, "cx": 1, "cy": 1})),
        recipe(camera(intrinsics=INTRINSICS | {"distortion": [0.1] * 5})),
        recipe(lidar(deskew=True)),
        recipe(lidar(FIXED, deskew=False)),
        recipe(lidar(min_range_m=1, max_range_m=2)),
        recipe(rig(name="a", match=["a/**"]), rig(name="b")),
        recipe(scenes={"reference": "CAM_FRONT", "tolerance_s": 0.24, "keyframe_hz": 2}),
        recipe(bags={"root": "bags", "include": ["2024/**", "*.bag"], "exclude": ["**/test*"]}),
    ],
)
def test_what_is_right_is_accepted(value, tmp_path):
    assert problems(value, tmp_path) == {}


@pytest.mark.parametrize(
    ("value", "field", "words"),
    [
        (recipe(scenes={"reference": "CAM_FRNT"}), "scenes.reference", "did you mean CAM_FRONT"),
        (recipe(scenes={"reference": "RADAR"}), "scenes.reference", "the channels are CAM_FRONT, LIDAR_TOP"),
        (
            recipe(
                rig(signals={"joints": {"topic": "/a", "field": "b"}}),
                checks={"signal_values": {"limits": {"joint": {"max": 3}, "joints": {"max": 3}}}},
            ),
            "checks.signal_values.limits.joint", "no rig has a signal joint; did you mean joints?",
        ),
        (
            recipe(
                rig(signals={"joints": {"topic": "/a", "field": "b"}}),
                checks={"channels_present": {"optional": ["joints", "CAM_FRONT", "CAM_FRNT"]}},
            ),
            "checks.channels_present.optional[2]", "no rig has a channel or signal CAM_FRNT; did you mean CAM_FRONT?",
        ),
        (recipe(scenes={"tolerance_s": 0.25}), "scenes.tolerance_s", "0.25 s at 2 Hz"),
        (recipe(scenes={"keyframe_hz": 10}), "scenes.tolerance_s", "0.05 s at 10 Hz"),
        (recipe(scenes={"length_s": 5, "min_length_s": 6}), "scenes.min_length_s", "longer than a scene (5 s)"),
        (recipe(scenes={"length_s": 0.4, "min_length_s": 0}), "scenes.length_s", "between keyframes (0.5 s)"),
        (recipe(rig(urdf="no.urdf")), "rigs[van].urdf", "no.urdf"),
        (recipe(rig(urdf="~/rig.urdf")), "rigs[van].urdf", "`~` is not expanded"),
        (
            recipe(camera(intrinsics={"file": "no.yaml"})),
            "rigs[van].channels.CAM_FRONT.intrinsics.file", "no file",
        ),
        (
            recipe(camera(extrinsics={"file": "."})),
            "rigs[van].channels.CAM_FRONT.extrinsics.file", "is a folder; name the calibration file in it",
        ),
        (
            recipe(camera(intrinsics={"file": "~/cam.yaml"})),
            "rigs[van].channels.CAM_FRONT.intrinsics.file", "`~` is not expanded",
        ),
        (recipe(bags={"root": "~/bags"}), "bags.root", "`~` is not expanded"),
        (recipe(state="~"), "state", "`~` is not expanded"),
        (recipe(bags={"root": "bags", "message_definitions": ["no"]}), "bags.message_definitions[0]", "no folder"),
        (recipe(bags={"root": "bags", "include": ["/a/**"]}), "bags.include[0]", "cannot match"),
        (recipe(bags={"root": "bags", "exclude": ["a", "../b"]}), "bags.exclude[1]", "cannot match"),
        (recipe(bags={"root": "bags", "exclude": ["./a.bag"]}), "bags.exclude[0]", "cannot match"),
        (recipe(bags={"root": "bags", "exclude": [""]}), "bags.exclude[0]", "empty glob"),
        (recipe(rig(match=["a/../b"])), "rigs[van].match[0]", "cannot match"),
        (recipe(rig(name="a"), rig(name="b")), "rigs[b].match", "rig a before it matches `**`"),
        (recipe(rig(name="a", match=["a"]), rig(name="a")), "rigs[1].name", "another rig is called a"),
        (recipe(rig(required=["CAM_FRONT", "CAM"])), "rigs[van].required[1]", "CAM is not a channel of rig van"),
        (
            recipe(camera(undistort=False, target={"fx": 1, "fy": 1, "cx": 1, "cy": 1})),
            "rigs[van].channels.CAM_FRONT.target", "without undistortion",
        ),
        (
            recipe(camera(intrinsics=INTRINSICS | {"distortion": [0.1] * 3})),
            "rigs[van].channels.CAM_FRONT.intrinsics.distortion", "0 or 4 or 5 coefficients; found 3",
        ),
        (
            recipe(camera(undistort=False, output="as_recorded", to_8bit={"range": [0, 9]})),
            "rigs[van].channels.CAM_FRONT.to_8bit", "as_recorded",
        ),
        (recipe(lidar(FIXED, deskew=True)), "rigs[van].channels.LIDAR_TOP.deskew", "moving rig"),
        (
            recipe(lidar(min_range_m=3, max_range_m=3)),
            "rigs[van].channels.LIDAR_TOP.max_range_m", "greater than min_range_m (3 m)",
        ),
        (
            recipe(rig(ego_pose={"source": "tf", "global_frame": "/base_link"})),
            "rigs[van].ego_pose.global_frame", "the ego frame itself",
        ),
        (recipe(rig(ego_pose={"source": "tf"}, tf=[])), "rigs[van].tf", "ego_pose uses tf"),
        (
            recipe(rig(ego_pose={"source": "navsat", "topic": "/fix", "imu": "/fix"})),
            "rigs[van].ego_pose.imu", "sensor_msgs/Imu",
        ),
        (
            recipe(nuscenes={"categories": [{"name": "a"}, {"name": "a"}]}),
            "nuscenes.categories[1].name", "listed twice",
        ),
        (
            recipe(bags={"root": "bags", "series": {"a.bag": ["x_0.bag", "x_0.bag"]}}),
            "bags.series.a.bag[1]", "x_0.bag is listed twice",
        ),
        (
            recipe(bags={"root": "bags", "series": {"a.bag": ["x_0.bag", "x_1.bag"], "b.bag": ["x_1.bag", "x_2.bag"]}}),
            "bags.series.b.bag[0]", "x_1.bag is listed twice",
        ),
        (recipe(splits={"shares": {"train": 0.7}}), "splits.shares", "they add up to 0.7"),
        (recipe(splits={"pinned": {"monday": "tset"}}), "splits.pinned.monday", "tset is not a split"),
        (recipe(nuscenes={"output": ".bagassets/store"}), "nuscenes.output", "state folder"),
        (recipe(nuscenes={"output": "."}), "nuscenes.output", "state folder"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(value, field, words, tmp_path):
    found = problems(value, tmp_path)
    assert list(found) == [field]
    assert words in found[field]


def test_existing_urdf_and_definitions_are_found_beside_the_recipe(tmp_path):
    (tmp_path / "rig.urdf").write_text("<robot/>")
    (tmp_path / "msg").mkdir()
    value = recipe(rig(urdf="rig.urdf"), bags={"root": "bags", "message_definitions": ["msg"]})
    assert problems(value, tmp_path) == {}


def test_bag_root_that_is_a_file(tmp_path):
    (tmp_path / "bags").write_text("")
    assert "is a file" in problems(recipe(), tmp_path)["bags.root"]


def test_a_shared_store_is_a_folder_of_its_own(tmp_path):
    reported = problems(recipe(store="dataset", nuscenes={"output": "dataset/nuscenes"}), tmp_path)
    assert "the store" in reported["nuscenes.output"]
    assert "`~` is not expanded" in problems(recipe(store="~/store"), tmp_path)["store"]
    assert problems(recipe(store="/mnt/store"), tmp_path) == {}
    loaded = parse_recipe(yaml.safe_dump(recipe(store="../store")), tmp_path / "p" / "recipe.yaml")
    assert loaded.store_path == tmp_path / "store"
