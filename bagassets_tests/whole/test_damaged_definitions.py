"""A definition that cannot be used costs its topic, a message its message, and sentences say what is wrong."""

import random
import re
import sqlite3

import pytest
from rosbags.rosbag1 import Writer as Rosbag1Writer

from bagassets.base.errors import BagAssetsError, DiskError, RecordingError
from bagassets.recordings.damage import unreadable
from bagassets.recordings.layouts import choice_of
from bagassets.recordings.model import Definition
from bagassets.recordings.open import open_recording
from bagassets_tests import hostile
from bagassets_tests.hostile import RULE, cdr, definition_of
from bagassets_tests.recorded_bags import NOON_NS, text, write_ros1, write_ros2
from bagassets_tests.small_drive import RECIPE, write_drive
from bagassets_tests.tiny_mcap import write_tiny
from bagassets_tests.whole.test_end_to_end import build_of, make_project

pytestmark = pytest.mark.once

POINT = "float64 x\nfloat64 y\nfloat64 z\n"
# Name -> type, definition, what is said of it; nothing if it can be used all the same.
DEFINITIONS = {
    "a type that contains itself": ("my_msgs/msg/A", "my_msgs/A a\n", "my_msgs/msg/A contains itself"),
    "a list of itself": ("my_msgs/msg/A", "my_msgs/A[] a\n", "my_msgs/msg/A contains itself"),
    "a long chain": (
        "my_msgs/msg/T0",
        "T1 a\n" + "".join(f"{RULE}MSG: my_msgs/T{i}\nT{i + 1} a\n" for i in range(1, 1500)) + f"{RULE}MSG: my_msgs/T1500\nuint8 a\n",
        "cannot be used",
    ),
    "1e999": ("my_msgs/msg/A", f"float64 HUGE=1e999\n{POINT}", "cannot be used"),
    "a package that begins with a digit": ("3d_msgs/msg/A", POINT, "cannot be used"),
    "a comment in Latin-1": ("my_msgs/msg/A", f"# in \xb0C\n{POINT}".encode("latin-1"), None),
    "a name in Latin-1": ("my_msgs/msg/A", "float64 h\xf6he\n".encode("latin-1"), "it does not parse at character"),
    "no text at all": ("my_msgs/msg/A", b"\x00\xff\xfe" * 30, "cannot be used"),
    "a field of a Python name": ("my_msgs/msg/A", "float64 class\nfloat64 None\nfloat64 x\n", None),
    "two fields of one name": ("my_msgs/msg/A", "float64 a\nfloat64 a\n", "two of its fields have the same name"),
    "a number of 5000 digits": ("my_msgs/msg/A", f"int32 A={'9' * 5000}\n{POINT}", "cannot be used"),
    "an odd type": ("my msgs/msg/A\nuint8 b", POINT, "cannot be used"),
}  # fmt: skip


def write_ros1_definition(path, msgtype, definition):
    """Write a bag whose connection has any bytes as definition; a placeholder of the same length is replaced."""
    data = definition if isinstance(definition, bytes) else definition.encode()
    placeholder = "#" + "p" * (len(data) - 2) + "\n"
    with Rosbag1Writer(path) as writer:
        one = writer.add_connection("/hostile", msgtype, msgdef=placeholder, md5sum="*" * 32)
        good = writer.add_connection("/good", "std_msgs/msg/String", msgdef="string data\n", md5sum="*" * 32)
        for i in range(3):
            writer.write(one, NOON_NS + i, bytes(24))
            writer.write(good, NOON_NS + i, b"\x02\0\0\0ok")
    content = path.read_bytes()
    assert placeholder.encode() in content
    path.write_bytes(content.replace(placeholder.encode(), data))
    return path


def write_mcap_definition(path, msgtype, definition):
    string = cdr(b"\x03\0\0\0ok\0")
    topics = [
        ("/hostile", msgtype, definition, cdr(bytes(24))),
        ("/good", "std_msgs/msg/String", "string data\n", string),
    ]
    return hostile.write_mcap(path, topics * 3)


def write_ros2_definition(path, msgtype, definition):
    write_ros2(path, [text(NOON_NS + i, "ok", topic) for i in range(3) for topic in ("/hostile", "/good")])
    (database,) = path.glob("*.db3")
    data = definition if isinstance(definition, bytes) else definition.encode()
    with sqlite3.connect(database) as connection:
        connection.execute("UPDATE topics SET type = ? WHERE name = '/hostile'", (msgtype,))
        connection.execute("UPDATE messages SET data = ? WHERE topic_id = 1", (cdr(bytes(24)),))
        connection.execute(
            "INSERT INTO message_definitions (topic_type, encoding, encoded_message_definition, type_description_hash) "
            "VALUES (?, 'ros2msg', CAST(? AS TEXT), '')",
            (msgtype, data),
        )
    metadata = path / "metadata.yaml"
    said = metadata.read_text()
    first, mark, rest = said.partition("std_msgs/msg/String")
    assert mark
    metadata.write_text(first + '"' + msgtype.replace("\n", "\\n") + '"' + rest)
    return path


WRITERS = {"a.bag": write_ros1_definition, "b.mcap": write_mcap_definition, "c": write_ros2_definition}


class TestDefinitions:
    @pytest.mark.parametrize("name", DEFINITIONS)
    @pytest.mark.parametrize("file", WRITERS)
    def test_one_that_cannot_be_used_costs_its_topic(self, tmp_path, file, name):
        msgtype, definition, says = DEFINITIONS[name]
        path = WRITERS[file](tmp_path / file, msgtype, definition)
        with open_recording(path) as recording:
            assert set(recording.topics) == {"/hostile", "/good"}
            problem = recording.topics["/hostile"].problem
            assert (problem is None) == (says is None), problem
            assert problem is None or (says in problem and "\n" not in problem)
            read = list(recording.messages(["/hostile", "/good"]))
            assert len(read) == 6
            assert [recording.decode(m).data for m in read if m.topic == "/good"] == ["ok"] * 3
            if says is None:
                assert recording.decode(next(m for m in read if m.topic == "/hostile")) is not None

    @pytest.mark.parametrize("seed", range(60))
    def test_whatever_bytes_are_damaged(self, seed):
        dice = random.Random(seed)
        msgtype = dice.choice(
            ["nav_msgs/msg/Odometry", "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage"]
        )
        data = bytearray(definition_of(msgtype).encode())
        for _ in range(dice.choice([1, 3, 20])):
            at = dice.randrange(len(data))
            match dice.randrange(3):
                case 0:
                    data[at] = dice.randrange(256)
                case 1:
                    del data[at : at + dice.randrange(1, 30)]
                case _:
                    data[at:at] = dice.choice(
                        [b"[", b"[9999999]", b"]", b"=1e999", b"\n", b"\xff", b"'", b"/", b"MSG: "]
                    )
        reported = choice_of(msgtype, "cdr", Definition("msg", data.decode("utf-8", "replace")), ())
        if isinstance(reported, str):
            assert reported.startswith(f"the definition of {msgtype} ")
            assert not re.search(r"Error|Traceback|\{|\(\)|Could not parse", reported)

    def test_idl_that_computes_is_refused_before_it_does(self):
        idl = "module my_msgs {{ module msg {{ struct A {{ long a[{}]; }}; }}; }};"
        plain, shift = (
            choice_of("my_msgs/msg/A", "cdr", Definition("idl", idl.format(size)), ())
            for size in ("3", "1 << 99999999999")
        )
        assert not isinstance(plain, str)
        assert "cannot be used" in shift
        commented = "/* 2 * 2 << 1 */ // a << b\n" + idl.format("3")
        assert not isinstance(choice_of("my_msgs/msg/A", "cdr", Definition("idl", commented), ()), str)


class TestMessages:
    @pytest.mark.parametrize("seed", range(40))
    def test_whatever_bytes_of_messages_are_damaged_costs_them(self, tmp_path, seed):
        """Nothing else fails than a channel that lost too much, and that is not allowed to happen here."""
        dice = random.Random(seed)

        def spoil(topic, number, data):
            if topic not in {"/cam/image_raw", "/points"} or number % 3 != 2:
                return data
            data = bytearray(data)
            head = min(len(data), 200)
            for _ in range(dice.choice([1, 2, 10])):
                data[dice.randrange(4, head)] = dice.randrange(256)
            return bytes(data)

        # A topic in several frames is ambiguous, whatever made it so; the recipe can say which one counts.
        text_ = RECIPE.replace("/cam/image_raw", "/cam/image_raw, frame: cam").replace(
            "/points", "/points, frame: lidar"
        )
        recipe = make_project(
            tmp_path, text=text_ + "limits: {{lost_messages: 1.0}}\npreview: {{enabled: false}}\n"
        )
        recipe.bags.root.mkdir()
        write_tiny(recipe.bags.root / "a.mcap", spoil=spoil)
        made = {
            one.asset: one
            for one in build_of(recipe, "a.mcap").build(
                ["inventory", "calibration", "ego_poses", "frames", "sweeps"]
            )
        }
        for asset, channel in (("frames", "CAM_FRONT"), ("sweeps", "LIDAR_TOP")):
            counts = made[asset].artifact.summary()["channels"][channel]
            assert counts["read"] == counts["written"] + counts["merged"] + sum(counts["lost"].values())
            assert counts["written"] >= 7


def spoil_metadata(folder, old, new):
    file = folder / "metadata.yaml"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))


class TestSentences:
    """Good data is read, or called what it is; nobody is advised to delete it."""

    def test_an_empty_serialization_format_is_cdr(self, tmp_path):
        folder = write_drive(tmp_path / "b", "ros2", 0.5)
        spoil_metadata(folder, "serialization_format: cdr", "serialization_format: ''")
        (database,) = folder.glob("*.db3")
        with sqlite3.connect(database) as connection:
            connection.execute("UPDATE topics SET serialization_format = ''")
        for path in (folder, database):
            with open_recording(path) as recording:
                assert recording.decode(next(recording.messages(["/odom"]))).child_frame_id == "base_link"

    def test_another_serialization_costs_its_topic(self, tmp_path):
        folder = write_ros2(tmp_path / "b", [text(NOON_NS)])
        spoil_metadata(folder, "serialization_format: cdr", "serialization_format: cbor")
        with open_recording(folder) as recording:
            assert recording.topics["/text"].problem == "its serialization is 'cbor', not cdr"

    @pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
    @pytest.mark.parametrize("said", ["''", "'my_plugin'"])
    def test_an_empty_or_odd_storage_identifier(self, tmp_path, storage, said):
        folder = write_ros2(tmp_path / "b", [text(NOON_NS)], storage)
        spoil_metadata(folder, f"storage_identifier: {storage.lower()}", f"storage_identifier: {said}")
        with open_recording(folder) as recording:
            assert recording.decode(next(recording.messages(["/text"]))).data == "hello"

    @pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3", "folder"])
    def test_a_pointer_of_git_lfs_is_called_one(self, tmp_path, name):
        pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 123456\n"
        path = file = tmp_path / name
        if name == "folder":
            write_ros2(path, [text(NOON_NS)])
            (file,) = path.glob("*.db3")
        file.write_bytes(pointer)
        with pytest.raises(RecordingError, match=r"Git LFS pointer.*`git lfs pull`") as caught:
            open_recording(path)
        assert str(file) in str(caught.value)

    @pytest.mark.parametrize(
        "err",
        [
            AssertionError(), KeyError("x"), IndexError(), ValueError("{''}"), RuntimeError("('Header could not be read.',)"),
            UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"), MemoryError(), OSError(5, "Input/output error"),
            sqlite3.DatabaseError("file is not a database"), RecursionError("maximum recursion depth exceeded"),
        ],
        ids=lambda err: type(err).__name__,
    )  # fmt: skip
    def test_what_libraries_raise_becomes_a_clause(self, tmp_path, err):
        try:
            reported = str(unreadable(tmp_path / "a.bag", err))
        except DiskError as failing:
            reported = str(failing)
        assert ("check its disk" in reported) == isinstance(err, OSError)
        clause = reported[reported.index("(") + 1 : reported.index(");")]
        assert re.fullmatch(r"[A-Za-z][A-Za-z ,/']+", clause), clause
        assert "delete" not in reported

    @pytest.mark.parametrize("file_format", ["ros1", "ros2", "mcap"])
    @pytest.mark.parametrize("seed", range(25))
    def test_damaged_files_are_reported_in_sentences(self, tmp_path, file_format, seed):
        dice = random.Random(seed)
        path = write_drive(
            tmp_path / {"ros1": "a.bag", "ros2": "b", "mcap": "c.mcap"}[file_format], file_format, 0.3
        )
        file = dice.choice(sorted(path.iterdir())) if path.is_dir() else path
        data = bytearray(file.read_bytes())
        tail = max(1, len(data) - 3000)
        for _ in range(dice.choice([1, 10, 100])):
            data[dice.randrange(tail if seed % 2 else 0, len(data))] = dice.randrange(256)
        file.write_bytes(data)
        try:
            with open_recording(path) as recording:
                list(recording.messages(list(recording.topics)))
        except BagAssetsError as err:
            reported = str(err).replace(str(path), "")
            assert not re.search(r"Error|\{''\}|\(''|err\.args|object|NoneType|0x|delete", reported), reported

    def test_metadata_that_nests_without_end_ends_no_process(self, tmp_path):
        folder = write_ros2(tmp_path / "b", [text(NOON_NS)])
        (folder / "metadata.yaml").write_text("a: " + "[" * 200_000)
        with pytest.raises(RecordingError, match="nested too deeply"):
            open_recording(folder)

    def test_nothing_of_ros1_is_lost_by_reading_names_leniently(self, tmp_path):
        path = write_ros1(tmp_path / "a.bag", [text(NOON_NS, topic="/text")])
        content = path.read_bytes()
        path.write_bytes(content.replace(b"/text", b"/t\xe4xt"))
        with open_recording(path) as recording:
            (topic,) = recording.topics
            assert topic == "/t\N{REPLACEMENT CHARACTER}xt"
            assert recording.decode(next(recording.messages([topic]))).data == "hello"


def test_a_topic_without_a_name_costs_no_other(tmp_path):
    path = write_ros1(tmp_path / "a.bag", [text(NOON_NS, topic=""), text(NOON_NS + 1, topic="/named")])
    with open_recording(path) as recording:
        assert set(recording.topics) == {"", "/named"}
        assert [message.topic for message in recording.messages(["/named"])] == ["/named"]
