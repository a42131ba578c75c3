"""Boxes in frames that only TF knows: static ones, joints that move, and worlds that drift against each other."""

from types import SimpleNamespace as Msg

import numpy as np
import pytest
from pose_data import T0, TFMESSAGE, Recorded, S, about_z, header, pose, tf, transform, vector

from bagassets.assets.annotations import ANNOTATIONS, make_annotations
from bagassets.assets.boxes.collect import BoxCollector
from bagassets.assets.boxes.frames import BoxFrames
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.base.errors import LossLimitError
from bagassets.decode.model import BoxReading
from bagassets.engine.run_action import run_action
from bagassets.geometry.se3 import SE3
from bagassets.geometry.tf_tree import Edge, TfTree
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import Rig
from bagassets.recipe.model_annotations import AnnotationTopic
from bagassets.store.store import Store
from bagassets_tests.facts import MadeUpFacts, calibrated, use_of

pytestmark = pytest.mark.once

BOX = SE3((1.0, 0.0, 0.0, 0.0), (5.0, 1.0, 0.5))
STAMPS = T0 + np.arange(0, 21, dtype=np.int64) * S // 10


def odom_SE3_base(t):
    """Two seconds round a bend."""
    return SE3.create(about_z(0.2 * t), (8.0 * t, 0.5 * t * t, 0.0))


def map_SE3_odom(t):
    """A localisation that corrects odometry slowly."""
    return SE3.create(about_z(0.5 + 0.01 * t), (100.0 + 0.3 * t, -20.0, 0.0))


def base_SE3_mast(t):
    """A mast that turns."""
    return SE3.create(about_z(1.5 * t), (0.0, 0.0, 2.0))


MAST_SE3_TOOL = SE3.create(about_z(-0.3), (0.4, 0.0, 0.1))
BASE_SE3_EXTRA = SE3.create(about_z(np.pi / 2), (2.0, 0.0, 0.0))


def edge(parent, child, source, at, stamps=STAMPS):
    poses = [at((int(stamp) - T0) / S) for stamp in stamps]
    return Edge(
        parent,
        child,
        source,
        stamps,
        np.array([p.translation for p in poses]),
        np.array([p.rotation for p in poses]),
    )


def tree(*, mast=STAMPS):
    static = [
        Edge.fixed("mast", "tool", "tf_static", MAST_SE3_TOOL),
        Edge.fixed("base_link", "extra", "tf_static", BASE_SE3_EXTRA),
        Edge.fixed("island", "beach", "tf_static", SE3()),
    ]
    moving = [
        edge("map", "odom", "tf", map_SE3_odom),
        edge("odom", "base_link", "tf", odom_SE3_base),
        edge("base_link", "mast", "tf", base_SE3_mast, mast),
    ]
    return TfTree(static, moving)


def trajectory():
    poses = [odom_SE3_base((int(stamp) - T0) / S) for stamp in STAMPS]
    positions = np.array([p.translation for p in poses])
    return Trajectory(STAMPS, positions, np.array([p.rotation for p in poses]), S // 5, 0)


def frames(**changes):
    fields = {"origin_m": (0.0, 0.0, 0.0), "tree": tree()} | changes
    return BoxFrames("odom", "base_link", {"lidar": SE3()}, trajectory(), **fields)


TRUTH = {
    "extra": lambda t: odom_SE3_base(t) @ BASE_SE3_EXTRA,
    "mast": lambda t: odom_SE3_base(t) @ base_SE3_mast(t),
    "tool": lambda t: odom_SE3_base(t) @ base_SE3_mast(t) @ MAST_SE3_TOOL,
    "map": lambda t: map_SE3_odom(t).inverse(),
}


def box(frame, stamp_ns, track="1"):
    return BoxReading(int(stamp_ns), frame, BOX, (2.0, 4.0, 1.5), track, "car", source="/boxes")


@pytest.mark.parametrize("frame", TRUTH)
@pytest.mark.parametrize("t", [0.0, 0.7, 1.9])
def test_a_box_in_a_frame_of_tf_is_placed_at_its_own_time(frame, t):
    centers, rotations, valid = frames().place([box(frame, T0 + round(t * S))])
    truth = TRUTH[frame](t) @ BOX
    assert valid.all()
    np.testing.assert_allclose(centers[0], truth.translation, atol=1e-9)
    assert abs(np.dot(rotations[0], truth.rotation)) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("frame", TRUTH)
def test_between_transforms_it_is_interpolated(frame):
    t = 0.75
    centers, _, _ = frames().place([box(frame, T0 + round(t * S))])
    np.testing.assert_allclose(centers[0], (TRUTH[frame](t) @ BOX).translation, atol=0.02)


def test_the_origin_is_taken_off_boxes_in_worlds_but_not_off_those_on_the_vehicle():
    origin = (1000.0, 2000.0, 0.0)
    moved = Trajectory(STAMPS, trajectory().positions_m - np.array(origin), trajectory().rotations, S // 5, 0)
    away = BoxFrames("odom", "base_link", {}, moved, origin, tree())
    for frame, at in TRUTH.items():
        centers, _, _ = away.place([box(frame, T0 + S)])
        np.testing.assert_allclose(centers[0], np.array((at(1.0) @ BOX).translation) - origin, atol=1e-9)


def test_boxes_of_many_frames_keep_their_order():
    names = ["odom", "tool", "lidar", "map", "base_link", "@dataset", "extra", "tool"]
    boxes = [box(name, T0 + number * S // 10, str(number)) for number, name in enumerate(names)]
    together, _, valid = frames().place(boxes)
    assert valid.all()
    for number, one in enumerate(boxes):
        np.testing.assert_array_equal(together[number], frames().place([one])[0][0])


def test_no_box_is_no_trouble():
    centers, rotations, valid = frames().place([])
    assert (centers.shape, rotations.shape, valid.shape) == ((0, 3), (0, 4), (0,))


def test_frames_of_another_tree_and_without_tf_are_not_known():
    assert frames().knows("tool")
    assert not frames().knows("beach")
    assert not frames(tree=TfTree()).knows("tool")
    assert frames().describe().endswith("by TF extra, map, mast, tool")


def test_where_a_transform_pauses_the_box_is_lost_with_a_reason():
    pausing = np.concatenate([STAMPS[:5], STAMPS[12:]])
    collector = BoxCollector(frames(tree=tree(mast=pausing)), {"/boxes": AnnotationTopic(topic="/boxes")})
    collector.add(box("mast", T0 + 8 * S // 10, "a"))
    collector.add(box("mast", T0 + 2 * S // 10, "b"))
    assert collector.finish().tracks == ["b"]
    assert sum(collector.counts["/boxes"].lost.values()) == 1


# --- the step ----------------------------------------------------------------------------

DETECTIONS = "vision_msgs/msg/Detection3DArray"


def detections(stamp_ns, frame):
    result = Msg(hypothesis=Msg(class_id="car", score=1.0))
    item = Msg(
        header=header(0, ""),
        results=[result],
        bbox=Msg(center=pose(BOX), size=vector((4.0, 2.0, 1.5))),
        id="1",
    )
    return Msg(header=header(stamp_ns, frame), detections=[item])


def recording(frame):
    stamps = [int(stamp) for stamp in STAMPS]
    return Recorded(
        *(("/boxes", DETECTIONS, stamp, detections(stamp, frame)) for stamp in stamps[5:10]),
        *(
            (
                "/tf",
                TFMESSAGE,
                stamp,
                tf(transform(stamp, "base_link", "mast", base_SE3_mast((stamp - T0) / S))),
            )
            for stamp in stamps
        ),
        ("/tf_static", TFMESSAGE, T0, tf(transform(T0, "mast", "tool", MAST_SE3_TOOL))),
    )


RIG = Rig.model_validate(
    {
        "name": "r",
        "channels": {"LIDAR_TOP": {"modality": "lidar", "topic": "/lidar"}},
        "ego_pose": {"source": "odometry", "topic": "/odom"},
        "annotations": [{"topic": "/boxes"}],
    }
)
CALIBRATION = calibrated(LIDAR_TOP={"frame": "lidar"})


def annotate(tmp_path, recorded):
    store = Store(tmp_path)
    pending = store.begin(EGO_POSES.step.action({"ego": 1}, {}))
    pending.out.write_json("ego_poses.json", {"global_frame": "odom", "origin": None})
    ego_poses = pending.commit({}).artifact
    use = use_of(ANNOTATIONS, RIG, MadeUpFacts(recorded.inventory(), CALIBRATION, {"ego_poses": ego_poses}))
    outcome = run_action(
        store,
        ANNOTATIONS.action(use, recorded.inventory()),
        lambda out: make_annotations(use.params, recorded, out, trajectory=trajectory()),
    )
    return use, outcome.artifact


def test_the_step_reads_transforms_for_boxes_that_need_them(tmp_path):
    use, artifact = annotate(tmp_path, recording("tool"))
    assert use.topics == ("/boxes", "/tf", "/tf_static")
    table = artifact.read_table("annotations.parquet")
    truth = [(TRUTH["tool"]((int(stamp) - T0) / S) @ BOX).translation for stamp in STAMPS[5:10]]
    np.testing.assert_allclose(np.stack([table[axis].to_numpy() for axis in "xyz"], axis=1), truth, atol=1e-9)


@pytest.mark.parametrize("source", ["/tf", "/tf_static"])
def test_one_kind_of_transforms_is_enough(tmp_path, source):
    stamps = [int(stamp) for stamp in STAMPS]
    mounted = [(source, TFMESSAGE, T0, tf(transform(T0, "base_link", "rack", BASE_SE3_EXTRA)))]
    boxes = [("/boxes", DETECTIONS, stamp, detections(stamp, "rack")) for stamp in stamps[5:10]]
    use, artifact = annotate(tmp_path, Recorded(*boxes, *mounted))
    assert use.topics == ("/boxes", source)
    table = artifact.read_table("annotations.parquet")
    truth = [(odom_SE3_base((stamp - T0) / S) @ BASE_SE3_EXTRA @ BOX).translation for stamp in stamps[5:10]]
    np.testing.assert_allclose(np.stack([table[axis].to_numpy() for axis in "xyz"], axis=1), truth, atol=1e-9)


@pytest.mark.parametrize("frame", ["odom", "lidar", "base_link"])
def test_the_step_reads_no_transforms_for_boxes_that_do_not(tmp_path, frame):
    use, artifact = annotate(tmp_path, recording(frame))
    assert use.topics == ("/boxes",)
    assert artifact.read_table("annotations.parquet").num_rows == 5


def test_a_frame_that_tf_does_not_know_either_fails_with_all_that_are_known(tmp_path):
    with pytest.raises(LossLimitError, match=r"in frame mars, but the known frames are .*by TF mast, tool"):
        annotate(tmp_path, recording("mars"))
