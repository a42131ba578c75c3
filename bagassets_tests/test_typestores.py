"""What messages are decoded with: embedded, given by hand, known here; and what that does to keys."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer as McapWriter
from rosbags.typesys import Stores, get_typestore

from bagassets.bags.inventory import Definition, Inventory
from bagassets.bags.known_types import known_packages, known_versions
from bagassets.bags.layouts import CHANGED_IN_HUMBLE, Choice, choice_of
from bagassets.bags.open import open_recording
from bagassets.bags.pack import PackedRecording
from bagassets.decode.autoware_objects import decode_object
from bagassets.decode.boxes import box_decoder
from bagassets.decode.detection3d import decode_detection
from bagassets.decode.radar import decode_radar
from bagassets.decode.velodyne import packets_in
from bagassets.errors import RecordingError
from bagassets.steps.inventory import STEP, make_inventory
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_json
from bagassets_tests.layout_data import fill, header, layout_of, write_bare

START_NS = 1_600_000_000_000_000_000
# The version of the inventory step since which the known definitions are as they are, and their digest.
KNOWN = (5, "c02c6b1d01d38707")
ARRAY = "vision_msgs/msg/Detection3DArray"


def inventory_of(path, folder, message_definitions=()):
    """Return the typed inventory of a recording, and its pack."""
    out = ArtifactWriter(folder)
    with open_recording(path, message_definitions) as recording:
        summary = make_inventory(recording, out, size=1)
    artifact = Artifact(out.finish(summary), folder)
    value = artifact.read_json("inventory.json")
    return Inventory.from_json(value), PackedRecording(value, artifact.path("messages.parquet"))


# --- the known definitions ---------------------------------------------------------------


@pytest.mark.parametrize("package", known_packages())
def test_known_definitions_compile_with_all_that_they_refer_to(package):
    types = {name for version in known_versions(package) for name in version}
    assert types
    for msgtype in sorted(types):
        choice = choice_of(msgtype, "cdr", None, [])
        assert isinstance(choice, Choice), choice
        for layout in choice.layouts:
            assert layout.store.get_msgdef(msgtype)
            assert choice_of(msgtype, "cdr", Definition("msg", layout.text), []).best.types == layout.types


def test_a_change_of_known_definitions_raises_the_version_of_the_inventory():
    known = [
        [package, [sorted(version.items()) for version in known_versions(package)]]
        for package in known_packages()
    ]
    version, digest = KNOWN
    assert digest_json(repr(known))[:16] == digest, (
        "raise steps.inventory.STEP, and note its version and this digest"
    )
    assert STEP.version >= version


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
def test_the_version_is_told_from_the_messages_though_the_first_are_empty(tmp_path, number):
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
            boxes = [[decode_detection(message, item) for item in message.detections] for message in decoded]
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
    decoded = choice.decode(layout.store.serialize_cdr(message, ARRAY))
    assert choice.best.types == layout.types
    assert [decode_detection(decoded, item).category for item in decoded.detections] == names


def test_a_damaged_message_does_not_change_the_layout():
    new, old = layout_of(ARRAY, 0), layout_of(ARRAY, 1)
    choice = choice_of(ARRAY, "cdr", None, [])
    choice.decode(old.store.serialize_cdr(detections(old, ["car"]), ARRAY))
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
    data = layout.store.serialize_cdr(fill(layout, header=header(START_NS, "map"), objects=[item]), msgtype)
    decoded = choice_of(msgtype, "cdr", None, []).decode(data)
    box = decode_object(decoded, decoded.objects[0])
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
    decoded = choice.decode(layout.store.serialize_cdr(fill(layout, **given_fields), msgtype))
    decoder = box_decoder(msgtype)
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
    data = layout.store.serialize_cdr(fill(layout, header=header(START_NS, "radar"), tracks=[track]), msgtype)
    reading = decode_radar(choice_of(msgtype, "cdr", None, []).decode(data), msgtype)
    assert (reading.targets["x"].tolist(), reading.targets["y"].tolist()) == ([20.0], [5.0])


# --- who wins ----------------------------------------------------------------------------

OTHER_SCAN = (
    "float32 speed\nVelodynePacket[] packets\n"
    + "=" * 80
    + "\nMSG: velodyne_msgs/VelodynePacket\nuint8[] data\n"
)


def test_an_embedded_definition_wins_over_a_known_one():
    choice = choice_of("velodyne_msgs/msg/VelodyneScan", "cdr", Definition("msg", OTHER_SCAN), [])
    assert len(choice.layouts) == 1
    assert [name for name, _ in choice.best.types["velodyne_msgs/msg/VelodyneScan"][1]] == [
        "speed",
        "packets",
    ]
    assert [name for name, _ in choice.best.types["velodyne_msgs/msg/VelodynePacket"][1]] == ["data"]


def test_a_definition_by_hand_wins_over_known_and_standard_ones(tmp_path):
    for package, name, text in [
        ("velodyne_msgs", "VelodyneScan", "uint32 mine\n"),
        ("vision_msgs", "Detection3D", "uint32 mine\n"),
        ("visualization_msgs", "Marker", "uint32 mine\n"),
    ]:
        folder = tmp_path / package / "msg"
        folder.mkdir(parents=True)
        (folder / f"{name}.msg").write_text(text)
    for msgtype in ("velodyne_msgs/msg/VelodyneScan", "visualization_msgs/msg/Marker"):
        (layout,) = choice_of(msgtype, "cdr", None, [tmp_path]).layouts
        assert [name for name, _ in layout.types[msgtype][1]] == ["mine"]
    nested = choice_of(ARRAY, "cdr", None, [tmp_path]).best
    assert [name for name, _ in nested.types["vision_msgs/msg/Detection3D"][1]] == ["mine"]


def test_an_edited_definition_by_hand_is_read_again(tmp_path):
    folder = tmp_path / "my_msgs"
    folder.mkdir()
    names = []
    for text in ("uint32 before\n", "uint32 afterwards\n"):
        (folder / "Pair.msg").write_text(text)
        names += [
            name
            for name, _ in choice_of("my_msgs/msg/Pair", "cdr", None, [tmp_path]).best.types[
                "my_msgs/msg/Pair"
            ][1]
        ]
    assert names == ["before", "afterwards"]


def test_an_embedded_definition_wins_over_one_by_hand(tmp_path):
    (tmp_path / "velodyne_msgs").mkdir()
    (tmp_path / "velodyne_msgs" / "VelodyneScan.msg").write_text("uint32 mine\n")
    choice = choice_of("velodyne_msgs/msg/VelodyneScan", "cdr", Definition("msg", OTHER_SCAN), [tmp_path])
    assert [name for name, _ in choice.best.types["velodyne_msgs/msg/VelodyneScan"][1]] == [
        "speed",
        "packets",
    ]


def test_an_embedded_definition_that_leaves_out_standard_types_is_completed():
    text = "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    choice = choice_of("my_msgs/msg/Where", "cdr", Definition("msg", text), [])
    assert choice.best.types.keys() >= {"std_msgs/msg/Header", "geometry_msgs/msg/Quaternion"}


WHERE = "geometry_msgs/Point point\nfloat64[] values\nfloat32[3] range\nstring name\nbool ok\nuint8 level\n"
WHERE_IDL = """// generated from rosidl_adapter/resource/msg.idl.em
#include "geometry_msgs/msg/Point.idl"

module my_msgs {
  module msg {
    typedef float float__3[3];
    @verbatim (language="comment", text=
      "Where it is.")
    struct Where {
      @verbatim (language="comment", text= "In" " metres.")
      @unit (value="m")
      geometry_msgs::msg::Point point;

      sequence<double> values;

      float__3 range;

      string name;

      boolean ok;

      uint8 level;
    };
  };
};
"""
POINT_IDL = "module geometry_msgs {\n  module msg {\n    struct Point {\n      double x;\n      double y;\n      double z;\n    };\n  };\n};\n"
RULE = "=" * 80 + "\n"


@pytest.mark.parametrize(
    "text",
    [
        f"{RULE}IDL: my_msgs/msg/Where\n{WHERE_IDL}\n{RULE}IDL: geometry_msgs/msg/Point\n{POINT_IDL}",
        f"{WHERE_IDL}\n{RULE}IDL: geometry_msgs/msg/Point\n{POINT_IDL}",
        WHERE_IDL,
    ],
)
def test_definitions_in_idl_mean_the_same_as_in_msg(text):
    idl = choice_of("my_msgs/msg/Where", "cdr", Definition("idl", text), [])
    assert isinstance(idl, Choice), idl
    assert idl.best.digest == choice_of("my_msgs/msg/Where", "cdr", Definition("msg", WHERE), []).best.digest
    message = fill(idl.best, point={"x": 1.0}, values=[2.0], range=[3, 4, 5], name="n", ok=True, level=6)
    decoded = idl.decode(idl.best.store.serialize_cdr(message, "my_msgs/msg/Where"))
    assert (decoded.point.x, decoded.range.tolist(), decoded.level) == (1.0, [3.0, 4.0, 5.0], 6)


@pytest.mark.parametrize(
    ("definition", "words"),
    [
        (Definition("msg", "my_msgs/Other other\n"), "refers to types that are not defined"),
        (Definition("msg", "this is ( no definition\n"), "cannot be used"),
        (Definition("none", ""), "name a folder of .msg files"),
        (None, "name a folder of .msg files"),
    ],
)
def test_a_type_that_cannot_be_decoded_says_why(definition, words):
    assert words in choice_of("my_msgs/msg/Where", "cdr", definition, [])


def test_a_folder_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(RecordingError, match="no such folder"):
        choice_of("my_msgs/msg/Where", "cdr", None, [tmp_path / "gone"])


# --- definitions and keys ----------------------------------------------------------------


def write_mcap(path, definition, payloads, msgtype="my_msgs/msg/Pair", more=()):
    """Write a topic /pair whose payloads are as given, and `more` (topic, type, definition, payload)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        topics = [("/pair", msgtype, definition, payload) for payload in payloads] + list(more)
        channels = {}
        for i, (topic, kind, text, payload) in enumerate(topics):
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], START_NS + i, payload, START_NS + i)
        writer.finish()
    return path


PAIR = b"\0\1\0\0" + struct.pack("<ff", 1.5, -2.5)


def digest_with(tmp_path, name, definition):
    path = write_mcap(tmp_path / f"{name}.mcap", definition, [PAIR, PAIR])
    inventory, pack = inventory_of(path, tmp_path / name)
    with pack:
        values = [pack.decode(message).first for message in pack.messages(["/pair"])]
    return inventory.topic("/pair").digest, values


def test_a_definition_that_makes_other_numbers_of_the_same_bytes_changes_the_topics_digest(tmp_path):
    one, values = digest_with(tmp_path, "one", "float32 first\nfloat32 second\n")
    swapped, others = digest_with(tmp_path, "swapped", "float32 second\nfloat32 first\n")
    assert (values, others) == ([1.5, 1.5], [-2.5, -2.5])
    assert one != swapped
    integers, _ = digest_with(tmp_path, "integers", "uint32 first\nfloat32 second\n")
    assert integers not in {one, swapped}


def test_comments_and_blanks_in_a_definition_change_nothing(tmp_path):
    one, _ = digest_with(tmp_path, "one", "float32 first\nfloat32 second\n")
    commented, _ = digest_with(tmp_path, "two", "# A pair.\n\nfloat32   first # one\nfloat32 second\n")
    assert one == commented


def test_constants_change_the_digest_because_decoders_may_read_them(tmp_path):
    one, _ = digest_with(tmp_path, "one", "uint8 MODE=1\nfloat32 first\nfloat32 second\n")
    two, _ = digest_with(tmp_path, "two", "uint8 MODE=2\nfloat32 first\nfloat32 second\n")
    assert one != two


def test_a_nested_definition_counts_too(tmp_path):
    def nested(fields):
        return "Inner inner\nfloat32 first\n" + "=" * 80 + f"\nMSG: my_msgs/Inner\n{fields}\n"

    one, _ = digest_with(tmp_path, "one", nested("float32 a"))
    two, _ = digest_with(tmp_path, "two", nested("uint32 a"))
    assert one != two


# --- messages that do not fit their definition -------------------------------------------


def test_a_topic_whose_messages_do_not_fit_their_definition_is_named_and_costs_nothing_else(tmp_path):
    # As some serializers write it: empty sequences of float64 are padded to eight bytes.
    layout = layout_of("sensor_msgs/msg/JointState")
    padded = b"\0\1\0\0" + struct.pack("<iIIxxxxIIxxxxIxxxxIxxxx", 0, 0, 1, 0, 0, 0, 0)
    more = [("/joints", "sensor_msgs/msg/JointState", layout.text, padded)] * 8
    path = write_mcap(tmp_path / "a.mcap", "float32 first\nfloat32 second\n", [PAIR], more=more)
    inventory, pack = inventory_of(path, tmp_path / "artifact")
    problem = inventory.topic("/joints").problem
    assert (
        problem
        == "its messages do not fit the definition of sensor_msgs/msg/JointState that is in the recording"
    )
    assert any(note.startswith("/joints cannot be decoded") for note in inventory.notes)
    assert inventory.topic("/joints").count == 8
    assert inventory.topic("/pair").problem is None
    with pack:
        assert pack.topics["/joints"].problem == problem
        assert [pack.decode(message).first for message in pack.messages(["/pair"])] == [1.5]


def test_damaged_messages_at_the_front_do_not_condemn_a_topic(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", "float32 first\nfloat32 second\n", [b"\0\1\0\0", b"", PAIR])
    inventory, _ = inventory_of(path, tmp_path / "artifact")
    assert inventory.topic("/pair").problem is None


def test_a_single_message_that_does_not_fit_condemns_its_topic(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", "float64[9] first\n", [PAIR])
    inventory, _ = inventory_of(path, tmp_path / "artifact")
    assert "do not fit the definition of my_msgs/msg/Pair" in inventory.topic("/pair").problem


def test_steps_decode_a_topic_as_the_inventory_found_it(tmp_path):
    old = layout_of(ARRAY, 1)
    empty, full = detections(old, []), detections(old, ["car"])
    path = write_bare(
        tmp_path / "bag", [("/boxes", old, START_NS, empty), ("/boxes", old, START_NS + 1, full)]
    )
    inventory, _ = inventory_of(path, tmp_path / "artifact")
    with open_recording(path) as recording:
        assert recording.is_ambiguous("/boxes")
        recording.assume(
            {"/boxes": inventory.topic("/boxes").definition, "/gone": Definition("msg", "uint8 x\n")}
        )
        assert not recording.is_ambiguous("/boxes")
        assert recording.definition("/boxes") == inventory.topic("/boxes").definition
        first = next(recording.restrict(["/boxes"]).messages(["/boxes"]))
        assert recording.decode(first).detections == []


def test_what_came_with_a_recording_is_never_replaced_by_what_was_assumed(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", "float32 first\nfloat32 second\n", [PAIR])
    with open_recording(path) as recording:
        recording.assume({"/pair": Definition("msg", "float32 second\nfloat32 first\n")})
        assert recording.decode(next(recording.messages(["/pair"]))).first == 1.5


def test_topics_of_one_type_with_different_definitions_go_by_their_own(tmp_path):
    swapped = [("/swapped", "my_msgs/msg/Pair", "float32 second\nfloat32 first\n", PAIR)]
    path = write_mcap(tmp_path / "a.mcap", "float32 first\nfloat32 second\n", [PAIR], more=swapped)
    inventory, pack = inventory_of(path, tmp_path / "artifact")
    with pack, open_recording(path) as recording:
        for source in (pack, recording):
            first = {m.topic: source.decode(m).first for m in source.messages(["/pair", "/swapped"])}
            assert first == {"/pair": 1.5, "/swapped": -2.5}
    assert inventory.topic("/pair").digest != inventory.topic("/swapped").digest


@pytest.mark.parametrize(
    ("other", "problem"),
    [
        ("float32 second\nfloat32 first\n", "two different definitions of my_msgs/msg/Pair"),
        ("# the same\nfloat32 first\nfloat32 second\n", None),
    ],
)
def test_one_topic_with_two_definitions_is_decoded_only_if_they_agree(tmp_path, other, problem):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        for i, text in enumerate(["float32 first\nfloat32 second\n", other]):
            schema = writer.register_schema("my_msgs/msg/Pair", "ros2msg", text.encode())
            channel = writer.register_channel("/pair", "cdr", schema, {"publisher": str(i)})
            writer.add_message(channel, START_NS + i, PAIR, START_NS + i)
        writer.finish()
    with open_recording(path) as recording:
        info = recording.topics["/pair"]
        assert info.count == 2
        assert info.problem is None if problem is None else problem in info.problem
