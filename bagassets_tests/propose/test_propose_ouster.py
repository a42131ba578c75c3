"""Packets of an Ouster as its driver records them: what `init` proposes, and that the proposal builds."""

from dataclasses import replace

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from bagassets.assets.lidar_file import read_lidar_file
from bagassets.propose.proposal import propose_recipe
from bagassets.propose.scan import scan_recording
from bagassets.recipe import parse_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.recordings.open import open_recording
from bagassets.store.store import Store
from bagassets_tests.ouster_data import COLUMN_NS, COLUMNS, PER_PACKET, TURN_NS, metadata, packet, seen
from bagassets_tests.propose.test_propose_odd_robots import LIDAR_FIELDS, cloud
from bagassets_tests.recorded_bags import (
    NOON_NS,
    ROS1,
    ROS2,
    Message,
    header,
    text,
    write_mcap,
    write_ros1,
    write_ros2,
)
from bagassets_tests.recording_build import RecordingBuild

pytestmark = pytest.mark.once

LIDAR, IMU, METADATA = "/ouster/lidar_packets", "/ouster/imu_packets", "/ouster/metadata"
TYPES = {ROS1: "ouster_ros/msg/PacketMsg", ROS2: "ouster_sensor_msgs/msg/PacketMsg"}
for _store, _name in TYPES.items():
    _store.register(get_types_from_msg("uint8[] buf", _name))
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
WRITERS = {
    "mcap": (ROS2, write_mcap),
    "ros1": (ROS1, write_ros1),
    "sqlite": (ROS2, lambda path, messages: write_ros2(path, messages, version=8)),
}


def packets(store, topic, data, log_time_ns):
    def make(_store):
        return _store.types[TYPES[store]](np.frombuffer(data, np.uint8))

    return Message(topic, TYPES[store], log_time_ns, make)


def channels_of(proposal):
    return {name: sensor.topic.name for name, sensor in proposal.rigs[0].channels.items()}


def words_of(proposal):
    return " ".join(proposal.text.replace("#", "").split())


def static(*children):
    def make(store):
        kind = store.types["geometry_msgs/msg/TransformStamped"]
        vector = store.types["geometry_msgs/msg/Vector3"](1.0, 0.0, 2.0)
        turn = store.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 1.0, 0.0)
        moved = store.types["geometry_msgs/msg/Transform"](vector, turn)
        return store.types["tf2_msgs/msg/TFMessage"](
            [kind(header(store, NOON_NS, "base_link"), child, moved) for child in children]
        )

    return Message("/tf_static", "tf2_msgs/msg/TFMessage", NOON_NS, make)


def recorded(store, *, turns=15, described=True):
    """What the driver's launch file for recording records: the metadata is latched, and its turn comes when it comes."""
    found = []
    for first in range(0, turns * COLUMNS, PER_PACKET):
        log_time_ns = NOON_NS + (first + PER_PACKET - 1) * COLUMN_NS
        found.append(packets(store, LIDAR, packet(first), log_time_ns))
        if first % COLUMNS == 0:
            found.append(packets(store, IMU, bytes(48), log_time_ns))
    if described:
        found.insert(20, text(found[19].log_time_ns, metadata().decode(), METADATA))
    return found


def proposed(path):
    with open_recording(path) as recording:
        return propose_recipe({path.name: scan_recording(recording)}, name="ouster", root="bags")


@pytest.mark.parametrize("kind", WRITERS)
def test_a_recording_of_the_driver_is_proposed_and_built(tmp_path, kind):
    store, write = WRITERS[kind]
    (tmp_path / "bags").mkdir()
    path = write(
        tmp_path / "bags" / {"mcap": "a.mcap", "ros1": "a.bag"}.get(kind, "a"),
        [static("os_lidar"), *recorded(store)],
    )
    proposal = proposed(path)
    assert channels_of(proposal) == {"LIDAR_TOP": LIDAR}
    uses = {use.topic.name: (use.status, use.text) for use in proposal.rigs[0].topic_uses}
    assert uses[METADATA] == ("used", "metadata of LIDAR_TOP")
    assert uses[IMU] == ("not needed", "")
    assert "clock: log  # guess: header stamps of /ouster/lidar_packets are missing" in proposal.text
    assert "frame: os_lidar  # guess: of Ouster's driver, as packets name none" in proposal.text
    assert not [question for question in proposal.questions if "LIDAR" in question.text]
    recipe = parse_recipe(proposal.text.replace("# source: fixed", "source: fixed"), tmp_path / "recipe.yaml")
    (recording,) = discover(recipe.bags).recordings.values()
    store = Store(recipe.store_path)
    facts = recording, recording_digest(recording).digest, recording_stat(recording)
    made = {one.asset: one for one in RecordingBuild(recipe, store, *facts).build()}
    sweeps = store.artifact(made["sweeps"].channels["LIDAR_TOP"])
    rows = sweeps.read_table("index.parquet").to_pylist()
    assert [row["start_ns"] for row in rows] == [NOON_NS + number * TURN_NS for number in range(15)]
    points = read_lidar_file(sweeps.files / rows[3]["file"])
    for index, point in enumerate(points):
        np.testing.assert_allclose(point[:3], seen(index // 4, 3 - index % 4), atol=1e-6)


def test_without_metadata_it_says_what_to_do(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", [static("os_lidar"), *recorded(ROS2, described=False)])
    proposal = proposed(path)
    assert channels_of(proposal) == {"LIDAR_TOP": LIDAR}
    (question,) = (one for one in proposal.questions if one.subject == "LIDAR_TOP")
    assert question.text.startswith(
        "the recording has no topic `metadata` beside the packets; record it, too, and remove this field, or name a file"
    )
    lines = proposal.text.splitlines()
    assert lines[question.line - 1].strip() == "metadata:"
    lines[question.line - 1] += " os.json"
    (tmp_path / "os.json").write_bytes(metadata())
    recipe = parse_recipe(
        "\n".join(lines).replace("# source: fixed", "source: fixed"), tmp_path / "recipe.yaml"
    )
    assert recipe.rigs[0].channels["LIDAR_TOP"].metadata == tmp_path / "os.json"


def test_where_its_clouds_were_recorded_these_are_proposed(tmp_path):
    points = [
        one
        for number in range(15)
        for one in [cloud("/ouster/points", "os_lidar", LIDAR_FIELDS)]
        for one.log_time_ns in [NOON_NS + number * TURN_NS]
    ]
    proposal = proposed(write_mcap(tmp_path / "a.mcap", [*recorded(ROS2), *points]))
    assert channels_of(proposal) == {"LIDAR_TOP": "/ouster/points"}
    (use,) = (use for use in proposal.rigs[0].topic_uses if use.topic.name == LIDAR)
    assert (use.status, use.text) == ("left out", "the same sensor as /ouster/points")


def test_without_tf_it_is_asked_where_the_lidar_is_and_said_that_it_is_turned(tmp_path):
    proposal = proposed(write_mcap(tmp_path / "a.mcap", recorded(ROS2)))
    assert "this one has its plug at the back, where x of os_lidar points to" in words_of(proposal)
    assert "# rotation: [0, 0, 0, 1]" in proposal.text


def test_where_the_robot_moves_its_points_may_be_deskewed(tmp_path):
    def pose(log_time_ns):
        def make(store):
            kinds = (
                store.types[f"geometry_msgs/msg/{name}"]
                for name in ("Point", "Quaternion", "Pose", "PoseStamped")
            )
            position, rotation, pose, stamped = kinds
            moved = pose(position(0.0, 0.0, 0.0), rotation(0.0, 0.0, 0.0, 1.0))
            return stamped(header(store, log_time_ns, "map"), moved)

        return Message("/pose", "geometry_msgs/msg/PoseStamped", log_time_ns, make)

    poses = [pose(NOON_NS + number * TURN_NS) for number in range(15)]
    proposal = proposed(write_mcap(tmp_path / "a.mcap", [*recorded(ROS2), *poses]))
    assert "# deskew: true" in proposal.text


@pytest.mark.parametrize(
    ("frames", "given"),
    [
        (["front/os_lidar", "rear/os_lidar"], {"LIDAR_TOP": "front/os_lidar", "LIDAR_BACK": "rear/os_lidar"}),
        (["os_lidar_rear", "os_lidar"], {"LIDAR_BACK": "os_lidar_rear"}),
        (["os_lidar"], {}),
        (["left/os_lidar", "right/os_lidar"], {}),
    ],
)
def test_each_of_two_lidars_gets_its_own_frame_or_is_asked_for_it(tmp_path, frames, given):
    two = [
        replace(one, topic=f"/{place}{one.topic}") for one in recorded(ROS2) for place in ("front", "rear")
    ]
    proposal = proposed(write_mcap(tmp_path / "a.mcap", [static(*frames), *two]))
    assert set(channels_of(proposal)) == {"LIDAR_TOP", "LIDAR_BACK"}
    asked = {one.subject for one in proposal.questions if "give `frame`" in one.text}
    assert asked == channels_of(proposal).keys() - given.keys()
    channels = proposal.text.split("LIDAR_BACK:")
    for name, lines in zip(("LIDAR_TOP", "LIDAR_BACK"), channels, strict=True):
        found = [
            line.split()[1]
            for line in lines.splitlines()
            if line.strip().startswith("frame:") and "os_lidar" in line
        ]
        assert found == ([given[name]] if name in given else [])


def test_beside_sensors_with_stamps_it_alone_goes_by_the_log(tmp_path):
    def image(log_time_ns):
        def make(store):
            head = header(store, log_time_ns - 10_000_000, "cam")
            return store.types["sensor_msgs/msg/Image"](head, 8, 8, "rgb8", 0, 24, np.zeros(192, np.uint8))

        return Message("/cam/image_raw", "sensor_msgs/msg/Image", log_time_ns, make)

    images = [image(NOON_NS + number * TURN_NS) for number in range(15)]
    proposal = proposed(write_mcap(tmp_path / "a.mcap", [*recorded(ROS2), *images]))
    assert "clock: header" in proposal.text
    assert (
        "guess: its packets have no stamps; `header` takes the times of the lidar, if PTP keeps them near the host's clock: log"
        in words_of(proposal)
    )
