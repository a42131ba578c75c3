"""Which rig made a recording, which of its channels are there, and why a recording takes no part."""

from dataclasses import replace

import pytest

from bagassets.assets.selection import choose_rig, present_channels, skip_reason
from bagassets.formats import trajectory_map
from bagassets.formats.catalogue import OUR_ASSETS
from bagassets.formats.nuscenes import selection
from bagassets.recipe.model import Recipe
from bagassets_tests.pose_data import CLOUD, IMAGE, T0, Msg, Recorded, S, header

pytestmark = pytest.mark.once

CHANNELS = {
    "CAM_FRONT": {"modality": "camera", "topic": "/cam"},
    "LIDAR_TOP": {"modality": "lidar", "topic": "/points"},
}


def recipe(*rigs, min_duration_s=0.0):
    fields = [{"channels": CHANNELS, "ego_pose": {"source": "fixed"}} | rig for rig in rigs]
    bags = {"root": "bags", "min_duration_s": min_duration_s}
    return Recipe.model_validate({"name": "test", "bags": bags, "rigs": fields})


VAN = {"name": "van", "match": ["van/**"]}
CAR = {"name": "car", "match": ["*.bag", "cars/**"]}


@pytest.mark.parametrize(
    ("path", "rig"),
    [
        ("van/a.bag", "van"),
        ("van/deep/a.bag", "van"),
        ("a.bag", "car"),
        ("cars/a.mcap", "car"),
        ("other/a.mcap", None),
    ],
)
def test_the_first_rig_whose_globs_match_made_it(path, rig):
    chosen = choose_rig(recipe(VAN, CAR), path)
    assert (chosen and chosen.name) == rig


def test_of_two_rigs_that_match_the_first_counts():
    assert choose_rig(recipe({"name": "one"}, {"name": "two"}), "a.bag").name == "one"


def inventory(*topics):
    """Three seconds, in which each of the topics has messages."""
    types = {"/cam": IMAGE, "/points": CLOUD}
    entries = [(name, types[name], T0, Msg(header=header(T0, "x"))) for name in topics]
    return replace(Recorded(*entries, topics=list(types.items())).inventory(), end_ns=T0 + 3 * S)


def reason(inv, *rigs, path="a.bag", **bags):
    asked = recipe(*(rigs or [{"name": "car"}]), **bags)
    return skip_reason(asked, choose_rig(asked, path), inv)


def test_channels_without_messages_are_not_there():
    rig = recipe({"name": "car"}).rigs[0]
    assert list(present_channels(rig, inventory("/cam", "/points"))) == ["CAM_FRONT", "LIDAR_TOP"]
    assert list(present_channels(rig, inventory("/points"))) == ["LIDAR_TOP"]


def test_a_recording_with_one_channel_takes_part():
    assert reason(inventory("/points")) is None


def test_one_that_no_rig_matches_does_not():
    assert reason(inventory("/points"), VAN) == "no rig of the recipe matches its path"


def test_one_without_any_channel_does_not():
    assert reason(inventory()) == "none of the channels of rig car has readable messages"


@pytest.mark.parametrize(
    ("least_s", "said"),
    [
        (3.0, None),
        (3.5, "3.0 s long, bags.min_duration_s asks for 3.5 s"),
        (10.0, "3.0 s long, bags.min_duration_s asks for 10 s"),
    ],
)
def test_a_short_one_does_not(least_s, said):
    assert reason(inventory("/points"), min_duration_s=least_s) == said


def test_one_that_lacks_required_channels_does_not_and_all_are_named():
    rig = {"name": "car", "required": ["CAM_FRONT", "LIDAR_TOP"]}
    assert reason(inventory("/cam", "/points"), rig) is None
    assert reason(inventory("/points"), rig) == "required channel without readable messages: CAM_FRONT (/cam)"
    assert reason(inventory(), rig) == (
        "required channel without readable messages: CAM_FRONT (/cam), LIDAR_TOP (/points)"
    )


def test_steps_keep_their_names_for_ever():
    """A store knows actions by the names of steps: under another name everything would be made again."""
    steps = [
        *(asset.step for asset in OUR_ASSETS),
        *(hidden.step for asset in OUR_ASSETS for hidden in asset.along),
        trajectory_map.STEP,
        trajectory_map.SHELL_STEP,
        selection.FACTS_STEP,
        selection.SUBSET_STEP,
    ]
    names = [step.name for step in steps]
    assert len({*names}) == len(names)
    assert {*names} >= {
        "inventory", "calibration", "ego_poses", "annotations", "frames", "sweeps", "nuscenes_tables",
        "vision_sequences", "preview", "track", "trajectory_map", "map_shell", "scene_facts", "scene_subset",
    }  # fmt: skip
