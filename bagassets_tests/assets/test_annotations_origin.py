"""Boxes recorded in a far-away global frame move with the poses to the dataset's origin.

The steps `ego_poses` and `annotations` run one after the other on one recording: a parked car is
annotated in the global frame, in the ego frame and in a sensor's frame, while the vehicle drives by.
All three must come out at the same place, relative to the poses.
"""

from types import SimpleNamespace as Msg

import numpy as np
import pytest

from bagassets.assets.annotations import ANNOTATIONS, make_annotations
from bagassets.geometry.se3 import SE3
from bagassets.recipe.model import Rig
from bagassets_tests.facts import MadeUpFacts, calibrated, use_of
from bagassets_tests.pose_data import (
    ODOMETRY,
    T0,
    Recorded,
    S,
    Written,
    about_z,
    header,
    odometry,
    pose,
    vector,
)
from bagassets_tests.posed import Posed, at, truth

pytestmark = pytest.mark.once

DETECTIONS = "vision_msgs/msg/Detection3DArray"
CAR = SE3.create(about_z(0.7), (12.0, 5.0, 0.8))
MOUNT = SE3.create(about_z(1.1), (0.9, 0.0, 1.8))
CALIBRATION = calibrated(
    LIDAR_TOP={
        "frame": "lidar",
        "ego_SE3_sensor": {"translation": list(MOUNT.translation), "rotation": list(MOUNT.rotation)},
    }
)
# Where the map's zero is, seen from the drive.
PLACES = {
    "utm": (448_251.8, 5_411_932.7, 35.2),
    "far below zero": (-448_251.8, -20.0, -3.5),
    "near": (99_000.0, -20.0, 0.0),
    "here": (0.0, 0.0, 0.0),
}


def boxes(stamp_ns, frame, box):
    bounds = Msg(center=pose(box), size=vector((4.5, 1.9, 1.6)))
    guess = Msg(hypothesis=Msg(class_id="car", score=1.0))
    one = Msg(header=header(0, ""), results=[guess], bbox=bounds, id="parked")
    return Msg(header=header(stamp_ns, frame), detections=[one])


def annotated(tmp_path, place, frame):
    """Return the rows of annotations.parquet and the poses, with boxes given in `frame`."""
    shift = SE3.create((1, 0, 0, 0), PLACES[place])
    times = np.arange(0.0, 1.0, 0.02)
    odometries = [("/odom", ODOMETRY, at(t), odometry(at(t), shift @ truth(t), frame="map")) for t in times]
    map_SE3_frame = {
        "map": lambda _: SE3(),
        "base_link": lambda t: shift @ truth(t),
        "lidar": lambda t: shift @ truth(t) @ MOUNT,
    }[frame]
    entries = [
        ("/boxes", DETECTIONS, at(t), boxes(at(t), frame, map_SE3_frame(t).inverse() @ shift @ CAR))
        for t in np.arange(0.1, 0.9, 0.1)
    ]
    posed = Posed(tmp_path / "poses", {"source": "odometry", "topic": "/odom"}, *odometries)
    recorded = Recorded(*entries)
    rig = Rig.model_validate(
        {
            "name": "car",
            "channels": {"LIDAR_TOP": {"modality": "lidar", "topic": "/points"}},
            "ego_pose": {"source": "odometry", "topic": "/odom"},
            "annotations": [{"topic": "/boxes"}],
        }
    )
    facts = MadeUpFacts(recorded.inventory(), CALIBRATION, {"ego_poses": posed.artifact})
    use = use_of(ANNOTATIONS, rig, facts)
    made = Written(
        tmp_path / "boxes",
        lambda out: make_annotations(use.params, recorded, out, trajectory=posed.trajectory),
    )
    return made.artifact.read_table("annotations.parquet").to_pylist(), posed


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("frame", ["map", "base_link", "lidar"])
def test_boxes_of_every_frame_come_out_at_one_place(tmp_path, place, frame):
    rows, posed = annotated(tmp_path, place, frame)
    assert len(rows) == 8
    for row in rows:
        t = (row["stamp_ns"] - T0) / S
        ego = posed.trajectory.pose_at(row["stamp_ns"])
        box = SE3.create([row[f"q{axis}"] for axis in "wxyz"], [row[axis] for axis in "xyz"])
        # Seen from the vehicle, the box is where the car is, whatever the origin.
        found, expected = ego.inverse() @ box, truth(t).inverse() @ CAR
        np.testing.assert_allclose(found.translation, expected.translation, atol=1e-3)
        np.testing.assert_allclose(np.abs(found.rotation), np.abs(expected.rotation), atol=1e-6)


@pytest.mark.parametrize("place", PLACES)
def test_coordinates_are_local_enough_for_single_precision(tmp_path, place):
    rows, posed = annotated(tmp_path, place, "map")
    numbers = np.array([[row[axis] for axis in "xyz"] for row in rows])
    assert np.abs(numbers).max() < 1e5
    assert np.abs(numbers - numbers.astype(np.float32)).max() < 4e-3
    assert (posed.json["origin"] is not None) == (place in ("utm", "far below zero"))
