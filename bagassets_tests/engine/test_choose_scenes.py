"""What is known of a scene, which scenes a named dataset takes and why not others, and the tables of some of them."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from bagassets.base.errors import RecipeError
from bagassets.formats.nuscenes.selection import inside, require_own_scenes, scene_facts, unmet_condition
from bagassets.formats.nuscenes.subset import subset_facts, subset_tables
from bagassets.formats.nuscenes.tokens import attribute_token, category_token
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model_datasets import NamedDataset

pytestmark = pytest.mark.once

S = 1_000_000_000
NOON_NS = 1_718_971_200 * S  # 2024-06-21 12:00:00 UTC
SCENE = {
    "name": "scene-yard-0001", "start_ns": NOON_NS, "end_ns": NOON_NS + 20 * S, "daylight": "day",
    "points": [[48.0, 11.0], [48.1, 11.0]], "boxes": {"vehicle.car": 3, "human.pedestrian.adult": 1}, "speed_mps": 5.0,
}  # fmt: skip
SQUARE = [[47.0, 10.0], [47.0, 12.0], [49.0, 12.0], [49.0, 10.0]]


def why_not(scene=SCENE, rig="car", key="day/a.bag", **wanted):
    return unmet_condition(
        NamedDataset.model_validate({"name": "chosen", "output": "out"} | wanted), rig, key, scene
    )


@pytest.mark.parametrize(
    ("wanted", "reason"),
    [
        ({}, None),
        ({"rigs": ["car"]}, None),
        ({"rigs": ["van", "bus"]}, "made by rig car"),
        ({"recordings": ["day/*"]}, None),
        ({"recordings": ["night/*", "*.mcap"]}, "not one of the recordings"),
        ({"scenes": ["*-0001"]}, None),
        ({"scenes": ["*-0002"]}, "not one of the scenes"),
        ({"since": "2024-06-21T12:00:00Z"}, None),
        ({"since": "2024-06-21T12:00:01Z"}, "begins before"),
        ({"until": "2024-06-21T12:00:01Z"}, None),
        ({"until": "2024-06-21T12:00:00Z"}, "does not begin before"),
        ({"place": SQUARE}, None),
        ({"place": [[lat, lon + 5] for lat, lon in SQUARE]}, "elsewhere"),
        ({"daylight": ["day", "twilight"]}, None),
        ({"daylight": ["night"]}, "day"),
        ({"labels": ["vehicle.*"]}, None),
        ({"labels": ["vehicle.car", "vehicle.bus.*"]}, "no vehicle.bus.*"),
        ({"min_speed_mps": 5.0}, None),
        ({"min_speed_mps": 5.1}, "slower than 5.1 m/s"),
    ],
)
def test_the_first_condition_that_is_not_met_is_named(wanted, reason):
    said = why_not(**wanted)
    assert said == reason or (reason is not None and said.startswith(reason))


def test_what_is_not_known_is_not_assumed():
    unknown = SCENE | {"points": [], "daylight": None}
    assert why_not(unknown) is None
    assert why_not(unknown, place=SQUARE) == "its place is not known"
    assert why_not(unknown, daylight=["day"]) == "its daylight is not known"


def test_one_point_inside_is_enough():
    assert why_not(SCENE | {"points": [[0.0, 0.0], [48.0, 11.0]]}, place=SQUARE) is None


@given(st.floats(-3, 3), st.floats(-3, 3), st.integers(3, 12))
def test_a_point_is_inside_a_regular_polygon_by_its_distance(lat, lon, corners):
    """Surely inside within the inscribed circle, surely outside beyond the circumscribed one."""
    turns = 2 * np.pi * (np.arange(corners) + 0.123) / corners
    polygon = [[50 + np.sin(turn), 8 + np.cos(turn)] for turn in turns]
    distance = float(np.hypot(lat, lon))
    inner = float(np.cos(np.pi / corners))
    assume(distance < inner - 1e-6 or distance > 1 + 1e-6)
    assert inside([50 + lat, 8 + lon], polygon) == (distance < 1)


@pytest.mark.parametrize(
    ("point", "is_inside"),
    [
        ([0.5, 0.5], True),
        ([0.5, 2.5], True),
        ([1.5, 0.5], True),
        ([1.5, 1.5], False),
        ([1.5, 2.5], True),
        ([2.5, 0.5], False),
    ],
)
def test_a_concave_polygon(point, is_inside):
    """A U: one high, three wide, two arms."""
    u = [[0, 0], [0, 3], [2, 3], [2, 2], [1, 2], [1, 1], [2, 1], [2, 0]]
    assert inside(point, u) == is_inside
    assert inside(point, u[::-1]) == is_inside
    assert inside(point, u[3:] + u[:3]) == is_inside


# --- facts ----------------------------------------------------------------------------------

CAR, WALKER = "vehicle.car", "human.pedestrian.adult"


def tables():
    """Two scenes: keyframes at 0, 1, 2 s and at 10, 11 s; a car in both, a pedestrian in the second."""
    seconds = {"one": (0, 1, 2), "two": (10, 11), "still": (20,)}
    samples = [
        {"token": f"{scene}{t}", "scene_token": scene, "timestamp": NOON_NS // 1000 + t * 10**6}
        for scene, times in seconds.items()
        for t in reversed(times)
    ]
    boxes = {"one0": "c1", "one1": "c1", "two10": "c2", "two11": "w2"}
    return {
        "scene": [{"token": scene, "name": f"scene-{scene}", "log_token": "log"} for scene in seconds],
        "sample": samples,
        "instance": [{"token": t, "category_token": category_token(WALKER if t == "w2" else CAR)} for t in ("c1", "c2", "w2")],
        "sample_annotation": [
            {"token": f"a{n}", "sample_token": s, "instance_token": i, "attribute_tokens": [attribute_token("moving")] if i == "w2" else []}
            for n, (s, i) in enumerate(boxes.items())
        ],
        "log": [{"token": "log"}, {"token": "other"}],
        "sample_data": [
            {"token": f"d{row['token']}", "sample_token": row["token"], "ego_pose_token": f"p{row['token']}", "calibrated_sensor_token": f"s{row['scene_token']}"}
            for row in samples
        ],
        "ego_pose": [{"token": f"p{row['token']}"} for row in samples],
        "calibrated_sensor": [{"token": f"s{scene}"} for scene in seconds],
    }  # fmt: skip


FACTS = {
    "rig": "car", "key": "a.bag", "reference": "LIDAR_TOP", "channels": {"CAM": "camera"}, "categories": [CAR, WALKER],
    "attributes": ["moving", "parked"],
}  # fmt: skip


def driven(*seconds):
    """Along x at 3 m/s and y at 4 m/s."""
    stamps = NOON_NS + np.array(seconds, dtype=np.int64) * S
    positions = np.array([[3.0 * t, 4.0 * t, 0.0] for t in seconds])
    return Trajectory(stamps, positions, np.tile([1.0, 0, 0, 0], (len(seconds), 1)), 100 * S, 0)


def test_facts_of_scenes():
    track = [(NOON_NS + t * S, 48.0 + t / 1000, 11.0) for t in (0, 1, 2, 5, 10)]
    one, two, still = scene_facts(tables(), FACTS, driven(0, 30), track)
    assert one == {
        "token": "one", "name": "scene-one", "start_ns": NOON_NS, "end_ns": NOON_NS + 2 * S, "samples": 3,
        "length_m": 10.0, "speed_mps": 5.0, "boxes": {CAR: 2}, "daylight": "day",
        "points": [[48.0, 11.0], [48.001, 11.0], [48.002, 11.0]],
    }  # fmt: skip
    assert (two["boxes"], two["points"], two["length_m"]) == ({WALKER: 1, CAR: 1}, [[48.01, 11.0]], 5.0)
    assert list(two["boxes"]) == sorted(two["boxes"])
    # Without a point during the scene, the nearest in time; a scene of one instant has no speed.
    assert still["points"] == [[48.01, 11.0]]
    assert (still["speed_mps"], still["length_m"], still["boxes"], still["samples"]) == (0.0, 0.0, {}, 1)


def test_without_a_track_place_and_daylight_are_not_known():
    for facts in scene_facts(tables(), FACTS, driven(0, 30), []):
        assert (facts["points"], facts["daylight"]) == ([], None)


def test_where_there_is_no_pose_nothing_is_driven():
    one, two, _ = scene_facts(tables(), FACTS, driven(0, 1), [])
    assert (one["length_m"], one["speed_mps"]) == (5.0, 2.5)
    assert two["length_m"] == 0.0


# --- subsets --------------------------------------------------------------------------------


def test_the_tables_of_one_scene():
    whole = tables()
    kept = subset_tables(whole, ["two"])
    tokens = {name: {row["token"] for row in rows} for name, rows in kept.items()}
    assert tokens == {
        "scene": {"two"}, "sample": {"two10", "two11"}, "sample_data": {"dtwo10", "dtwo11"},
        "sample_annotation": {"a2", "a3"}, "log": {"log"}, "ego_pose": {"ptwo10", "ptwo11"},
        "calibrated_sensor": {"stwo"}, "instance": {"c2", "w2"},
    }  # fmt: skip
    assert subset_tables(whole, ["one", "two", "still"]) == {
        name: rows if name != "log" else rows[:1] for name, rows in whole.items()
    }


@pytest.mark.parametrize(
    ("scene", "categories", "attributes", "samples"),
    [("one", [CAR], [], 3), ("two", [CAR, WALKER], ["moving"], 2), ("still", [], [], 1)],
)
def test_the_facts_of_one_scene(scene, categories, attributes, samples):
    facts = subset_facts(FACTS, subset_tables(tables(), [scene]), 1.23456, "digest")
    assert facts == {
        "rig": "car", "key": "a.bag", "reference": "LIDAR_TOP", "channels": {"CAM": "camera"},
        "categories": categories, "attributes": attributes, "of": "digest",
        "counts": {"scenes": 1, "samples": samples, "duration_s": 1.235},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("glob", "is_refused"),
    [
        ("d_1.bag_003", True),
        ("d_1.bag_*", True),
        ("d_1*", True),
        ("d.bag_001", False),
        ("*_000", False),
        ("d*", False),
        ("e.bag_000", False),
    ],
)
def test_scenes_of_the_parts_of_a_drive_are_refused_and_told_which_there_are(glob, is_refused):
    wanted = NamedDataset.model_validate({"name": "chosen", "output": "out", "scenes": ["x*", glob]})
    scenes = [{"name": f"d.bag_00{number}"} for number in range(2)]
    given = (wanted, "d.bag", scenes, ("d_0.bag", "d_1.bag"))
    if is_refused:
        with pytest.raises(RecipeError) as caught:
            require_own_scenes(*given)
        assert str(caught.value) == (
            f"dataset chosen: {glob} names scenes of a part of d.bag, which is one recording now, with d.bag_000, d.bag_001; "
            "name some of these, or d.bag in `recordings`."
        )
    else:
        require_own_scenes(*given)
    require_own_scenes(wanted, "d_1.bag", scenes, ())
