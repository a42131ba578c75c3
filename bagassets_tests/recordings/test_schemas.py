"""Messages that are not ROS: any field of any protobuf or JSON schema is reached by attributes, beside ROS in one file."""

import json
import re

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import Writer

from bagassets.assets.inventory import make_inventory
from bagassets.base.errors import DecodeError
from bagassets.decode.numeric_fields import numbers_at
from bagassets.recipe.model import Limits
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.open import open_recording
from bagassets.recordings.pack import PACK_FILE, Pack, PackedRecording
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets_tests.damaged_files import entries, write_folder
from bagassets_tests.foxglove_files import NS, M, T, pose, write_protobuf
from bagassets_tests.recorded_bags import ROS2

TEXT = "std_msgs/msg/String"
KIND = descriptor_pb2.FieldDescriptorProto


def arm_schema(*, extra="", comment=""):
    """Return a `FileDescriptorSet` of `acme.arm.State`, which has a nested type and an import."""
    files = descriptor_pb2.FileDescriptorSet()
    joint = files.file.add(name="acme/joint.proto", package="acme.arm", syntax="proto3")
    message = joint.message_type.add(name="Joint")
    message.field.add(name="name", number=1, type=KIND.TYPE_STRING, label=KIND.LABEL_OPTIONAL)
    message.field.add(name="position", number=2, type=KIND.TYPE_DOUBLE, label=KIND.LABEL_OPTIONAL)
    state = files.file.add(
        name="acme/state.proto", package="acme.arm", syntax="proto3", dependency=["acme/joint.proto"]
    )
    message = state.message_type.add(name="State")
    message.field.add(
        name="joints",
        number=1,
        type=KIND.TYPE_MESSAGE,
        label=KIND.LABEL_REPEATED,
        type_name=".acme.arm.Joint",
    )
    message.field.add(name="effort", number=2, type=KIND.TYPE_FLOAT, label=KIND.LABEL_REPEATED)
    message.field.add(name="mode", number=3, type=KIND.TYPE_INT64, label=KIND.LABEL_OPTIONAL)
    if extra:
        message.field.add(name=extra, number=4, type=KIND.TYPE_DOUBLE, label=KIND.LABEL_OPTIONAL)
    if comment:
        state.source_code_info.location.add(path=[4, 0], leading_comments=comment)
    return files


def arm_message(files, positions):
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("acme.arm.State"))
    message = kind(effort=[0.5, 1.5], mode=7)
    for number, position in enumerate(positions):
        message.joints.add(name=f"j{number}", position=position)
    return message.SerializeToString()


def write(path, *topics):
    """Write (topic, schema name, its encoding, its bytes, message encoding, payloads)."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for topic, name, schema_encoding, schema, encoding, payloads in topics:
            number = writer.register_schema(name, schema_encoding, schema) if name else 0
            channel = writer.register_channel(topic, encoding, number)
            for at, payload in enumerate(payloads):
                writer.add_message(channel, NS + at, payload, NS + at)
        writer.finish()
    return path


def ros(text="hello"):
    definition, _ = ROS2.generate_msgdef(TEXT, ros_version=2)
    payload = bytes(ROS2.serialize_cdr(ROS2.types[TEXT](text), TEXT))
    return ("/ros", TEXT, "ros2msg", definition.encode(), "cdr", [payload])


def arm(topic="/arm", *, files=None, positions=(0.25, -0.5)):
    files = files or arm_schema()
    return (
        topic,
        "acme.arm.State",
        "protobuf",
        files.SerializeToString(),
        "protobuf",
        [arm_message(files, positions)],
    )


def of_json(value, schema=None, topic="/json", name="acme.Speed"):
    if schema is None:
        return (topic, "", "", b"", "json", [json.dumps(value).encode()])
    return (topic, name, "jsonschema", json.dumps(schema).encode(), "json", [json.dumps(value).encode()])


def messages(path, limits=None):
    with open_recording(path, limits=limits) as recording:
        return {raw.topic: recording.decode(raw) for raw in recording.messages(list(recording.topics))}


def test_protobuf_json_and_ros_in_one_file(tmp_path):
    path = write(tmp_path / "a.mcap", ros(), arm(), of_json({"speed": 1.5, "wheels": {"left": [1, 2]}}))
    found = messages(path)
    assert found["/ros"].data == "hello"
    assert [joint.position for joint in found["/arm"].joints] == [0.25, -0.5]
    assert (found["/arm"].joints[1].name, list(found["/arm"].effort), found["/arm"].mode) == (
        "j1",
        [0.5, 1.5],
        7,
    )
    assert (found["/json"].speed, found["/json"].wheels.left.tolist()) == (1.5, [1, 2])


def test_what_cannot_be_read_costs_its_topic_and_is_named(tmp_path, store_of):
    broken = ("/broken", "acme.arm.Nothing", "protobuf", arm_schema().SerializeToString(), "protobuf", [b""])
    torn = ("/torn", "acme.arm.State", "protobuf", b"\xff\xff", "protobuf", [b""])
    bare = ("/bare", "", "", b"", "protobuf", [b""])
    cbor = ("/cbor", "", "", b"", "cbor", [b"\xa0"])
    path = write(tmp_path / "a.mcap", ros(), broken, torn, bare, cbor)
    value, _ = store_of(path)
    problems = {topic["name"]: topic["problem"] for topic in value["topics"]}
    assert problems == {
        "/ros": None,
        "/broken": "the schema of acme.arm.Nothing cannot be used (it is damaged, or refers to types that are not in it)",
        "/torn": "the schema of acme.arm.State cannot be used (it is damaged, or refers to types that are not in it)",
        "/bare": "there is no protobuf schema of unknown in the recording",
        "/cbor": "its message encoding is 'cbor', not cdr, ros1, protobuf or json",
    }
    assert {topic["name"]: topic["count"] for topic in value["topics"]} == dict.fromkeys(problems, 1)
    assert sum("cannot be decoded" in note for note in value["notes"]) == 4


GOAL_IDL = "module robot { @final struct Goal { long number; @optional long joint; float speed; }; };"
STATE_IDL = """module robot { // no @optional members
    struct State { long number; double speed; string name; };
};"""
# {7, 1.5, "ab"}, as Cyclone DDS writes it.
STATE = "0001 0000 07000000 00000000 000000000000f83f 03000000 616200"
EXTENDED = "it is in extended CDR (XCDR2, or a list of parameters); record it in plain CDR (XCDR1)"


def dds(topic, name, idl, data):
    return (topic, name, "omgidl", idl.encode(), "cdr", [bytes.fromhex(data)])


def test_omg_idl_has_names_of_any_depth(tmp_path):
    deep = f"module acme {{ {STATE_IDL} }};"
    path = write(
        tmp_path / "a.mcap",
        dds("/a", "robot::State", STATE_IDL, STATE),
        dds("/b", "acme::robot::State", deep, STATE),
    )
    found = messages(path)
    assert {(one.number, one.speed, one.name) for one in found.values()} == {(7, 1.5, "ab")}
    with open_recording(path) as recording:
        assert {topic.msgtype for topic in recording.topics.values()} == {"robot/State", "acme/robot/State"}


@pytest.mark.parametrize(
    "data",
    [
        "0007 0000 07000000 000000000000f83f 03000000 616200",
        "0009 0000 13000000 07000000 000000000000f83f 03000000 616200",
        "0009 0000 0c000000 07000000 000000000000f83f",  # as long as what is expected
        "000b 0000 1f000000 00000020 07000000 01000030 000000000000f83f 02000050 03000000 616200",
    ],
    ids=["plain", "appendable", "of the same length", "mutable"],
)
def test_extended_cdr_is_named(tmp_path, store_of, data):
    idl = STATE_IDL if data.endswith("616200") else STATE_IDL.replace("string name; ", "")
    value, _ = store_of(write(tmp_path / "a.mcap", dds("/a", "robot::State", idl, data)))
    (topic,) = value["topics"]
    assert topic["problem"] == f"none of its messages can be decoded: {EXTENDED}"


def test_messages_whose_compression_is_not_told_name_what_tells_it(tmp_path, store_of):
    folder = write_folder(tmp_path / "drive", entries(30), mode="MESSAGE")
    metadata = folder / "metadata.yaml"
    told = metadata.read_text()
    metadata.write_text(re.sub("compression_(format|mode): .*", r"compression_\1: ''", told))
    value, _ = store_of(folder)
    (problem,) = {topic["problem"] for topic in value["topics"]}
    assert "it is compressed by zstd, which nothing says; give its folder a metadata.yaml with" in problem
    metadata.write_text(re.sub("compression_format: .*", "compression_format: zstd", told))
    with open_recording(folder) as recording:
        assert len(list(recording.messages(list(recording.topics)))) == len(entries(30))


def test_optional_members_of_omg_idl_are_refused(tmp_path):
    """Without a joint, this has the length of a goal with one."""
    path = write(
        tmp_path / "a.mcap", dds("/a", "robot::Goal", GOAL_IDL, "0007 0000 07000000 00000000 0000c03f")
    )
    with open_recording(path) as recording:
        assert recording.topics["/a"].problem == (
            "its type has optional members (@optional), which are not read; record one without them"
        )


@pytest.fixture
def store_of(tmp_path):
    """Make the inventory of a recording; return it, and what is in its pack."""

    def make(path):
        folder = tmp_path / "artifact"
        out = ArtifactWriter(folder)
        with open_recording(path) as recording:
            artifact = Artifact(out.finish(make_inventory(recording, out, size=1)), folder)
        value = artifact.read_json("inventory.json")
        return value, PackedRecording(Inventory.from_json(value), Pack(artifact.path(PACK_FILE)))

    return make


def test_the_pack_decodes_as_the_recording_does(tmp_path, store_of):
    path = write(tmp_path / "a.mcap", arm(), of_json({"a": [0.5]}, {"type": "object"}))
    value, pack = store_of(path)
    assert {topic["name"]: topic["packed"] for topic in value["topics"]} == {"/arm": True, "/json": True}
    found = {raw.topic: pack.decode(raw) for raw in pack.messages(["/arm", "/json"])}
    assert found["/arm"].joints[0].position == 0.25
    assert found["/json"].a.tolist() == [0.5]


def test_stamps_and_frames_reach_the_inventory(tmp_path, store_of):
    items = [
        ("/pose", NS + 5, M("PoseInFrame", timestamp=T(NS + i), frame_id="/map", pose=pose())) for i in (0, 3)
    ]
    value, _ = store_of(write_protobuf(tmp_path / "a.mcap", items))
    (topic,) = value["topics"]
    assert (topic["first_stamp_ns"], topic["last_stamp_ns"], topic["frame_ids"]) == (NS, NS + 3, ["map"])
    assert topic["type"] == "foxglove_msgs/msg/PoseInFrame"


def digest_of(path, topic):
    with open_recording(path) as recording:
        return recording.topics[topic].layout_digest


def test_the_digest_of_a_topic_covers_its_schema_but_no_comments(tmp_path):
    digests = [
        digest_of(write(tmp_path / f"{name}.mcap", arm(files=arm_schema(**changes))), "/arm")
        for name, changes in (("a", {}), ("b", {"comment": "of a reader"}), ("c", {"extra": "torque"}))
    ]
    assert digests[0] == digests[1] != digests[2]
    texts = [
        digest_of(write(tmp_path / "j.mcap", of_json({}, {"type": "object", **more})), "/json")
        for more in ({}, {"description": "said"}, {"properties": {"description": {"type": "number"}}})
    ]
    assert texts[0] == texts[1] != texts[2]


def test_one_topic_in_two_encodings_or_with_two_schemas_is_refused(tmp_path):
    name = "acme.arm.State"
    both = ("/arm", name, "jsonschema", b"{}", "json", [b"{}"])
    with open_recording(write(tmp_path / "a.mcap", arm(), both)) as recording:
        assert recording.topics["/arm"].problem == "its messages are encoded in two ways, protobuf and json"
    other = arm(files=arm_schema(extra="torque"))
    with open_recording(write(tmp_path / "b.mcap", arm(), other)) as recording:
        assert "two different definitions" in recording.topics["/arm"].problem
    same = arm(files=arm_schema(comment="x"))
    with open_recording(write(tmp_path / "c.mcap", arm(), same)) as recording:
        assert recording.topics["/arm"].problem is None


SPEED = {
    "type": "object",
    "properties": {
        "speed": {"type": "number"}, "count": {"type": "integer"}, "ok": {"type": "boolean"}, "name": {"type": "string"},
        "data": {"type": "string", "contentEncoding": "base64"}, "list": {"type": "array", "items": {"type": "number"}},
        "inner": {"$ref": "#/$defs/inner"}, "many": {"type": "array", "items": {"$ref": "#/$defs/inner"}},
    },
    "$defs": {"inner": {"type": "object", "properties": {"x": {"type": "number"}}}},
}  # fmt: skip


def test_json_has_the_types_of_its_schema(tmp_path):
    value = {
        "speed": 3,
        "count": 4,
        "ok": True,
        "name": "n",
        "data": "YWJj",
        "list": [1, None],
        "inner": {"x": 1},
    }
    found = messages(write(tmp_path / "a.mcap", of_json(value | {"many": [{"x": 2}], "more": 5}, SPEED)))[
        "/json"
    ]
    assert (found.speed, found.count, found.ok, found.name, found.data, found.more) == (
        3.0,
        4,
        True,
        "n",
        b"abc",
        5,
    )
    assert np.array_equal(found.list, [1.0, np.nan], equal_nan=True)
    assert (found.inner.x, found.many[0].x) == (1.0, 2.0)


def test_what_json_leaves_out_has_its_default(tmp_path):
    found = messages(write(tmp_path / "a.mcap", of_json({}, SPEED)))["/json"]
    assert (found.speed, found.count, found.ok, found.name, found.data) == (0.0, 0, False, "", b"")
    assert (found.inner.x, len(found.list), found.many) == (0.0, 0, [])


@pytest.mark.parametrize(
    "wrong",
    [
        {"speed": "fast"},
        {"count": 1.5},
        {"name": 3},
        {"list": 3},
        {"list": ["a"]},
        {"inner": [1]},
        {"data": "@"},
        [1],
    ],
    ids=str,
)
def test_json_that_does_not_fit_its_schema_is_lost(tmp_path, wrong):
    with pytest.raises(DecodeError, match=r"do not fit acme\.Speed"):
        messages(write(tmp_path / "a.mcap", of_json(wrong, SPEED)))


def test_json_of_several_types_and_null(tmp_path):
    schema = {
        "type": "object",
        "properties": {
            "maybe": {"type": ["number", "null"]}, "any": {"type": ["number", "string", "null"]},
            "union": {"anyOf": [{"type": "number"}, {"type": "null"}]}, "text": {"type": ["null", "string"]},
        },
    }  # fmt: skip
    value = {"maybe": None, "any": "a", "union": 2, "text": None}
    found = messages(write(tmp_path / "a.mcap", of_json(value, schema)))["/json"]
    assert np.isnan(found.maybe)
    assert (found.any, found.union, found.text) == ("a", 2, "")


def test_a_schema_that_contains_itself_has_defaults_of_one_level(tmp_path):
    node = {"type": "object", "properties": {"x": {"type": "number"}, "next": {"$ref": "#"}}}
    found = messages(write(tmp_path / "a.mcap", of_json({"next": {"x": 2}}, node)))["/json"]
    assert (found.x, found.next.x, found.next.next.x, found.next.next.next) == (0.0, 2.0, 0.0, None)


def test_signals_reach_any_number(tmp_path):
    found = messages(write(tmp_path / "a.mcap", arm(), of_json({"list": [1, 2], "inner": {"x": 3}}, SPEED)))
    assert numbers_at(found["/arm"], "joints.position")[:2] == (("j0", "j1"), pytest.approx([0.25, -0.5]))
    assert list(numbers_at(found["/arm"], "effort[1]").values) == [1.5]
    assert list(numbers_at(found["/json"], "list").values) == [1.0, 2.0]
    assert list(numbers_at(found["/json"], "inner.x").values) == [3.0]


@pytest.mark.parametrize("reference", ["#", "#/$defs/a", "#/nowhere"])
def test_references_without_an_end_or_aim_are_no_hang(tmp_path, reference):
    schema = {"$ref": reference, "$defs": {"a": {"$ref": "#/$defs/a"}}}
    with pytest.raises(DecodeError):
        messages(write(tmp_path / "a.mcap", of_json({}, schema)))


@pytest.mark.parametrize("schema", [{"properties": []}, {"properties": {"a": 3}}], ids=str)
def test_schemas_that_are_none_lose_messages_and_nothing_more(tmp_path, schema):
    path = write(tmp_path / "a.mcap", of_json({"a": [1]}, schema))
    with pytest.raises(DecodeError, match=r"do not fit acme\.Speed"):
        messages(path)


def test_lists_of_many_strings_and_messages_are_not_made_objects_of(tmp_path):
    few = Limits(message_elements=1000)
    for number, topic in enumerate(
        (arm(positions=[0.0] * 1500), of_json({"many": [{"x": 1}] * 1500}, SPEED))
    ):
        path = write(tmp_path / f"{number}.mcap", topic)
        with pytest.raises(DecodeError, match="message_elements"):
            messages(path, few)
        assert messages(path)


def test_bytes_that_are_no_message_are_lost(tmp_path):
    bad = (*arm()[:-1], [b"\x0a\xff"])
    with pytest.raises(DecodeError, match=r"do not fit acme\.arm\.State"):
        messages(write(tmp_path / "a.mcap", bad))
