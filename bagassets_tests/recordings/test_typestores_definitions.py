"""Definitions that come with recordings or by hand: who wins, what they do to keys, messages that do not fit."""

import struct
from dataclasses import replace

import pytest
from mcap.writer import Writer as McapWriter

from bagassets.base.errors import RecordingError
from bagassets.recordings.layouts import Choice, choice_of
from bagassets.recordings.model import Definition
from bagassets.recordings.open import open_recording
from bagassets_tests.layout_data import fill, inventory_of, layout_of, serialized

START_NS = 1_600_000_000_000_000_000
ARRAY = "vision_msgs/msg/Detection3DArray"


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
    for little_endian in (True, False):
        decoded = idl.decode(serialized(idl.best, message, little_endian=little_endian))
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


def digest_of(tmp_path, name, definition):
    path = write_mcap(tmp_path / f"{name}.mcap", definition, [PAIR, PAIR])
    inventory, pack = inventory_of(path, tmp_path / name)
    with pack:
        return inventory.topic("/pair").digest, [pack.decode(message) for message in pack.messages(["/pair"])]


def digest_with(tmp_path, name, definition):
    digest, messages = digest_of(tmp_path, name, definition)
    return digest, [message.first for message in messages]


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


def test_line_ends_of_windows_in_a_definition_change_nothing(tmp_path):
    fields = "float32 first\nfloat32 second\nstring NAME=pair\n"
    text = f"uint8 MODE=1 # a constant\nInner inner\n{RULE}MSG: my_msgs/Inner\n{fields}"
    one, _ = digest_of(tmp_path, "one", text)
    windows, (message, _) = digest_of(tmp_path, "windows", text.replace("\n", "\r\n"))
    assert (one, message.inner.first, message.inner.NAME) == (windows, 1.5, "pair")


@pytest.mark.parametrize("definition", [Definition("msg", WHERE), Definition("idl", WHERE_IDL)])
def test_line_ends_of_windows_mean_nothing_in_either_language(definition):
    windows = replace(definition, text=definition.text.replace("\n", "\r\n"))
    read, expected = (choice_of("my_msgs/msg/Where", "cdr", one, []) for one in (windows, definition))
    assert isinstance(read, Choice), read
    assert read.best.digest == expected.best.digest


@pytest.mark.parametrize(
    "constants",
    ["uint8 idle = 3\nuint8 hover = 1\n", "uint8 idle=3\n\tuint8  Take_Off=1 # up\nbool A__B=1\n"],
)
def test_constants_may_have_names_in_lower_case_as_ros_1_has_them(tmp_path, constants):
    plain, values = digest_with(tmp_path, "plain", "float32 first\nfloat32 second\n")
    named, messages = digest_of(tmp_path, "named", f"float32 first\n{constants}float32 second\n")
    assert ([message.first for message in messages], messages[0].idle) == (values, 3)
    assert named != plain


def test_packages_may_have_names_in_upper_case_as_ros_1_has_them():
    text = f"AcmeRobot/Inner inner\n{RULE}MSG: AcmeRobot/Inner\nOther other\n{RULE}MSG: AcmeRobot/Other\nuint8 x\n"
    read = choice_of("AcmeRobot/msg/Outer", "ros1", Definition("msg", text), [])
    assert isinstance(read, Choice), read
    assert read.best.decode(b"\x07").inner.other.x == 7


def test_a_definition_by_hand_may_have_such_constants_too(tmp_path):
    path = tmp_path / "acme_msgs/msg/Mode.msg"
    path.parent.mkdir(parents=True)
    path.write_text("uint8 idle = 0\r\nuint8 mode\r\n")
    read = choice_of("acme_msgs/msg/Mode", "ros1", None, [tmp_path])
    assert isinstance(read, Choice), read
    assert read.best.decode(b"\x07").mode == 7


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


def test_what_came_with_a_recording_is_never_replaced_by_what_was_assumed(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", "float32 first\nfloat32 second\n", [PAIR])
    with open_recording(path) as recording:
        recording.topics["/pair"].assume(Definition("msg", "float32 second\nfloat32 first\n"))
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
