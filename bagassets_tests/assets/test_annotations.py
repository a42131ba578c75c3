"""Boxes from every message type we know: decoded, mapped, placed in the global frame, accounted for."""

from dataclasses import replace
from types import SimpleNamespace as Msg

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bagassets.assets.annotations import ANNOTATIONS, make_annotations
from bagassets.assets.asset import as_json
from bagassets.assets.boxes.collect import BoxCollector
from bagassets.assets.boxes.frames import BoxFrames
from bagassets.assets.boxes.table import BoxTable
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.base.errors import DecodeError, LossLimitError, RecipeError
from bagassets.decode.loading import keyed_decoder
from bagassets.decode.model import BoxReading
from bagassets.engine.run_action import run_action
from bagassets.geometry.se3 import SE3
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import Limits, Rig
from bagassets.recipe.model_annotations import AnnotationTopic
from bagassets.recordings.model import RawMessage
from bagassets.store.store import Store
from bagassets_tests.facts import MadeUpFacts, calibrated, use_of

S = 1_000_000_000
T0 = 1_700_000_000 * S
YAW_90 = (0.5**0.5, 0.0, 0.0, 0.5**0.5)


def header(stamp_ns=T0, frame="map"):
    return Msg(stamp=Msg(sec=stamp_ns // S, nanosec=stamp_ns % S), frame_id=frame)


def vector(x, y, z):
    return Msg(x=x, y=y, z=z)


def pose(position=(1.0, 2.0, 3.0), rotation=(1.0, 0.0, 0.0, 0.0)):
    w, x, y, z = rotation
    return Msg(position=vector(*position), orientation=Msg(w=w, x=x, y=y, z=z))


def detection(track="7", category="car", *, position=(1.0, 2.0, 3.0), size=(4.0, 2.0, 1.5), score=0.9, **own):
    results = [
        Msg(hypothesis=Msg(class_id="other", score=0.1)),
        Msg(hypothesis=Msg(class_id=category, score=score)),
    ]
    bbox = Msg(center=pose(position, own.pop("rotation", (1.0, 0.0, 0.0, 0.0))), size=vector(*size))
    return Msg(header=own.get("header", header(0, "")), results=results, bbox=bbox, id=track)


def detections(*items, stamp_ns=T0, frame="map"):
    return Msg(header=header(stamp_ns, frame), detections=list(items))


def autoware(shape, rotation=(1.0, 0.0, 0.0, 0.0)):
    """A pedestrian of a shape."""
    return Msg(
        existence_probability=1.0, classification=[Msg(label=7, probability=1.0)], shape=shape,
        kinematics=Msg(pose_with_covariance=Msg(pose=pose(rotation=rotation))),
    )  # fmt: skip


def derived(shape):
    """An object of a `shape_msgs/SolidPrimitive`."""
    return Msg(
        header=header(), id=12, classification=4, classification_certainty=255, pose=pose(), shape=shape
    )


def decode_all(msgtype, message):
    decoder = keyed_decoder("boxes", msgtype, None)
    return [decoder.decode(message, item) for item in decoder.items(message)]


class TestDecoders:
    """Every type gives centre, size as width, length, height, class and track."""

    def test_detection3d(self):
        (box,) = decode_all("vision_msgs/msg/Detection3DArray", detections(detection()))
        assert (box.stamp_ns, box.frame_id, box.track_id, box.category, box.score) == (
            T0,
            "map",
            "7",
            "car",
            0.9,
        )
        assert box.size_m == (2.0, 4.0, 1.5)
        assert box.frame_SE3_box.translation == (1.0, 2.0, 3.0)

    def test_detection3d_with_a_header_of_its_own(self):
        own = detection(header=header(T0 + 5, "/lidar"))
        (box,) = decode_all("vision_msgs/msg/Detection3DArray", detections(own))
        assert (box.stamp_ns, box.frame_id) == (T0 + 5, "lidar")

    def test_detection3d_of_ros_1_has_numbers_as_classes_and_no_track(self):
        item = detection()
        item.results = [Msg(id=3, score=0.5)]
        del item.id
        (box,) = decode_all("vision_msgs/msg/Detection3DArray", detections(item))
        assert (box.category, box.track_id) == ("3", "")

    def test_markers(self):
        cube = Msg(
            header=header(), type=1, action=0, ns="car", id=4, pose=pose(), scale=vector(4.0, 2.0, 1.5)
        )
        arrow = Msg(**{**vars(cube), "type": 0})
        deletion = Msg(**{**vars(cube), "action": 2})
        sphere, text = (Msg(**{**vars(cube), "type": kind}) for kind in (2, 9))
        cylinder = Msg(**{**vars(cube), "type": 3, "id": 5})
        boxes = decode_all(
            "visualization_msgs/msg/MarkerArray", Msg(markers=[cube, cylinder, arrow, deletion, sphere, text])
        )
        assert boxes[1:] == [replace(boxes[0], track_id="car/5"), None, None, None, None]
        assert (boxes[0].category, boxes[0].track_id, boxes[0].size_m) == ("car", "car/4", (2.0, 4.0, 1.5))
        assert decode_all("visualization_msgs/msg/Marker", cube) == [boxes[0]]

    def test_object_array(self):
        item = Msg(
            header=header(0, ""), id=12, classification=6, classification_certainty=255, pose=pose(),
            shape=Msg(type=1, dimensions=np.array([4.0, 2.0, 1.5])),
        )  # fmt: skip
        (box,) = decode_all("derived_object_msgs/msg/ObjectArray", Msg(header=header(), objects=[item]))
        assert (box.category, box.track_id, box.size_m, box.score) == ("car", "12", (2.0, 4.0, 1.5), 1.0)

    @pytest.mark.parametrize(
        ("shape", "size_m"),
        [
            (Msg(type=2, dimensions=[0.5]), (1.0, 1.0, 1.0)),  # a sphere: its radius
            (Msg(type=3, dimensions=[1.75, 0.25]), (0.5, 0.5, 1.75)),  # a cylinder: height, radius
        ],
    )
    def test_round_objects_have_the_extent_of_their_shape(self, shape, size_m):
        item = derived(shape)
        (box,) = decode_all("derived_object_msgs/msg/ObjectArray", Msg(header=header(), objects=[item]))
        assert (box.size_m, box.frame_SE3_box) == (size_m, SE3(translation=(1.0, 2.0, 3.0)))

    def test_a_prism_has_the_extent_of_its_base_and_height(self):
        base = Msg(points=[vector(-1.0, 0.0, 9.0), vector(3.0, 0.0, 9.0), vector(0.0, 0.5, 9.0)])
        item = derived(Msg(type=5, dimensions=[2.0], polygon=base))
        (box,) = decode_all("derived_object_msgs/msg/ObjectArray", Msg(header=header(), objects=[item]))
        assert (box.size_m, box.frame_SE3_box.translation) == ((0.5, 4.0, 2.0), (2.0, 2.25, 3.0))

    @pytest.mark.parametrize(
        "shape",
        [
            Msg(type=4, dimensions=[1.0, 0.5]),  # a cone: where along it the pose is is not defined
            Msg(type=0, dimensions=[]),
            Msg(type=1, dimensions=[4.0, 2.0]),
            Msg(type=2, dimensions=[]),
            Msg(type=3, dimensions=[1.0]),
            Msg(type=5, dimensions=[1.0]),  # before Humble there was no base
            Msg(type=5, dimensions=[], polygon=Msg(points=[])),
        ],
    )
    def test_shapes_without_an_extent_are_refused(self, shape):
        with pytest.raises(DecodeError, match="its object has a shape without an extent"):
            decode_all("derived_object_msgs/msg/ObjectArray", Msg(header=header(), objects=[derived(shape)]))

    def test_jsk_bounding_boxes(self):
        item = Msg(header=header(), pose=pose(), dimensions=vector(4.0, 2.0, 1.5), value=0.25, label=3)
        (box,) = decode_all("jsk_recognition_msgs/msg/BoundingBoxArray", Msg(header=header(), boxes=[item]))
        assert (box.category, box.track_id, box.size_m, box.score) == ("3", "", (2.0, 4.0, 1.5), 0.25)

    @pytest.mark.parametrize(
        ("own", "stamp_ns", "frame"),
        [
            (header(T0 + 5, "/lidar"), T0 + 5, "lidar"),
            (header(0, "/lidar"), T0, "lidar"),
            (header(T0 + 5, ""), T0 + 5, "map"),
            (header(0, ""), T0, "map"),
        ],
    )
    def test_what_a_jsk_box_leaves_open_the_array_says(self, own, stamp_ns, frame):
        item = Msg(header=own, pose=pose(), dimensions=vector(4.0, 2.0, 1.5), value=0.25, label=3)
        (box,) = decode_all("jsk_recognition_msgs/msg/BoundingBoxArray", Msg(header=header(), boxes=[item]))
        assert (box.stamp_ns, box.frame_id) == (stamp_ns, frame)

    @pytest.mark.parametrize("package", ["autoware_perception_msgs", "autoware_auto_perception_msgs"])
    def test_autoware(self, package):
        item = Msg(
            object_id=Msg(uuid=np.arange(16, dtype=np.uint8)), existence_probability=0.75,
            classification=[Msg(label=1, probability=0.2), Msg(label=7, probability=0.8)],
            kinematics=Msg(pose_with_covariance=Msg(pose=pose())),
            shape=Msg(type=0, dimensions=vector(4.0, 2.0, 1.5)),
        )  # fmt: skip
        message = Msg(header=header(), objects=[item])
        (box,) = decode_all(f"{package}/msg/TrackedObjects", message)
        assert (box.category, box.track_id) == ("pedestrian", "000102030405060708090a0b0c0d0e0f")
        assert (box.size_m, box.score) == ((2.0, 4.0, 1.5), 0.75)
        del item.object_id
        (box,) = decode_all(f"{package}/msg/DetectedObjects", message)
        assert box.track_id == ""

    def test_a_detection_takes_the_class_of_its_most_probable_hypothesis(self):
        item = detection()
        item.results = [
            Msg(hypothesis=Msg(class_id=name, score=p)) for name, p in (("a", 0.2), ("b", 0.7), ("c", 0.1))
        ]
        (box,) = decode_all("vision_msgs/msg/Detection3DArray", detections(item))
        assert (box.category, box.score) == ("b", 0.7)
        item.results = []
        with pytest.raises(DecodeError, match="its detection names no class"):
            decode_all("vision_msgs/msg/Detection3DArray", detections(item))

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"shape": Msg(type=3, dimensions=vector(1.0, 1.0, 1.0))}, "a shape without an extent"),
            ({"classification": []}, "names no class"),
        ],
    )
    def test_autoware_objects_without_extent_or_class_are_refused(self, change, words):
        item = autoware(Msg(type=0, dimensions=vector(4.0, 2.0, 1.5)))
        vars(item).update(change)
        with pytest.raises(DecodeError, match=words):
            decode_all("autoware_perception_msgs/msg/DetectedObjects", Msg(header=header(), objects=[item]))

    @pytest.mark.parametrize("y", [0.6, 0.0])  # which y is not defined for a cylinder
    def test_an_autoware_cylinder_is_as_long_and_wide_as_its_diameter(self, y):
        item = autoware(Msg(type=1, dimensions=vector(0.6, y, 1.75)), YAW_90)
        (box,) = decode_all(
            "autoware_perception_msgs/msg/DetectedObjects", Msg(header=header(), objects=[item])
        )
        assert box.size_m == (0.6, 0.6, 1.75)
        assert box.frame_SE3_box == SE3.create(YAW_90, (1.0, 2.0, 3.0))

    def test_an_autoware_polygon_has_the_extent_of_its_footprint_in_the_frame_of_the_object(self):
        footprint = [vector(x, y, -7.0) for x, y in ((-1.0, 0.5), (3.0, 0.5), (3.0, 1.0), (1.0, 2.0))]
        shape = Msg(type=2, footprint=Msg(points=footprint), dimensions=vector(0.0, 0.0, 1.5))
        item = autoware(shape, YAW_90)
        (box,) = decode_all(
            "autoware_perception_msgs/msg/DetectedObjects", Msg(header=header(), objects=[item])
        )
        assert box.size_m == (1.5, 4.0, 1.5)
        # The middle is at x 1, y 1.25 of the object, which heads along y of the frame.
        np.testing.assert_allclose(box.frame_SE3_box.translation, (1.0 - 1.25, 2.0 + 1.0, 3.0), atol=1e-12)
        np.testing.assert_allclose(box.frame_SE3_box.rotation, YAW_90, atol=1e-12)

    @pytest.mark.parametrize(
        "points",
        [
            [],
            [(1.0, 2.0)],
            [(1.0, 2.0), (2.0, 4.0)],  # would have an extent, but is a line
            [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)],
            [(0.0, 0.0), (np.nan, 1.0), (2.0, 5.0)],
        ],
    )
    def test_a_footprint_without_area_is_counted_as_lost(self, points):
        shape = Msg(type=2, footprint=Msg(points=[vector(x, y, 0.0) for x, y in points]))
        shape.dimensions = vector(4.0, 2.0, 1.5)
        with pytest.raises(DecodeError, match="the footprint of its object has no area"):
            decode_all(
                "autoware_perception_msgs/msg/DetectedObjects",
                Msg(header=header(), objects=[autoware(shape)]),
            )

    @pytest.mark.parametrize(
        ("label", "category"), [(0, "unknown"), (8, "animal"), (11, "under_drivable"), (12, "class_12")]
    )
    def test_autoware_classes_have_the_names_of_its_message(self, label, category):
        item = Msg(
            existence_probability=1.0, classification=[Msg(label=label, probability=1.0)],
            kinematics=Msg(pose_with_covariance=Msg(pose=pose())), shape=Msg(type=0, dimensions=vector(4.0, 2.0, 1.5)),
        )  # fmt: skip
        (box,) = decode_all(
            "autoware_perception_msgs/msg/DetectedObjects", Msg(header=header(), objects=[item])
        )
        assert box.category == category

    def test_unusable_poses_are_refused(self):
        with pytest.raises(DecodeError, match="quaternion"):
            decode_all(
                "vision_msgs/msg/Detection3DArray", detections(detection(rotation=(0.0, 0.0, 0.0, 0.0)))
            )
        with pytest.raises(DecodeError, match="not finite"):
            decode_all("vision_msgs/msg/Detection3DArray", detections(detection(position=(np.nan, 0.0, 0.0))))


def straight_drive():
    """One second along y at 10 m/s, heading along y."""
    stamps = T0 + np.array([0, S], dtype=np.int64)
    return Trajectory(stamps, np.array([[0.0, 0, 0], [0, 10, 0]]), np.array([YAW_90, YAW_90]), 2 * S, 0)


FRAMES = BoxFrames("map", "base_link", {"lidar": SE3.create(YAW_90, (1.0, 0.0, 2.0))}, straight_drive())


def box(frame="map", stamp_ns=T0, **fields):
    return BoxReading(
        stamp_ns, frame, SE3.create((1.0, 0, 0, 0), (5.0, 1.0, 0.5)), fields.pop("size_m", (2.0, 4.0, 1.5)),
        fields.pop("track_id", "1"), fields.pop("category", "car"), source="/boxes", **fields,
    )  # fmt: skip


def collect(*boxes, **rules):
    collector = BoxCollector(FRAMES, {"/boxes": AnnotationTopic(topic="/boxes", **rules)})
    for item in boxes:
        collector.add(item)
    table = collector.finish()
    counts = collector.counts["/boxes"]
    assert counts.read == len(boxes) == counts.written + sum(counts.lost.values())
    assert counts.written == len(table)
    return table, counts


class TestPlacing:
    def test_a_box_in_the_global_frame_stays(self):
        table, _ = collect(box(stamp_ns=T0 + 500 * S))  # even where there is no pose
        assert table.centers_m.tolist() == [[5.0, 1.0, 0.5]]
        assert table.rotations.tolist() == [[1.0, 0.0, 0.0, 0.0]]

    def test_a_box_in_the_ego_frame_moves_with_the_pose_at_its_own_time(self):
        table, _ = collect(box("base_link", T0 + S // 4))
        # Heading along y: 5 m ahead is +y, 1 m left is -x; 2.5 m driven.
        np.testing.assert_allclose(table.centers_m, [[-1.0, 7.5, 0.5]], atol=1e-12)
        np.testing.assert_allclose(table.rotations, [YAW_90], atol=1e-12)

    def test_a_box_in_a_sensor_frame_goes_through_the_extrinsics(self):
        table, _ = collect(box("lidar", T0))
        # Lidar x is ego y: (5, 1, .5) -> ego (1 - 1, 5, 2.5) -> global (-5, 0, 2.5).
        np.testing.assert_allclose(table.centers_m, [[-5.0, 0.0, 2.5]], atol=1e-12)
        np.testing.assert_allclose(table.rotations, [(0.0, 0.0, 0.0, 1.0)], atol=1e-12)

    def test_the_recipe_may_name_the_frame(self):
        table, _ = collect(box("nonsense"), frame="map")
        assert len(table) == 1

    def test_frames_may_be_mixed(self):
        table, _ = collect(box("lidar", track_id="a"), box(track_id="b"), box("base_link", track_id="c"))
        np.testing.assert_allclose(table.centers_m[:, 2], [2.5, 0.5, 0.5])


class TestAccount:
    @pytest.mark.parametrize(
        ("bad", "reason"),
        [
            (box(size_m=(2.0, 0.0, 1.5)), "its size is not positive"),
            (box(size_m=(2.0, -4.0, 1.5)), "its size is not positive"),
            (box(size_m=(2.0, float("nan"), 1.5)), "its size or score is not finite"),
            (box(score=float("nan")), "its size or score is not finite"),
            (box(stamp_ns=0), "its stamp is zero"),
            (box("elsewhere"), "its frame is not known"),
            (box("base_link", T0 - S), "no ego pose at its time"),
            (box("lidar", T0 + 2 * S), "no ego pose at its time"),
        ],
    )
    def test_what_is_not_kept_is_counted_by_reason(self, bad, reason):
        table, counts = collect(bad, box(track_id="good"))
        assert counts.lost == {reason: 1}
        assert table.tracks == ["good"]

    def test_of_two_boxes_of_a_track_at_one_time_the_first_is_kept(self):
        table, counts = collect(box(category="car"), box(category="truck"), box(track_id="2"))
        assert counts.lost == {"second box of one track at one time": 1}
        assert table.categories == ["car", "car"]

    def test_boxes_without_track_are_all_kept(self):
        table, _ = collect(box(track_id=""), box(track_id=""), box())
        assert (list(table.tracks), table.without_track, table.track_count) == (["", "", "1"], 2, 1)

    def test_the_message_that_a_box_came_with_survives_parquet_form(self):
        collector = BoxCollector(FRAMES, {"/boxes": AnnotationTopic(topic="/boxes")})
        for message, stamps in enumerate(((T0 + 4, T0 + 9, T0 + 30), (T0 + 40, T0 + 10))):
            for stamp_ns in stamps:
                collector.add(box(stamp_ns=stamp_ns, track_id=""), message=message)
        collector.add(box(stamp_ns=T0 + 5, track_id=""))  # of a label file: the stamp says what came together
        table = BoxTable.from_arrow(collector.finish().to_arrow())
        assert (table.stamps_ns - T0).tolist() == [4, 5, 9, 10, 30, 40]
        assert (table.message_stamps_ns - T0).tolist() == [9, 5, 9, 10, 9, 10]

    def test_a_source_may_refuse_bad_boxes(self):
        with pytest.raises(DecodeError, match=r"/boxes: a box cannot be used \(its size is not positive\)"):
            collect(box(size_m=(0.0, 1.0, 1.0)), bad_boxes="refuse")

    def test_categories_and_attributes_are_mapped(self):
        table, _ = collect(
            box(category="CAR", attributes=("seen",)),
            box(category="dog", track_id="2"),
            categories={"CAR": "vehicle.car"},
            attributes={"vehicle.car": ("vehicle.parked", "seen")},
        )
        assert table.categories == ["vehicle.car", "dog"]
        assert table.attributes == [("seen", "vehicle.parked"), ()]

    def test_the_table_survives_parquet_form_and_is_sorted(self):
        table, _ = collect(box(stamp_ns=T0 + 9, track_id="b"), box(track_id="c"), box(track_id="a"))
        again = BoxTable.from_arrow(table.to_arrow())
        assert again.tracks == ["a", "c", "b"]
        assert again.stamps_ns.tolist() == [T0, T0, T0 + 9]
        np.testing.assert_array_equal(again.sizes_m, table.sizes_m)

    def test_an_empty_table_survives_too(self):
        table, _ = collect()
        assert len(BoxTable.from_arrow(table.to_arrow())) == 0


class FakeRecording:
    """Messages that are decoded already."""

    def __init__(self, messages, msgtype="vision_msgs/msg/Detection3DArray", topic="/boxes"):
        self.topics = {topic: Msg(name=topic, msgtype=msgtype, count=len(messages))}
        self._messages = messages
        self._topic, self._type = topic, msgtype

    def messages(self, topics):
        assert list(topics) == [self._topic]
        for number in range(len(self._messages)):
            yield RawMessage(self._topic, self._type, T0 + number * S // 10 + 3, bytes([number]))

    def decode(self, message):
        decoded = self._messages[message.data[0]]
        if decoded is None:
            raise DecodeError("it is too short")
        return decoded


def inventory(*topics, msgtype="vision_msgs/msg/Detection3DArray"):
    record = Msg(msgtype=msgtype, frame_ids=("map",))
    return Msg(has=lambda name: name in topics, topic=lambda name: record)


def rig(**annotation):
    return Rig.model_validate(
        {
            "name": "r",
            "channels": {"LIDAR_TOP": {"modality": "lidar", "topic": "/lidar"}},
            "ego_pose": {"source": "odometry", "topic": "/odom"},
            "annotations": [{"topic": "/boxes", **annotation}],
        }
    )


CALIBRATION = calibrated(
    LIDAR_TOP={
        "frame": "lidar",
        "ego_SE3_sensor": {"translation": [1, 0, 2], "rotation": list(YAW_90)},
    }
)


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "store")


@pytest.fixture
def ego_poses(store):
    pending = store.begin(EGO_POSES.step.action({"ego": 1}, {}))
    pending.out.write_json("ego_poses.json", {"global_frame": "map", "origin": None})
    return pending.commit({}).artifact


def run(store, use, recording):
    return run_action(
        store,
        ANNOTATIONS.action(replace(use, topics=()), None),
        lambda out: make_annotations(use.params, recording, out, trajectory=straight_drive()),
    ).artifact


def ask(ego_poses, the_rig=None, inv=None, clock="header", lost=0.0):
    facts = MadeUpFacts(inv or inventory("/boxes"), CALIBRATION, {"ego_poses": ego_poses})
    return use_of(ANNOTATIONS, the_rig or rig(), facts, clock=clock, limits=Limits(lost_messages=lost))


@pytest.mark.parametrize(
    ("msgtype", "shapes"),
    [
        ("vision_msgs/msg/Detection3DArray", {}),
        ("jsk_recognition_msgs/msg/BoundingBoxArray", {}),
        ("visualization_msgs/msg/MarkerArray", {"shapes": True}),
        ("derived_object_msgs/msg/ObjectArray", {"shapes": True}),
        ("autoware_perception_msgs/msg/TrackedObjects", {"shapes": True}),
        ("autoware_auto_perception_msgs/msg/DetectedObjects", {"shapes": True}),
    ],
)
def test_only_topics_whose_objects_have_other_shapes_are_read_again(ego_poses, msgtype, shapes):
    source = as_json(ask(ego_poses, inv=inventory("/boxes", msgtype=msgtype)).params)["sources"]["/boxes"]
    assert {name: value for name, value in source.items() if name == "shapes"} == shapes


class TestStep:
    def test_boxes_of_a_topic_become_a_table(self, store, ego_poses):
        messages = [
            detections(detection(), detection("8", "dog", size=(1, 0, 1)), stamp_ns=T0 + i * S // 10)
            for i in range(3)
        ]
        request = ask(ego_poses, rig(categories={"car": "vehicle.car"}))
        assert request.topics == ("/boxes",)
        artifact = run(store, request, FakeRecording(messages))
        table = artifact.read_table("annotations.parquet")
        assert table.column("category").to_pylist() == ["vehicle.car"] * 3
        counts = artifact.read_json("annotations.json")["counts"]["/boxes"]
        assert counts["messages"] == {"read": 3, "written": 3, "merged": 0, "lost": {}}
        assert counts["boxes"] == {
            "read": 6,
            "written": 3,
            "lost": {"its size is not positive": 3},
            "first": {"its size is not positive": f"message logged at {T0 + 3}"},
            "kept": {},
        }

    def test_the_log_clock_stamps_boxes_with_the_time_of_the_message(self, store, ego_poses):
        artifact = run(
            store, ask(ego_poses, clock="log"), FakeRecording([detections(detection(), stamp_ns=5)])
        )
        assert artifact.read_table("annotations.parquet").column("stamp_ns").to_pylist() == [T0 + 3]

    def test_without_boxes_the_step_reads_nothing(self, store, ego_poses):
        request = ask(ego_poses, inv=inventory())
        assert (request.topics, dict(request.inputs)) == ((), {})
        assert as_json(request.params) == {"absent": ["/boxes"]}
        assert run(store, request, None).read_table("annotations.parquet").num_rows == 0

    def test_messages_that_cannot_be_decoded_are_counted_up_to_the_limit(self, store, ego_poses):
        messages = [detections(detection()), None, *[detections() for _ in range(8)]]
        artifact = run(store, ask(ego_poses, lost=0.1), FakeRecording(messages))
        assert artifact.summary()["counts"]["/boxes"]["messages"]["lost"] == {"it is too short": 1}
        with pytest.raises(LossLimitError, match=r"/boxes: 1 of 10 messages .* it is too short"):
            run(store, ask(ego_poses, lost=0.05), FakeRecording(messages))

    def test_boxes_in_a_frame_that_nobody_knows_fail_the_recording_with_a_way_out(self, store, ego_poses):
        with pytest.raises(
            LossLimitError,
            match=r"frame odom_combined, but the known frames are .*'map'.*name the frame of the boxes",
        ):
            run(store, ask(ego_poses), FakeRecording([detections(detection(), frame="/odom_combined")]))

    def test_one_nonsense_box_does_not_cost_the_others_of_its_message(self, store, ego_poses):
        message = detections(detection("1", rotation=(0.0, 0.0, 0.0, 0.0)), detection("2"))
        artifact = run(store, ask(ego_poses), FakeRecording([message]))
        boxes = artifact.summary()["counts"]["/boxes"]["boxes"]
        assert (boxes["read"], boxes["written"]) == (2, 1)
        assert boxes["lost"] == {"its quaternion is not of unit length": 1}

    def test_a_topic_of_another_kind_is_refused(self, store, ego_poses):
        recording = FakeRecording([Msg()], "std_msgs/msg/String")
        with pytest.raises(RecipeError, match="/boxes has type std_msgs/msg/String"):
            run(store, ask(ego_poses), recording)

    def test_exactly_what_is_read_keys_the_step(self, store, ego_poses):
        base = ask(ego_poses)
        assert ask(ego_poses, rig(categories={"a": "b"})).params != base.params
        assert ask(ego_poses, clock="log").params != base.params
        assert base.inputs == {"ego_poses": ego_poses.digest}
        other = rig().model_copy(
            update={"name": "other", "vehicle": "v", "location": "l", "required": ("LIDAR_TOP",)}
        )
        assert ask(ego_poses, other).params == base.params


VISION_MSGS = {
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id"
    ),
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
}


class TestSerializedMessages:
    """The decoders meet the classes that rosbags makes from definitions."""

    @pytest.fixture
    def types(self):
        store = get_typestore(Stores.ROS2_HUMBLE)
        for name, text in VISION_MSGS.items():
            store.register(get_types_from_msg(text, name))
        return store

    @staticmethod
    def parts(types):
        make = types.types
        stamped = make["std_msgs/msg/Header"](
            stamp=make["builtin_interfaces/msg/Time"](sec=T0 // S, nanosec=7), frame_id="map"
        )
        center = make["geometry_msgs/msg/Pose"](
            position=make["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=3.0),
            orientation=make["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        )
        return make, stamped, center, make["geometry_msgs/msg/Vector3"](x=4.0, y=2.0, z=1.5)

    def test_detections(self, types):
        make, stamped, center, size = self.parts(types)
        hypothesis = make["vision_msgs/msg/ObjectHypothesis"](class_id="car", score=0.5)
        covariance = make["geometry_msgs/msg/PoseWithCovariance"](pose=center, covariance=np.zeros(36))
        item = make["vision_msgs/msg/Detection3D"](
            header=stamped,
            results=[
                make["vision_msgs/msg/ObjectHypothesisWithPose"](hypothesis=hypothesis, pose=covariance)
            ],
            bbox=make["vision_msgs/msg/BoundingBox3D"](center=center, size=size),
            id="7",
        )
        name = "vision_msgs/msg/Detection3DArray"
        message = make[name](header=stamped, detections=[item])
        (decoded,) = decode_all(name, types.deserialize_cdr(types.serialize_cdr(message, name), name))
        assert (decoded.stamp_ns, decoded.frame_id, decoded.track_id, decoded.category) == (
            T0 + 7,
            "map",
            "7",
            "car",
        )
        assert decoded.size_m == (2.0, 4.0, 1.5)

    def test_markers(self, types):
        make, stamped, center, size = self.parts(types)
        name = "visualization_msgs/msg/MarkerArray"
        color = make["std_msgs/msg/ColorRGBA"](r=0.0, g=0.0, b=0.0, a=1.0)
        texture = make["sensor_msgs/msg/CompressedImage"](
            header=stamped, format="", data=np.zeros(0, np.uint8)
        )
        marker = make["visualization_msgs/msg/Marker"](
            header=stamped, ns="car", id=3, type=1, action=0, pose=center, scale=size, color=color,
            lifetime=make["builtin_interfaces/msg/Duration"](sec=0, nanosec=0), frame_locked=False, points=[], colors=[],
            texture_resource="", texture=texture, uv_coordinates=[], text="", mesh_resource="",
            mesh_file=make["visualization_msgs/msg/MeshFile"](filename="", data=np.zeros(0, np.uint8)),
            mesh_use_embedded_materials=False,
        )  # fmt: skip
        message = make[name](markers=[marker])
        (decoded,) = decode_all(name, types.deserialize_cdr(types.serialize_cdr(message, name), name))
        assert (decoded.track_id, decoded.size_m) == ("car/3", (2.0, 4.0, 1.5))
