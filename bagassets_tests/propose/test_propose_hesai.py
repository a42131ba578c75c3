"""Packets of a Hesai as Autoware's vehicles and Hesai's driver record them: what `init` proposes, and that the proposal builds."""

from dataclasses import replace

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from bagassets.assets.lidar_file import read_lidar_file
from bagassets.propose.proposal import propose_recipe
from bagassets.propose.scan import scan_recording
from bagassets.propose.sensors import find_sensors, metadata_of
from bagassets.recipe import parse_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.recordings.open import open_recording
from bagassets.store.store import Store
from bagassets_tests.hesai_data import LAYOUTS, UNITS_M, corrections, distance, seen, spin
from bagassets_tests.propose.test_propose_odd_robots import LIDAR_FIELDS, cloud
from bagassets_tests.recorded_bags import (
    NOON_NS,
    ROS1,
    ROS2,
    Message,
    header,
    write_mcap,
    write_ros1,
    write_ros2,
)
from bagassets_tests.recording_build import RecordingBuild

pytestmark = pytest.mark.once

MODEL = "XT16"
TOPICS = {"pandar_msgs": "/pandar_packets", "hesai_ros_driver": "/lidar_packets"}
BESIDE = "/lidar_corrections"
NAMES = {"pandar_msgs": ("PandarPacket", "PandarScan", "uint8[1500]"), "hesai_ros_driver": ("UdpPacket", "UdpFrame", "uint8[]")}  # fmt: skip
for _store in (ROS1, ROS2):
    for _package, (_packet, _scan, _data) in NAMES.items():
        _text = f"builtin_interfaces/Time stamp\n{_data} data\nuint32 size\n"
        _store.register(get_types_from_msg(_text, f"{_package}/msg/{_packet}"))
        _store.register(
            get_types_from_msg(f"std_msgs/Header header\n{_packet}[] packets\n", f"{_package}/msg/{_scan}")
        )
WRITERS = {
    "mcap": (ROS2, write_mcap),
    "ros1": (ROS1, write_ros1),
    "sqlite": (ROS2, lambda path, messages: write_ros2(path, messages, version=8)),
}


def recorded(package, *, turns=6, published=False):
    packet_name, scan_name, _ = NAMES[package]
    packets = list(spin(MODEL, turns))
    found = []
    for first in range(0, len(packets), 250):
        part = packets[first : first + 250]

        def make(store, part=part):
            made = []
            for since_ns, data in part:
                own_ns = NOON_NS + since_ns if package == "pandar_msgs" else 0
                whole = data.ljust(1500, b"\0") if package == "pandar_msgs" else data
                values = (header(store, own_ns, "").stamp, np.frombuffer(whole, np.uint8), len(data))
                made.append(store.types[f"{package}/msg/{packet_name}"](*values))
            return store.types[f"{package}/msg/{scan_name}"](
                header(store, NOON_NS + part[0][0], "hesai"), made
            )

        found.append(Message(TOPICS[package], f"{package}/msg/{scan_name}", NOON_NS + part[-1][0], make))
    if published:

        def corrected(store):
            layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
            data = np.frombuffer(corrections(16), np.uint8)
            return store.types["std_msgs/msg/UInt8MultiArray"](layout, data)

        found.insert(1, Message(BESIDE, "std_msgs/msg/UInt8MultiArray", found[1].log_time_ns, corrected))
    return found


def proposed(path):
    with open_recording(path) as recording:
        return propose_recipe({path.name: scan_recording(recording)}, name="hesai", root="bags")


def channels_of(proposal):
    return {name: sensor.topic.name for name, sensor in proposal.rigs[0].channels.items()}


def built(tmp_path, text):
    recipe = parse_recipe(text.replace("# source: fixed", "source: fixed"), tmp_path / "recipe.yaml")
    (recording,) = discover(recipe.bags).recordings.values()
    store = Store(recipe.store_path)
    facts = recording, recording_digest(recording).digest, recording_stat(recording)
    made = {one.asset: one for one in RecordingBuild(recipe, store, *facts).build()}
    return store.artifact(made["sweeps"].channels["LIDAR_TOP"])


def check(sweeps, turns=6):
    rows = sweeps.read_table("index.parquet").to_pylist()
    starts_ns = [NOON_NS + number * 100_000_000 - 344_000 for number in range(turns)]
    assert [abs(row["start_ns"] - one) <= 1_000 for row, one in zip(rows, starts_ns, strict=True)] == [
        True
    ] * turns
    points = read_lidar_file(sweeps.files / rows[2]["file"])
    assert len(points) == LAYOUTS[MODEL].steps() * 8 * 16
    for ring in range(16):
        place = seen(0.0, 15 - ring, 16, distance(15 - ring) * UNITS_M[MODEL])
        np.testing.assert_allclose(points[ring, :3], place, atol=1e-4)


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("package", NAMES)
def test_recorded_packets_are_proposed_and_built(tmp_path, package, kind):
    _, write = WRITERS[kind]
    (tmp_path / "bags").mkdir()
    path = write(tmp_path / "bags" / {"mcap": "a.mcap", "ros1": "a.bag"}.get(kind, "a"), recorded(package))
    proposal = proposed(path)
    assert channels_of(proposal) == {"LIDAR_TOP": TOPICS[package]}
    (question,) = (one for one in proposal.questions if one.subject == "LIDAR_TOP")
    assert question.text == (
        "name the correction file of this Hesai, the CSV with the angles of its channels, which its packets do not say"
    )
    lines = proposal.text.splitlines()
    assert lines[question.line - 1].strip() == "metadata:"
    lines[question.line - 1] += " xt16.csv"
    (tmp_path / "xt16.csv").write_bytes(corrections(16))
    check(built(tmp_path, "\n".join(lines)))


def test_published_corrections_are_found(tmp_path):
    (tmp_path / "bags").mkdir()
    proposal = proposed(
        write_mcap(tmp_path / "bags" / "a.mcap", recorded("hesai_ros_driver", published=True))
    )
    uses = {use.topic.name: (use.status, use.text) for use in proposal.rigs[0].topic_uses}
    assert uses[BESIDE] == ("used", "metadata of LIDAR_TOP")
    assert not [question for question in proposal.questions if "LIDAR" in question.subject]
    check(built(tmp_path, proposal.text))


def test_corrections_beside_the_packets_of_two_lidars_are_of_neither(tmp_path):
    """They are of one of them, and would turn the other one's channels by tenths of a degree without a word."""
    first = recorded("hesai_ros_driver", published=True)
    topic = TOPICS["hesai_ros_driver"]
    second = [replace(one, topic=f"{topic}_rear") for one in first if one.topic == topic]
    for messages, found in ((first, BESIDE), ([*first, *second], None)):
        with open_recording(write_mcap(tmp_path / f"{len(messages)}.mcap", messages)) as recording:
            summary = scan_recording(recording)
        assert metadata_of(summary.topics[topic], summary) == found


def test_where_clouds_were_recorded_these_are_proposed(tmp_path):
    points = [
        one
        for number in range(6)
        for one in [cloud("/pandar_points", "hesai", LIDAR_FIELDS)]
        for one.log_time_ns in [NOON_NS + number * 100_000_000]
    ]
    proposal = proposed(write_mcap(tmp_path / "a.mcap", [*recorded("pandar_msgs"), *points]))
    assert channels_of(proposal) == {"LIDAR_TOP": "/pandar_points"}
    (use,) = (use for use in proposal.rigs[0].topic_uses if use.topic.name == "/pandar_packets")
    assert (use.status, use.text) == ("left out", "the same sensor as /pandar_points")


def test_packets_of_a_model_that_is_not_read_are_said_to_be_none(tmp_path):
    odd = recorded("pandar_msgs", turns=1)

    def spoiled(make):
        def of(store):
            scan = make(store)
            for one in scan.packets:
                one.data = one.data.copy()
                one.data[6] = 77  # channels
            return scan

        return of

    for one in odd:
        one.make = spoiled(one.make)
    with open_recording(write_mcap(tmp_path / "a.mcap", odd)) as recording:
        sensors, (use,) = find_sensors(scan_recording(recording))
    assert not sensors
    assert use.status == "not decodable"
    assert use.text.startswith(
        "no decoder for its packets, which are of no Velodyne, nor of a Hesai of a known model; record what its driver publishes"
    )
