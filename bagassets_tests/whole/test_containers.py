"""Containers that are unusual in themselves: two types on a topic, indexes that lack something, metadata that are not plain."""

import itertools
import json

import pytest
import yaml
import zstandard
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import Writer as Rosbag2Writer

from bagassets.assets.inventory import MOST_MISFITS
from bagassets.base.errors import DecodeError, RecordingError, SizeLimitError
from bagassets.engine.execute import BuildFailure
from bagassets.recipe.model import Limits
from bagassets.recordings import sizes
from bagassets.recordings.describe import describe_inventory
from bagassets.recordings.open import open_recording
from bagassets_tests.layout_data import inventory_of
from bagassets_tests.small_drive import START_NS, STORE1, STORE2, messages
from bagassets_tests.tiny_mcap import write_tiny
from bagassets_tests.whole.test_end_to_end import build_of, make_project

OLD_TF, TF, NUMBER, TEXT = (
    "tf/msg/tfMessage",
    "tf2_msgs/msg/TFMessage",
    "std_msgs/msg/Int32",
    "std_msgs/msg/String",
)


def serialized(store, msgtype, number):
    if msgtype == TEXT:
        message = store.types[TEXT](str(number))
    elif msgtype == NUMBER:
        message = store.types[NUMBER](number)
    else:
        message = next(
            m for topic, _, _, m in messages(store, 0.1, ros1=store is STORE1) if topic == "/tf_static"
        )
        msgtype = TF
    write = store.serialize_ros1 if store is STORE1 else store.serialize_cdr
    return bytes(write(message, msgtype))


def definition_of(store, msgtype):
    return store.generate_msgdef(
        TF if msgtype == OLD_TF else msgtype, ros_version=1 if store is STORE1 else 2
    )[0]


def write_types(path, file_format, connections, definition=definition_of):
    """Write three messages on each of (topic, type), by turns."""
    store = STORE1 if file_format == "ros1" else STORE2
    if file_format == "mcap":
        stream = path.open("wb")
        writer = McapWriter(stream)
        writer.start()
        ids = []
        for topic, msgtype in connections:
            schema = writer.register_schema(msgtype, "ros2msg", definition(store, msgtype).encode())
            ids.append(writer.register_channel(topic, "cdr", schema))
    elif file_format == "ros1":
        writer = Rosbag1Writer(path)
        writer.open()
    else:
        writer = Rosbag2Writer(path, version=9)
        writer.open()
    if file_format != "mcap":
        ids = [
            writer.add_connection(topic, msgtype, msgdef=definition(store, msgtype), **extra)
            for topic, msgtype in connections
            for extra in ({"md5sum": "*"} if file_format == "ros1" else {"rihs01": "RIHS01_x"},)
        ]
    for number, ((_, msgtype), one) in itertools.product(range(3), zip(connections, ids, strict=True)):
        time_ns, data = START_NS + number * 1000 + ids.index(one), serialized(store, msgtype, number)
        if file_format == "mcap":
            writer.add_message(one, time_ns, data, time_ns)
        else:
            writer.write(one, time_ns, data)
    if file_format == "mcap":
        writer.finish()
        stream.close()
    else:
        writer.close()
    return path


@pytest.fixture(
    params=[("ros1", "a.bag"), ("ros2", "b"), ("mcap", "c.mcap"), ("db3", "d.db3")], ids=lambda p: p[0]
)
def typed(request, tmp_path):
    file_format, name = request.param

    def write(connections):
        if file_format != "db3":
            return write_types(tmp_path / name, file_format, connections)
        (database,) = write_types(tmp_path / "made", "ros2", connections).glob("*.db3")
        return database.rename(tmp_path / name)

    return write


def decoded(recording, topic):
    values = []
    for message in recording.messages([topic]):
        try:
            values.append(recording.decode(message))
        except DecodeError as err:
            values.append(str(err))
    return values


def test_messages_of_another_type_than_most_on_their_topic_are_lost_with_the_reason(typed, tmp_path):
    path = typed([("/x", TEXT), ("/x", NUMBER), ("/y", NUMBER)])
    reason = f"it is {NUMBER}, and most on its topic are {TEXT}"
    with open_recording(path) as recording:
        assert recording.topics["/x"].problem is None
        assert recording.topics["/x"].msgtype == TEXT
        values = [value if isinstance(value, str) else value.data for value in decoded(recording, "/x")]
        assert values == ["0", reason, "1", reason, "2", reason]
        assert {message.msgtype for message in recording.messages(["/x"])} == {TEXT}
        assert [message.data for message in decoded(recording, "/y")] == [0, 1, 2]
    inventory, pack = inventory_of(path, tmp_path / "inventory")
    assert inventory.topics["/x"].count == 6
    assert inventory.has_readable("/x")
    assert inventory.notes == (f"/x: 3 of 6 messages cannot be used, each because {reason}.",)
    assert list(pack.topics) == ["/y"]  # a pack could not say why


@pytest.mark.parametrize(
    ("msgtypes", "most"),
    [((TEXT, TF), TF), ((TF, TEXT), TF), ((NUMBER, TEXT), NUMBER), ((TEXT, NUMBER), TEXT)],
)
def test_of_as_many_messages_of_two_types_the_first_that_is_more_than_a_bare_value_counts(
    typed, msgtypes, most
):
    with open_recording(typed([("/x", msgtype) for msgtype in msgtypes])) as recording:
        assert recording.topics["/x"].msgtype == most
        assert sum(not isinstance(value, str) for value in decoded(recording, "/x")) == 3


def write_one_after_the_other(path, kinds):
    """Write an MCAP with one topic and (type or None, number of messages), each on a channel of its own."""
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        time_ns = START_NS
        for msgtype, number in kinds:
            schema = (
                0
                if msgtype is None
                else writer.register_schema(msgtype, "ros2msg", definition_of(STORE2, msgtype).encode())
            )
            channel = writer.register_channel("/x", "cdr", schema)
            for _ in range(number):
                time_ns += 1000
                writer.add_message(channel, time_ns, serialized(STORE2, msgtype or NUMBER, number), time_ns)
        writer.finish()
    return path


def test_however_many_of_another_type_come_first(tmp_path):
    path = write_one_after_the_other(
        tmp_path / "a.mcap", [(NUMBER, MOST_MISFITS + 1), (TEXT, MOST_MISFITS + 2)]
    )
    inventory, _ = inventory_of(path, tmp_path / "inventory")
    assert inventory.topics["/x"].msgtype == TEXT
    assert inventory.topics["/x"].problem is None


def test_messages_of_no_type_are_of_the_one_that_others_on_the_topic_have(tmp_path):
    path = write_one_after_the_other(tmp_path / "a.mcap", [(None, 3), (NUMBER, 1)])
    with open_recording(path) as recording:
        assert recording.topics["/x"].msgtype == NUMBER
        assert [message.data for message in decoded(recording, "/x")] == [3, 3, 3, 1]


def test_a_topic_that_cannot_be_decoded_is_not_packed_as_if_it_could(tmp_path):
    path = write_types(
        tmp_path / "a.mcap",
        "mcap",
        [("/tf", OLD_TF), ("/tf", TF), ("/y", NUMBER)],
        definition=lambda store, msgtype: "int32 x" if msgtype == OLD_TF else definition_of(store, msgtype),
    )
    inventory, pack = inventory_of(path, tmp_path / "inventory")
    assert "two different definitions" in inventory.topics["/tf"].problem
    assert list(pack.topics) == ["/y"]


def test_messages_that_fit_are_used_although_the_first_ones_do_not(tmp_path):
    path = write_tiny(
        tmp_path / "a.mcap",
        spoil=lambda topic, n, data: data[:9] if topic == "/odom" and n < MOST_MISFITS else data,
    )
    inventory, pack = inventory_of(path, tmp_path / "inventory")
    assert inventory.topics["/odom"].problem is None
    values = decoded(pack, "/odom")
    assert [isinstance(value, str) for value in values] == [n < MOST_MISFITS for n in range(len(values))]


def test_of_as_many_the_type_that_was_first_counts(tmp_path):
    for number, types in enumerate([(NUMBER, TEXT), (TEXT, NUMBER)]):
        path = write_types(tmp_path / f"{number}.mcap", "mcap", [("/x", msgtype) for msgtype in types])
        with open_recording(path) as recording:
            assert recording.topics["/x"].msgtype == types[0]


def test_a_sensor_without_a_frame_is_not_told_so_if_nothing_of_its_topic_can_be_decoded(tmp_path):
    recipe = make_project(tmp_path)
    recipe.bags.root.mkdir()
    write_tiny(
        recipe.bags.root / "a.mcap", spoil=lambda topic, _, data: data[:9] if topic == "/points" else data
    )
    with pytest.raises(BuildFailure, match=r"/points cannot be decoded.*do not fit the definition"):
        list(build_of(recipe, "a.mcap").build())


def test_the_old_and_the_new_name_of_tf_are_one_type(typed, tmp_path):
    path = typed([("/tf", OLD_TF), ("/tf", TF)])
    with open_recording(path) as recording:
        assert recording.topics["/tf"].problem is None
        assert [len(message.transforms) for message in decoded(recording, "/tf")] == [2] * 6
    inventory, _ = inventory_of(path, tmp_path / "inventory")
    assert inventory.has_readable("/tf")
    assert inventory.topics["/tf"].count == 6
    assert inventory.notes == ()


def test_they_are_two_if_their_definitions_differ(tmp_path):
    path = write_types(
        tmp_path / "a.mcap",
        "mcap",
        [("/tf", OLD_TF), ("/tf", TF)],
        definition=lambda store, msgtype: "int32 x" if msgtype == OLD_TF else definition_of(store, msgtype),
    )
    with open_recording(path) as recording:
        assert "two different definitions" in recording.topics["/tf"].problem


def test_a_frame_is_known_although_the_first_messages_cannot_be_decoded(tmp_path):
    recipe = make_project(tmp_path)
    recipe.bags.root.mkdir()
    write_tiny(
        recipe.bags.root / "a.mcap",
        spoil=lambda topic, n, data: data[:60] if topic == "/points" and n < MOST_MISFITS else data,
    )
    made = {one.asset: one for one in build_of(recipe, "a.mcap").build()}
    assert (
        made["calibration"].artifact.read_json("calibration.json")["channels"]["LIDAR_TOP"]["frame"]
        == "lidar"
    )


# --- metadata of a folder ------------------------------------------------------------------------


def edited(folder, edit):
    """Have `edit` change the facts in the metadata of a folder."""
    file = folder / "metadata.yaml"
    facts = yaml.safe_load(file.read_text())
    edit(facts["rosbag2_bagfile_information"])
    file.write_text(yaml.safe_dump(facts))
    return folder


@pytest.fixture
def folder(tmp_path):
    return write_types(tmp_path / "b", "ros2", [("/x", NUMBER), ("/y", TEXT)])


def topic_of(facts, name):
    return next(
        entry["topic_metadata"]
        for entry in facts["topics_with_message_count"]
        if entry["topic_metadata"]["name"] == name
    )


def test_what_the_file_has_counts_too_if_the_metadata_do_not_know_it(folder, tmp_path):
    """A recorder that was killed had not listed the topics that came last."""
    edited(folder, lambda facts: facts["topics_with_message_count"].pop())
    with open_recording(folder) as recording:
        assert {name: topic.count for name, topic in recording.topics.items()} == {"/x": 3, "/y": 3}
        assert [len(decoded(recording, name)) for name in ("/x", "/y")] == [3, 3]


def test_plain_metadata_may_leave_things_out(folder):
    def edit(facts):
        topic_of(facts, "/x").update(serialization_format=None)
        del topic_of(facts, "/y")["serialization_format"]
        facts.update(compression_mode=None, compression_format=None)

    with open_recording(edited(folder, edit)) as recording:
        assert [topic.problem for topic in recording.topics.values()] == [None, None]
        assert [len(decoded(recording, name)) for name in ("/x", "/y")] == [3, 3]


def test_a_type_about_which_metadata_and_file_disagree_costs_the_messages(folder):
    edited(folder, lambda facts: topic_of(facts, "/y").update(type=NUMBER))
    with open_recording(folder) as recording:
        assert recording.topics["/y"].count == 3
        assert decoded(recording, "/y") == [f"it is {TEXT}, and most on its topic are {NUMBER}"] * 3
        assert [message.data for message in decoded(recording, "/x")] == [0, 1, 2]


@pytest.mark.parametrize(
    "edit",
    [
        lambda facts: topic_of(facts, "/x").update(name=[["/x"] * 3] * 3),
        lambda facts: topic_of(facts, "/x").update(type={"a": "b"}),
        lambda facts: topic_of(facts, "/x").update(name="/x" + "a" * 5000),
        lambda facts: topic_of(facts, "/x").update(serialization_format=["cdr"]),
        lambda facts: facts["topics_with_message_count"][0].update(message_count=[3]),
        lambda facts: facts.update(relative_file_paths=[["b.db3"]]),
        lambda facts: facts.update(relative_file_paths="b.db3"),
        lambda facts: facts.update(compression_mode=["file"]),
        lambda facts: facts.update(compression_mode="file", compression_format=["zstd"]),
        lambda facts: facts.update(relative_file_paths=["a" * 5000 + ".db3"]),
    ],
)  # fmt: skip
def test_metadata_that_are_not_plain_are_refused_in_a_short_sentence(folder, edit):
    with pytest.raises(RecordingError, match=r"cannot be read \(its metadata\.yaml") as caught:
        open_recording(edited(folder, edit))
    assert len(str(caught.value)) < 600


def test_a_file_that_is_listed_twice_is_read_once(folder):
    edited(folder, lambda facts: facts.update(relative_file_paths=["b.db3", "./b.db3", "b.db3"]))
    with open_recording(folder) as recording:
        assert [message.data for message in decoded(recording, "/x")] == [0, 1, 2]


def mcap_folder(folder, number, payload=None):
    """Write a bag of MCAP files with one message each on /x, a text of `payload` letters or a number without a schema."""
    folder.mkdir()
    for part in range(number):
        with (folder / f"b_{part}.mcap").open("wb") as stream:
            writer = McapWriter(stream)
            writer.start()
            if payload is None:
                schema, data = 0, serialized(STORE2, NUMBER, part)
            else:
                schema = writer.register_schema(TEXT, "ros2msg", b"string data")
                data = bytes(STORE2.serialize_cdr(STORE2.types[TEXT]("a" * payload), TEXT))
            writer.add_message(
                writer.register_channel("/x", "cdr", schema), START_NS + part, data, START_NS + part
            )
            writer.finish()
    topic = {"name": "/x", "type": NUMBER if payload is None else TEXT, "serialization_format": "cdr"}
    facts = {
        "version": 5,
        "relative_file_paths": [f"b_{part}.mcap" for part in range(number)],
        "topics_with_message_count": [{"topic_metadata": topic, "message_count": number}],
    }
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": facts}))
    return folder


def test_a_channel_without_a_schema_has_the_type_in_the_metadata(tmp_path):
    with open_recording(mcap_folder(tmp_path / "b", 3)) as recording:
        assert recording.topics["/x"].problem is None
        assert [message.data for message in decoded(recording, "/x")] == [0, 1, 2]


def test_messages_of_another_type_are_announced_once(tmp_path):
    folder = mcap_folder(tmp_path / "b", 3, payload=5)
    edited(folder, lambda facts: topic_of(facts, "/x").update(type=NUMBER))
    with open_recording(folder) as recording:
        assert recording.topics["/x"].count == 3
        assert decoded(recording, "/x") == [f"it is {TEXT}, and most on its topic are {NUMBER}"] * 3


def test_the_ratio_of_chunks_holds_for_the_recording(tmp_path, monkeypatch):
    folder = mcap_folder(tmp_path / "b", 3, payload=100_000)
    monkeypatch.setattr(sizes, "GIGABYTE", 301_000)
    open_recording(folder, limits=Limits(compression_ratio=10)).close()
    monkeypatch.setattr(sizes, "GIGABYTE", 299_000)
    with pytest.raises(SizeLimitError, match=r"limits\.compression_ratio"):
        open_recording(folder, limits=Limits(compression_ratio=10))


def packed_folder(folder, names):
    (database,) = folder.glob("*.db3")
    for name in names:
        (folder / f"{name}.zstd").write_bytes(zstandard.compress(database.read_bytes()))
    database.unlink()
    return edited(
        folder,
        lambda facts: facts.update(
            relative_file_paths=[f"{name}.zstd" for name in names],
            compression_mode="file",
            compression_format="zstd",
        ),
    )


def test_the_ratio_of_compression_holds_for_the_recording_not_for_each_file(folder, monkeypatch):
    size = next(folder.glob("*.db3")).stat().st_size
    packed_folder(folder, ["b_0.db3", "b_1.db3", "b_2.db3"])
    packed = sum(file.stat().st_size for file in folder.glob("*.zstd"))
    assert 3 * size > 10 * packed
    monkeypatch.setattr(sizes, "GIGABYTE", 3 * size)
    open_recording(folder, limits=Limits(compression_ratio=10)).close()
    monkeypatch.setattr(sizes, "GIGABYTE", 3 * size - 1)
    with pytest.raises(SizeLimitError, match=r"limits\.compression_ratio"):
        open_recording(folder, limits=Limits(compression_ratio=10))


def test_unpacked_files_leave_nothing_behind(folder, tmp_path, monkeypatch):
    packed_folder(folder, ["b_0.db3"])
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    with open_recording(folder) as recording:
        assert list(scratch.iterdir()) == []
        assert [message.data for message in decoded(recording, "/x")] == [0, 1, 2]


def test_a_long_name_is_shown_in_part(tmp_path):
    path = write_types(
        tmp_path / "a.mcap", "mcap", [("/" + "a" * 100_000, NUMBER), *((f"/{n}", TEXT) for n in range(50))]
    )
    inventory_of(path, tmp_path / "inventory")
    (file,) = (tmp_path / "inventory").rglob("inventory.json")
    text = describe_inventory(json.loads(file.read_text()))
    assert len(text) < 30_000


# --- indexes of MCAP ----------------------------------------------------------------------------


def write_indexed(path, **options):
    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=20_000, **options)
        writer.start()
        channels = {}
        for topic, msgtype, stamp_ns, message in messages(STORE2, 0.5):
            if topic not in channels:
                schema = writer.register_schema(
                    msgtype, "ros2msg", STORE2.generate_msgdef(msgtype, ros_version=2)[0].encode()
                )
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(
                channels[topic], stamp_ns, bytes(STORE2.serialize_cdr(message, msgtype)), stamp_ns
            )
        writer.finish()
    return path


INDEXES = {
    "all": IndexType.ALL,
    "chunks": IndexType.CHUNK,
    "messages": IndexType.MESSAGE,
    "none": IndexType.NONE,
}


def everything(path):
    with open_recording(path) as recording:
        counts = {name: topic.count for name, topic in recording.topics.items()}
        return counts, [
            (m.topic, m.log_time_ns, bytes(m.data)) for m in recording.messages(list(recording.topics))
        ]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return everything(write_indexed(tmp_path_factory.mktemp("whole") / "a.mcap"))


@pytest.mark.parametrize("statistics", [True, False])
@pytest.mark.parametrize("indexes", INDEXES)
@pytest.mark.parametrize("repeats", [True, False])
@pytest.mark.parametrize("chunking", [True, False])
def test_a_finished_mcap_is_read_whatever_its_summary_lacks(
    tmp_path, whole, statistics, indexes, repeats, chunking
):
    counts, read = everything(
        write_indexed(
            tmp_path / "a.mcap", index_types=INDEXES[indexes], use_statistics=statistics, use_chunking=chunking,
            repeat_channels=repeats, repeat_schemas=repeats, compression=CompressionType.LZ4,
        )
    )  # fmt: skip
    assert counts == whole[0]
    assert read == whole[1]


def test_counting_without_statistics_unpacks_nothing_if_there_is_an_index(tmp_path, monkeypatch):
    path = write_indexed(tmp_path / "a.mcap", use_statistics=False)
    monkeypatch.setattr("bagassets.recordings.mcap_index.load_chunk", None)
    with open_recording(path) as recording:
        assert recording.topics["/odom"].count == 26
