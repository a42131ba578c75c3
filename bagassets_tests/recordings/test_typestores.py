"""Recordings without definitions: the messages that are known, and telling versions of a type by the bytes."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from bagassets.assets.inventory import INVENTORY
from bagassets.base.errors import DecodeError
from bagassets.decode.box_messages import AUTOWARE_OBJECTS, DETECTIONS
from bagassets.decode.loading import keyed_decoder
from bagassets.decode.packets import packets_in
from bagassets.decode.radar import decode_radar
from bagassets.recordings import known_types, layouts
from bagassets.recordings.known_types import known_versions
from bagassets.recordings.layouts import CHANGED_IN_HUMBLE, Choice, choice_of
from bagassets.recordings.model import Definition
from bagassets.recordings.open import open_recording
from bagassets.store.canonical import digest_json
from bagassets_tests.layout_data import fill, header, inventory_of, layout_of, serialized, write_bare

PACKAGES = sorted(path.stem for path in (Path(known_types.__file__).parent / "definitions").glob("*.msg"))
START_NS = 1_600_000_000_000_000_000
# The version of the inventory step since which the known definitions are as they are, and their digest.
KNOWN = (11, "ade1395f622820fd")
ARRAY = "vision_msgs/msg/Detection3DArray"


# --- the known definitions ---------------------------------------------------------------


@pytest.mark.parametrize("package", PACKAGES)
def test_known_definitions_compile_with_all_that_they_refer_to(package):
    types = {name for version in known_versions(package) for name in version}
    assert types
    for msgtype in sorted(types):
        choice = choice_of(msgtype, "cdr", None, [])
        assert isinstance(choice, Choice), choice
        for layout in choice.layouts:
            assert layout.store.get_msgdef(msgtype).deserialize_cdr_be
            assert choice_of(msgtype, "cdr", Definition("msg", layout.text), []).best.types == layout.types


def test_a_change_of_known_definitions_raises_the_version_of_the_inventory():
    known = [
        [package, [sorted(version.items()) for version in known_versions(package)]] for package in PACKAGES
    ]
    version, digest = KNOWN
    assert digest_json(repr(known))[:16] == digest, (
        "raise the version of the asset inventory, and note its version and this digest"
    )
    assert INVENTORY.version >= version


def test_standard_types_that_changed_before_definitions_were_recorded_are_all_looked_up():
    humble, galactic = (
        get_typestore(store).fielddefs for store in (Stores.ROS2_HUMBLE, Stores.ROS2_GALACTIC)
    )
    for store in (Stores.ROS2_GALACTIC, Stores.ROS2_FOXY, Stores.ROS2_ELOQUENT, Stores.ROS2_DASHING):
        types = get_typestore(store).fielddefs
        changed = {
            name for name in types if name in humble and types[name][1] != humble[name][1]
            and not name.startswith("rcl_interfaces/")
        }  # fmt: skip
        assert changed == CHANGED_IN_HUMBLE
        assert all(types[name][1] == galactic[name][1] for name in CHANGED_IN_HUMBLE)


@pytest.mark.parametrize("store", [Stores.ROS1_NOETIC, Stores.ROS2_HUMBLE, Stores.ROS2_GALACTIC])
@pytest.mark.parametrize("name", ["Time", "Duration"])
def test_times_are_those_of_every_version(store, name):
    msgtype = f"builtin_interfaces/msg/{name}"
    assert layout_of(msgtype).types == {msgtype: get_typestore(store).fielddefs[msgtype][:2]}


def test_standard_types_are_not_loaded_for_a_definition_that_is_complete(monkeypatch):
    monkeypatch.setattr(layouts, "_standard_types", None)
    rule = "=" * 80
    head = f"{rule}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    complete = Definition("msg", f"Header header\nduration lasted\n{head}")
    assert isinstance(choice_of("my_msgs/msg/Complete", "ros1", complete, []), Choice)
    incomplete = Definition("msg", "geometry_msgs/Point point\n")
    assert isinstance(choice_of("my_msgs/msg/Incomplete", "ros1", incomplete, []), str), (
        "they are needed for it"
    )


def test_velodyne_packets_of_a_bag_without_definitions_are_read(tmp_path):
    layout = layout_of("velodyne_msgs/msg/VelodyneScan")
    scan = fill(
        layout,
        header=header(START_NS, "velodyne"),
        packets=[{"stamp": header(START_NS + i, "")["stamp"], "data": [i] * 1206} for i in range(3)],
    )
    path = write_bare(tmp_path / "bag", [("/packets", layout, START_NS + 7, scan)])
    inventory, _ = inventory_of(path, tmp_path / "artifact")
    topic = inventory.topic("/packets")
    assert topic.problem is None
    assert (topic.first_stamp_ns, topic.frame_ids) == (START_NS, ("velodyne",))
    assert "uint8[1206] data" in topic.definition.text
    with open_recording(path) as recording:
        (message,) = recording.messages(["/packets"])
        assert packets_in(recording.decode(message)) == [(START_NS + i, bytes([i]) * 1206) for i in range(3)]


# --- several layouts of one type ---------------------------------------------------------

CENTER = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": {"w": 1.0}}
BOX = {"center": CENTER, "size": {"x": 4.0, "y": 2.0, "z": 1.5}}


def hypothesis_of(layout, name, score):
    """A hypothesis as the version of vision_msgs has it; ids were numbers in the first one."""
    fields = {field for field, _ in layout.types["vision_msgs/msg/ObjectHypothesisWithPose"][1]}
    if "hypothesis" in fields:
        return {"hypothesis": {"class_id": name, "score": score}}
    numbered = "int64" in str(layout.types["vision_msgs/msg/ObjectHypothesisWithPose"][1][0])
    return {"id": int(name) if numbered else name, "score": score}


def detections(layout, names, stamp_ns=START_NS):
    items = [{"results": [hypothesis_of(layout, name, 0.75)], "bbox": BOX} for name in names]
    return fill(layout, header=header(stamp_ns, "map"), detections=items)


VERSIONS = len(choice_of(ARRAY, "cdr", None, []).layouts)


def test_vision_msgs_has_three_layouts_of_boxes():
    assert VERSIONS == 3  # 3.0 differs from 4.1 in two dimensions only
    assert len(choice_of("vision_msgs/msg/Detection2DArray", "cdr", None, []).layouts) == 4
    assert len(choice_of("vision_msgs/msg/VisionInfo", "cdr", None, []).layouts) == 1


@pytest.mark.parametrize("number", range(VERSIONS))
def test_the_version_is_found_from_the_messages_though_the_first_are_empty(tmp_path, number):
    layout = layout_of(ARRAY, number)
    lists = [[], [], ["1"], [], ["2", "3"]]
    messages = [
        ("/boxes", layout, START_NS + i, detections(layout, names, START_NS + i))
        for i, names in enumerate(lists)
    ]
    inventory, pack = inventory_of(write_bare(tmp_path / "bag", messages), tmp_path / "artifact")
    topic = inventory.topic("/boxes")
    assert topic.problem is None
    assert choice_of(ARRAY, "cdr", topic.definition, []).best.types == layout.types
    with pack, open_recording(tmp_path / "bag") as recording:
        for source in (pack, recording):
            decoded = [source.decode(message) for message in source.messages(["/boxes"])]
            boxes = [[DETECTIONS.decode(message, item) for item in message.detections] for message in decoded]
            assert [[box.category for box in row] for row in boxes] == lists
            assert all(box.size_m == (2.0, 4.0, 1.5) and box.score == 0.75 for row in boxes for box in row)


@settings(max_examples=60, deadline=None)
@given(
    number=st.integers(0, VERSIONS - 1),
    names=st.lists(st.text("0123456789", min_size=1, max_size=12).map(lambda text: str(int(text))), min_size=1, max_size=4),
    frame=st.text("abc_/", max_size=9),
)  # fmt: skip
def test_any_list_that_is_not_empty_is_decoded_by_its_own_layout(number, names, frame):
    layout = layout_of(ARRAY, number)
    message = fill(
        layout,
        header=header(START_NS, frame),
        detections=[{"results": [hypothesis_of(layout, name, 0.5)], "bbox": BOX} for name in names],
    )
    choice = choice_of(ARRAY, "cdr", None, [])
    decoded = choice.decode(serialized(layout, message))
    assert choice.best.types == layout.types
    assert [DETECTIONS.decode(decoded, item).category for item in decoded.detections] == names


def test_a_damaged_message_does_not_change_the_layout():
    new, old = layout_of(ARRAY, 0), layout_of(ARRAY, 1)
    choice = choice_of(ARRAY, "cdr", None, [])
    choice.decode(serialized(old, detections(old, ["car"])))
    assert choice.best.types == old.types
    for _ in range(3):
        with pytest.raises(Exception, match="do not fit"):
            choice.decode(b"\0\1\0\0" + b"\xff" * 50)
    assert choice.best.types == old.types
    assert new.types != old.types


@pytest.mark.parametrize("package", ["autoware_perception_msgs", "autoware_auto_perception_msgs"])
def test_tracked_objects_of_autoware_before_and_after_the_renaming(package):
    msgtype = f"{package}/msg/TrackedObjects"
    layout = layout_of(msgtype)
    item = {
        "object_id": {"uuid": list(range(16))},
        "existence_probability": 0.5,
        "classification": [{"label": 7, "probability": 1.0}],
        "kinematics": {
            "pose_with_covariance": {"pose": CENTER},
            "orientation_availability": 2,
            "is_stationary": True,
        },
        "shape": {"dimensions": {"x": 4.0, "y": 2.0, "z": 1.5}},
    }
    data = serialized(layout, fill(layout, header=header(START_NS, "map"), objects=[item]))
    decoded = choice_of(msgtype, "cdr", None, []).decode(data)
    box = AUTOWARE_OBJECTS.decode(decoded, decoded.objects[0])
    assert (box.category, box.track_id, box.size_m) == ("pedestrian", bytes(range(16)).hex(), (2.0, 4.0, 1.5))
    assert decoded.objects[0].kinematics.orientation_availability == 2
    names = [name for name, _ in layout.types[f"{package}/msg/TrackedObjectKinematics"][1]]
    assert names.index("orientation_availability") == (1 if "auto_" in package else 3)


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize(
    "msgtype", ["visualization_msgs/msg/MarkerArray", "derived_object_msgs/msg/ObjectArray"]
)
def test_standard_types_as_they_were_before_humble(msgtype, number):
    layout = layout_of(msgtype, number)
    item = {"header": header(START_NS, "map")}
    if "Marker" in msgtype:
        given_fields = {
            "markers": [
                item | {"type": 1, "pose": CENTER, "ns": "car", "scale": {"x": 4.0, "y": 2.0, "z": 1.0}}
            ]
        }
    else:
        shape = {"type": 1, "dimensions": [4.0, 2.0, 1.0]}
        given_fields = {"header": header(START_NS, "map"), "objects": [item | {"pose": CENTER, "shape": shape, "classification": 6}]}  # fmt: skip
    choice = choice_of(msgtype, "cdr", None, [])
    decoded = choice.decode(serialized(layout, fill(layout, **given_fields)))
    decoder = keyed_decoder("boxes", msgtype, None)
    (box,) = [decoder.decode(decoded, each) for each in decoder.items(decoded)]
    assert (box.category, box.size_m) == ("car", (2.0, 4.0, 1.0))


@pytest.mark.parametrize(
    ("msgtype", "track"),
    [
        ("radar_msgs/msg/RadarTracks", {"position": {"x": 20.0, "y": 5.0}}),
        ("radar_msgs/msg/RadarTrackArray", {"track_shape": {"points": [{"x": 19.0, "y": 5.0}, {"x": 21.0, "y": 5.0}]}}),
    ],
)  # fmt: skip
def test_both_packages_called_radar_msgs(msgtype, track):
    layout = layout_of(msgtype)
    data = serialized(layout, fill(layout, header=header(START_NS, "radar"), tracks=[track]))
    reading = decode_radar(choice_of(msgtype, "cdr", None, []).decode(data), msgtype)
    assert (reading.targets["x"].tolist(), reading.targets["y"].tolist()) == ([20.0], [5.0])


def test_steps_decode_a_topic_as_the_inventory_found_it(tmp_path):
    old = layout_of(ARRAY, 1)
    empty, full = detections(old, []), detections(old, ["car"])
    path = write_bare(
        tmp_path / "bag", [("/boxes", old, START_NS, empty), ("/boxes", old, START_NS + 1, full)]
    )
    inventory, _ = inventory_of(path, tmp_path / "artifact")
    with open_recording(path) as recording:
        assert recording.topics["/boxes"].is_ambiguous
        recording.topics["/boxes"].assume(inventory.topic("/boxes").definition)
        assert not recording.topics["/boxes"].is_ambiguous
        assert recording.topics["/boxes"].definition == inventory.topic("/boxes").definition
        first = next(recording.restrict(["/boxes"]).messages(["/boxes"]))
        assert recording.decode(first).detections == []


# --- messages that are shorter than their bytes ------------------------------------------

# What `rclpy.serialization.serialize_message` of Jazzy (7.1.6, rmw_fastrtps) makes of three points of two joints; only the second
# has velocities. The bytes at the end are no part of the message.
TRAJECTORY = bytes.fromhex(
    "0001000000000000000000000100000000000000020000000200000061000000030000006263000003000000020000000000"
    "0000000000000000f03f00000000000000400000000000000000000000000000000000000000020000000000000000000840"
    "00000000000010400200000000000000000000000000f03f000000000000f03f000000000000000000000000000000000200"
    "0000000000000000000000001440000000000000104000000000000000000000000000000000000000000000000000000000"
    "00000000000000000000000000000000000000000000000000000000"
)


def test_bytes_behind_a_message_are_no_part_of_it_if_there_are_as_many_as_ros_2_leaves():
    layout = layout_of("trajectory_msgs/msg/JointTrajectory")
    message = layout.decode(TRAJECTORY)
    assert message.joint_names == ["a", "bc"]
    assert [point.positions.tolist() for point in message.points] == [[1, 2], [3, 4], [5, 4]]
    assert [point.velocities.tolist() for point in message.points] == [[], [1, 1], []]
    assert not any(len(point.effort) or point.time_from_start.sec for point in message.points)
    own = serialized(layout, message)
    assert len(own) == len(TRAJECTORY) - 36
    for wrong in (
        TRAJECTORY[:-1],
        TRAJECTORY + bytes(4),
        TRAJECTORY[: len(own) + 8],
        own[:-4],
        own + bytes(8),
    ):
        with pytest.raises(DecodeError, match="do not fit"):
            layout.decode(wrong)
    assert serialized(layout, layout.decode(own)) == own
