import struct
import subprocess
import sys

import pyarrow as pa
import pytest
from blake3 import blake3

from bagassets.assets.inventory import make_inventory
from bagassets.base.errors import RecordingError
from bagassets.geometry.sun import sun_elevation_deg
from bagassets.recordings import pack as pack_module
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.layouts import choice_of
from bagassets.recordings.model import Definition, RawMessage
from bagassets.recordings.open import open_recording
from bagassets.recordings.pack import PACK_FILE, PACK_SCHEMA, Pack, PackedRecording, write_pack
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets_tests.recorded_bags import (
    NOON_NS,
    ROS1,
    ROS2,
    SECOND,
    fix,
    image,
    point,
    text,
    write_mcap,
    write_ros1,
    write_ros2,
)

MUNICH = (48.1, 11.6)


@pytest.fixture
def inventory_of(tmp_path):
    """Return path -> (content of inventory.json, path of the pack, summary)."""
    made = []

    def make(path, message_definitions=()):
        folder = tmp_path / f"artifact{len(made)}"
        made.append(folder)
        out = ArtifactWriter(folder)
        with open_recording(path, message_definitions) as recording:
            summary = make_inventory(recording, out, size=1000)
        artifact = Artifact(out.finish(summary), folder)
        return artifact.read_json("inventory.json"), artifact.path("messages.parquet"), summary

    return make


def topic_of(value, name):
    return next(topic for topic in value["topics"] if topic["name"] == name)


def mixed(number=30):
    """Messages of several topics, some at the same log time."""
    messages = []
    for i in range(number):
        at = NOON_NS + i * SECOND // 10
        messages += [point(at, at - 5_000_000, x=float(i)), text(at, f"text {i}"), image(at + 1, 100 + i)]
    return messages


def test_the_truth_of_a_topic(tmp_path, inventory_of):
    stamps = [0, 1, 2, 3, 13, 14, 15]
    messages = [point(NOON_NS + s * SECOND, NOON_NS + s * SECOND - 10**8 * (k + 1), frame="/map" if k else "odom")
                for k, s in enumerate(stamps)]  # fmt: skip
    value, _, summary = inventory_of(write_ros1(tmp_path / "a.bag", messages))
    topic = topic_of(value, "/point")
    payloads = [bytes(ROS1.serialize_ros1(m.make(ROS1), m.msgtype)) for m in messages]
    hasher = blake3(b"geometry_msgs/msg/PointStamped\0")
    for m, payload in zip(messages, payloads, strict=True):
        hasher.update(struct.pack("<qQ", m.log_time_ns, len(payload)) + payload)
    assert Inventory.from_json(value).topic("/point").count == 7
    definition = Definition(**topic.pop("definition"))
    assert definition.format == "msg"
    layout_digest = choice_of("geometry_msgs/msg/PointStamped", "ros1", definition, ()).best.digest
    assert topic == {
        "name": "/point", "type": "geometry_msgs/msg/PointStamped", "count": 7,
        "bytes": sum(map(len, payloads)), "digest": blake3(hasher.digest() + layout_digest.encode()).hexdigest(),
        "first_ns": NOON_NS, "last_ns": NOON_NS + 15 * SECOND,
        "first_stamp_ns": NOON_NS - SECOND // 10, "last_stamp_ns": NOON_NS + 15 * SECOND - 7 * SECOND // 10,
        "rate_hz": 0.4, "max_gap_s": 10.0, "gaps": [{"start_ns": NOON_NS + 3 * SECOND, "duration_s": 10.0}],
        "gap_count": 1, "header_offset_s": {"min": 0.1, "median": 0.4, "max": 0.7}, "unordered_stamps": 0, "first_unordered_ns": None, "period_ns": 900_000_000,
        "frame_ids": ["odom", "map"], "packed": True, "problem": None, "serialization": "ros1",
    }  # fmt: skip
    assert (value["start_ns"], value["end_ns"], value["duration_s"]) == (NOON_NS, NOON_NS + 15 * SECOND, 15.0)
    assert (value["format"], value["size"], value["gnss"], value["daylight"]) == ("ros1", 1000, None, None)
    assert summary == {"messages": 7, "topics": 1, "duration_s": 15.0, "unreadable_topics": "none"}


def test_the_period_of_a_topic_is_that_of_its_stamps_whatever_their_order(tmp_path, inventory_of):
    def period(*stamps_s):
        messages = [point(NOON_NS + n * SECOND, round(s * SECOND)) for n, s in enumerate(stamps_s)]
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        folder.mkdir()
        return topic_of(inventory_of(write_ros1(folder / "a.bag", messages))[0], "/point")["period_ns"]

    assert period(10, 10.5, 11, 11.5) == SECOND // 2
    assert period(11, 10, 11.5, 10.5) == SECOND // 2
    # Stamps that were never set say nothing; without any, the log times tell.
    assert period(0, 3, 3.5, 0, 4) == SECOND // 2
    assert period(0, 7, 8) == SECOND
    assert period(0, 0, 0) == SECOND
    assert period(5) is None


def test_compression_and_container_change_no_topic(tmp_path, inventory_of):
    messages = mixed()
    topics = [
        inventory_of(write_ros1(tmp_path / f"{compression}.bag", messages, compression))[0]["topics"]
        for compression in (None, "LZ4", "BZ2")
    ]
    assert topics[0] == topics[1] == topics[2]
    cdr = [
        inventory_of(write_ros2(tmp_path / "db3", messages))[0]["topics"],
        inventory_of(write_ros2(tmp_path / "folder", messages, "MCAP"))[0]["topics"],
        inventory_of(write_mcap(tmp_path / "a.mcap", messages))[0]["topics"],
    ]
    digests = [[(topic["name"], topic["count"], topic["digest"]) for topic in topics] for topics in cdr]
    assert digests[0] == digests[1] == digests[2]
    assert digests[0] != [(topic["name"], topic["count"], topic["digest"]) for topic in topics[0]]


@pytest.mark.parametrize(
    "other",
    [
        [text(NOON_NS, "hellp")],
        [text(NOON_NS + 1, "hello")],
        [text(NOON_NS, "hello"), text(NOON_NS, "hello")],
        [],
    ],
)
def test_a_topic_digest_names_content(tmp_path, inventory_of, other):
    anchor = point(NOON_NS)
    one, _, _ = inventory_of(write_ros1(tmp_path / "one.bag", [anchor, text(NOON_NS, "hello")]))
    two, _, _ = inventory_of(write_ros1(tmp_path / "two.bag", [anchor, *other]))
    assert topic_of(one, "/point") == topic_of(two, "/point")
    assert [t for t in two["topics"] if t["digest"] == topic_of(one, "/text")["digest"]] == []


def packed_of(value, parquet):
    return PackedRecording(Inventory.from_json(value), Pack(parquet))


def test_packing(tmp_path, inventory_of):
    big = "x" * (64 * 1024 + 1)
    messages = [image(NOON_NS), text(NOON_NS, big, "/big"), text(NOON_NS, "small", "/late"),
                text(NOON_NS + 1, big, "/late"), text(NOON_NS + 2, "small", "/small")]  # fmt: skip
    value, parquet, _ = inventory_of(write_ros2(tmp_path / "bag", messages))
    packed = {topic["name"]: topic["packed"] for topic in value["topics"]}
    assert packed == {"/camera": False, "/big": False, "/late": True, "/small": True}
    with packed_of(value, parquet) as recording:
        assert set(recording.topics) == {"/late", "/small"}
        with pytest.raises(KeyError, match="/camera"):
            recording.messages(["/camera"])


@pytest.mark.parametrize("write", [write_ros1, write_ros2, write_mcap])
def test_the_pack_reads_like_the_recording(tmp_path, inventory_of, write):
    path = write(tmp_path / ("a.mcap" if write is write_mcap else "a.bag"), mixed())
    value, parquet, _ = inventory_of(path)
    topics = ["/point", "/text"]
    with open_recording(path) as bag, packed_of(value, parquet) as pack:
        assert pack.format == bag.format
        direct, packed = list(bag.messages(topics)), list(pack.messages(topics))
        assert [(m.topic, m.msgtype, m.log_time_ns, bytes(m.data)) for m in packed] == [
            (m.topic, m.msgtype, m.log_time_ns, bytes(m.data)) for m in direct
        ]
        assert [m.topic for m in pack.restrict(["/text"]).messages(["/text"])] == ["/text"] * 30
        for a, b in zip(direct, packed, strict=True):
            assert bag.decode(a).__dict__ == pack.decode(b).__dict__ or repr(bag.decode(a)) == repr(
                pack.decode(b)
            )
            assert bag.topics[a.topic].header(a.data) == pack.topics[b.topic].header(b.data)


@pytest.mark.parametrize("is_small", [True, False])
def test_a_small_pack_is_read_once(tmp_path, inventory_of, monkeypatch, is_small):
    value, parquet, _ = inventory_of(write_ros1(tmp_path / "a.bag", mixed()))
    pack = Pack(parquet)
    monkeypatch.setattr(pack_module, "_KEPT_BYTES", 1 << 20 if is_small else 0)
    first, again = (PackedRecording(Inventory.from_json(value), pack) for _ in range(2))
    messages = list(first.messages(["/text"]))
    parquet.unlink()
    if is_small:
        assert list(again.messages(["/text"])) == messages != []
    else:
        with pytest.raises(RecordingError):
            list(again.messages(["/text"]))


def test_types_from_message_files_are_packed_with_their_definition(tmp_path, inventory_of):
    folder = tmp_path / "messages" / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Speed.msg").write_text("std_msgs/Header header\nfloat64 value\n")
    payload = b"\0\1\0\0" + struct.pack("<iII", 7, 5, 1) + b"\0" + b"\0" * 3 + struct.pack("<d", 1.5)
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        from mcap.writer import Writer

        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("my_msgs/msg/Speed", "ros2msg", b"")
        channel = writer.register_channel("/speed", "cdr", schema)
        writer.add_message(channel, NOON_NS, payload, NOON_NS)
        writer.finish()
    without, _, summary = inventory_of(path)
    assert "bags.message_definitions" in topic_of(without, "/speed")["problem"]
    assert summary["unreadable_topics"] == "/speed"
    value, parquet, _ = inventory_of(path, [tmp_path / "messages"])
    topic = topic_of(value, "/speed")
    assert topic["digest"] != topic_of(without, "/speed")["digest"]
    assert topic["first_stamp_ns"] == 7 * SECOND + 5
    with packed_of(value, parquet) as pack:
        (message,) = pack.messages(["/speed"])
        assert pack.decode(message).value == 1.5


def test_topics_that_cannot_be_decoded_count_all_the_same(tmp_path, inventory_of):
    foreign = [("/cbor", NOON_NS + i, "cbor", b'{"speed": 1}') for i in range(3)] + [
        ("/empty", NOON_NS, "cdr", b"")
    ]
    value, _, _ = inventory_of(write_mcap(tmp_path / "a.mcap", [text(NOON_NS)], foreign=foreign))
    topic = topic_of(value, "/cbor")
    assert (topic["count"], topic["bytes"], topic["header_offset_s"]) == (3, 36, None)
    assert "cbor" in topic["problem"]
    assert topic["digest"] != topic_of(value, "/empty")["digest"]
    assert any(note.startswith("/cbor cannot be decoded") for note in value["notes"])


def test_payloads_too_short_for_a_header(tmp_path, inventory_of):
    path = tmp_path / "a.mcap"
    definition, _ = ROS2.generate_msgdef("geometry_msgs/msg/PointStamped", ros_version=2)
    with path.open("wb") as file:
        from mcap.writer import Writer

        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("geometry_msgs/msg/PointStamped", "ros2msg", definition.encode())
        channel = writer.register_channel("/point", "cdr", schema)
        for payload in (b"", b"\0", b"\0\1\0\0\1"):
            writer.add_message(channel, NOON_NS, payload, NOON_NS)
        writer.finish()
    topic = topic_of(inventory_of(path)[0], "/point")
    assert (topic["count"], topic["header_offset_s"], topic["rate_hz"]) == (3, None, None)


def test_gnss(tmp_path, inventory_of):
    messages = [
        fix(NOON_NS, 0.0, 0.0, status=-1),
        fix(NOON_NS + SECOND, *MUNICH, stamp_ns=NOON_NS + 5),
        fix(NOON_NS + 2 * SECOND, 48.2, 11.7, alt=float("nan")),
        fix(NOON_NS + 3 * SECOND, float("nan"), 11.7),
    ]
    value, _, _ = inventory_of(write_ros1(tmp_path / "a.bag", messages))
    assert value["gnss"] == {
        "first": {"lat": 48.1, "lon": 11.6, "alt": 500.0, "stamp_ns": NOON_NS + 5},
        "last": {"lat": 48.2, "lon": 11.7, "alt": None, "stamp_ns": NOON_NS + 2 * SECOND},
    }
    assert value["daylight"] == "day"


def drive_of_fixes(astray=(), off_deg=4.6, number=20, start_ns=NOON_NS):
    """A drive to the north at 11 m/s with fixes each second, of which some are moved."""
    return [
        fix(start_ns + n * SECOND, 48.1 + 1e-4 * n + off_deg * (n in astray), 11.6) for n in range(number)
    ]


@pytest.mark.parametrize("astray", [{0}, {0, 1}, {19}, {0, 7, 19}], ids=["first", "two", "last", "several"])
def test_stray_fixes_tell_no_place(tmp_path, inventory_of, astray):
    # At 89.9 degrees, where the first fix seems to be, the sun never sets in June.
    messages = drive_of_fixes(astray, off_deg=41.799, start_ns=NOON_NS + 12 * 3600 * SECOND)
    value, _, _ = inventory_of(write_ros1(tmp_path / "a.bag", messages))
    good = [n for n in range(20) if n not in astray]
    assert value["gnss"]["first"]["lat"] == 48.1 + 1e-4 * good[0]
    assert value["gnss"]["last"]["lat"] == 48.1 + 1e-4 * good[-1]
    assert value["daylight"] == "night"
    amount = "1 of 20 fixes is" if len(astray) == 1 else f"{len(astray)} of 20 fixes are"
    assert f"/fix: {amount} out of reach from the others, which tell place and daylight." in value["notes"]


@pytest.mark.parametrize(
    "messages",
    [
        drive_of_fixes(),
        drive_of_fixes({0}, number=2),  # nobody knows which of the two it is
        drive_of_fixes(range(10), off_deg=1e-3),  # a jump of 111 m, as between houses
        # Two receivers at once, one of which gives heights above the sea.
        [m for n in range(20) for m in (*drive_of_fixes()[n : n + 1],
         fix(NOON_NS + n * SECOND, 48.1 + 1e-4 * n, 11.6, alt=453.0, topic="/other"))],
    ],
    ids=["clean", "two fixes", "between houses", "two receivers"],
)  # fmt: skip
def test_genuine_fixes_tell_the_place(tmp_path, inventory_of, messages):
    value, _, _ = inventory_of(write_ros1(tmp_path / "a.bag", messages))
    assert value["gnss"]["first"]["lat"] == messages[0].make(ROS1).latitude
    assert value["gnss"]["last"]["lat"] == messages[-1].make(ROS1).latitude
    assert value["notes"] == []


def test_a_clock_that_was_set_while_recording_is_noted(tmp_path, inventory_of):
    day_s = 86400
    messages = [text(n * SECOND, topic="/a") for n in range(1, 4)]
    messages += [text(10 * SECOND, topic="/b")]
    messages += [text((10 + 19_000 * day_s + n) * SECOND, topic="/a") for n in range(3)]
    value, _, _ = inventory_of(write_ros1(tmp_path / "a.bag", messages))
    (note,) = value["notes"]
    assert note == (
        "Log times jump by 19000.0 days after 1970-01-01T00:00:10.000Z (10000000000): the clock was set while recording, "
        "or the recorder paused, so duration and rates are not those of the drive."
    )


@pytest.mark.parametrize("pause_s", [60, 86_400])
def test_a_pause_is_no_clock_that_was_set(tmp_path, inventory_of, pause_s):
    messages = [text(NOON_NS), text(NOON_NS + pause_s * SECOND), text(NOON_NS + 2 * pause_s * SECOND)]
    assert inventory_of(write_ros1(tmp_path / "a.bag", messages))[0]["notes"] == []


@pytest.mark.parametrize(
    ("hours", "expected"),
    # Munich at the solstice of 2024: sunset 19:17 UTC (with refraction; the sun's centre is at 0 degrees
    # some seven minutes earlier), end of civil twilight 19:58 UTC.
    [(0, "day"), (7.1, "day"), (7.5, "twilight"), (7.85, "twilight"), (8.1, "night"), (11.2, "night")],
)
def test_daylight(tmp_path, inventory_of, hours, expected):
    stamp = NOON_NS + int(hours * 3600) * SECOND
    assert inventory_of(write_ros1(tmp_path / "a.bag", [fix(stamp, *MUNICH)]))[0]["daylight"] == expected


def test_simulated_time_gives_no_daylight(tmp_path, inventory_of):
    value, _, _ = inventory_of(write_ros1(tmp_path / "a.bag", [fix(NOON_NS, *MUNICH, stamp_ns=12 * SECOND)]))
    assert value["gnss"] is not None
    assert value["daylight"] is None


def test_the_sun_stands_overhead_at_the_tropic():
    # At the June solstice the sun culminates at 23.4 degrees north, near 12:02 UTC in Greenwich.
    assert sun_elevation_deg(23.43, 0.0, NOON_NS + 120 * SECOND) > 89.0
    assert sun_elevation_deg(-66.0 - 23.43, 0.0, NOON_NS) < 0.7


def test_notes(tmp_path, inventory_of):
    messages = [
        point(NOON_NS, 0, topic="/unset"),
        point(NOON_NS, NOON_NS + 60 * SECOND, topic="/ahead"),
        point(NOON_NS, NOON_NS, topic="/back"),
        point(NOON_NS + 1, NOON_NS - 1, topic="/back"),
    ]
    value, _, _ = inventory_of(write_ros1(tmp_path / "a.bag", messages))
    assert value["notes"] == [
        "/back: 1 header stamp goes back in time.",
        "Header stamps are all zero on /unset: only the log time tells when.",
        "Log times are far from header stamps on /ahead (-60.0 s): choose the clock in the recipe with care.",
    ]


def test_an_empty_recording(tmp_path, inventory_of):
    value, parquet, summary = inventory_of(write_mcap(tmp_path / "a.mcap", []))
    assert (value["start_ns"], value["end_ns"], value["duration_s"], value["topics"]) == (None, None, 0.0, [])
    assert summary["messages"] == 0
    with packed_of(value, parquet) as pack:
        assert list(pack.messages([])) == []


def test_the_inventory_is_the_same_every_time(tmp_path, inventory_of):
    path = write_ros2(tmp_path / "bag", mixed())
    one, two = inventory_of(path), inventory_of(path)
    assert one[0] == two[0]
    assert one[1].read_bytes() == two[1].read_bytes()


@pytest.mark.parametrize("number", [0, 9])
def test_a_pack_is_the_table_that_pyarrow_makes(tmp_path, number):
    messages = [RawMessage(f"/ä{'ö' * n}", "x", (n - 4) * 10**18, bytes(range(n))) for n in range(number)]
    rows = [{"topic": m.topic, "log_time_ns": m.log_time_ns, "data": m.data} for m in messages]
    out = ArtifactWriter(tmp_path)
    write_pack(out, messages)
    out.write_table("plain.parquet", pa.Table.from_pylist(rows, PACK_SCHEMA))
    packed, plain = (tmp_path / "files" / name for name in (PACK_FILE, "plain.parquet"))
    assert packed.read_bytes() == plain.read_bytes()


def test_pandas_is_not_imported_for_a_pack(tmp_path):
    pytest.importorskip("pandas")
    script = """
import sys
from pathlib import Path
from bagassets.recordings.model import RawMessage
from bagassets.recordings.pack import write_pack
from bagassets.store.artifact import ArtifactWriter

write_pack(ArtifactWriter(Path(sys.argv[1])), [RawMessage("/topic", "x", 1, b"data")])
print("pandas" in sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", script, tmp_path], capture_output=True, text=True, check=True
    )
    assert done.stdout == "False\n"
