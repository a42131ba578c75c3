"""OxTS NCOM: packets field by field, their time, and ego poses made of them."""

import math
from types import SimpleNamespace as Msg

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import get_types_from_msg

from bagassets.assets.ego_poses import load_trajectory
from bagassets.assets.inventory import make_inventory
from bagassets.base.errors import DecodeError, LossLimitError, PoseError
from bagassets.decode.ncom import decode_ncom
from bagassets.decode.packets import payload, sender
from bagassets.geometry.euler import quaternions_from_rpy
from bagassets.geometry.se3 import SE3
from bagassets.geometry.wgs84 import LocalFrame
from bagassets.propose.scan import scan_recording
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Limits
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.model import RecordingFiles
from bagassets.recordings.open import open_recording
from bagassets.store.store import Store
from bagassets_tests import recorded_bags
from bagassets_tests.ncom_data import (
    ETHERNET,
    GPS_EPOCH_S,
    UDP,
    ethernet,
    ncom,
    status_offset,
    status_time,
    udp,
)
from bagassets_tests.pose_data import T0, S, Written
from bagassets_tests.posed import BETWEEN, ORIGIN, TIMES, Posed, at, static, truth
from bagassets_tests.recorded_bags import write_mcap, write_ros1, write_ros2
from bagassets_tests.recording_build import RecordingBuild

DEFINITION = (
    "std_msgs/Header header\nuint8[4] sender_ip\nuint16 sender_port\nuint8[4] receiver_ip\n"
    "uint16 receiver_port\nuint8[] payload\n"
)
RECIPE = """
name: ncom
bags: {root: bags, settle_s: 0}
rigs:
  - name: car
    ego_pose: {source: ncom, topic: /ncom, sender: 10.1.1.20}
    channels:
      CAM_FRONT: {modality: camera, topic: /camera, undistort: false}
"""
angles = st.floats(-math.pi, math.pi)


class TestPackets:
    """One packet of 72 bytes."""

    @given(
        st.floats(-90, 90), st.floats(-180, 180), st.floats(-500, 9000, width=32),
        angles, st.floats(-1.5, 1.5), angles, st.integers(0, 59_999),
    )  # fmt: skip
    def test_every_field_comes_back(self, lat, lon, alt, heading, pitch, roll, ms):
        reading = decode_ncom(ncom(ms, lat, lon, alt, heading=heading, pitch=pitch, roll=roll))
        pose = reading.pose
        assert (pose.lat_deg, pose.lon_deg, pose.alt_m) == pytest.approx(
            (lat, lon, alt), abs=1e-13, rel=1e-15
        )
        assert (pose.heading_rad, pose.pitch_rad, pose.roll_rad) == pytest.approx(
            (heading, pitch, roll), abs=6e-7
        )
        assert reading.minute_ms == ms
        assert (reading.gps_minute, reading.utc_offset_s) == (None, None)

    @pytest.mark.parametrize(
        ("heading_deg", "pitch_deg", "roll_deg", "forward", "left", "up"),
        [
            (0, 0, 0, (0, 1, 0), (-1, 0, 0), (0, 0, 1)),  # north: forward is +y
            (90, 0, 0, (1, 0, 0), (0, 1, 0), (0, 0, 1)),  # east
            (0, 90, 0, (0, 0, 1), (-1, 0, 0), (0, -1, 0)),  # nose up
            (90, 0, 90, (1, 0, 0), (0, 0, 1), (0, -1, 0)),  # right side down
        ],
    )
    def test_axes(self, heading_deg, pitch_deg, roll_deg, forward, left, up):
        """From north, east, down with axes forward, right, down to east, north, up with forward, left, up."""
        heading, pitch, roll = (math.radians(v) for v in (heading_deg, pitch_deg, roll_deg))
        pose = decode_ncom(ncom(heading=heading, pitch=pitch, roll=roll)).pose
        rotation = SE3.create(quaternions_from_rpy(np.array(pose.enu_rpy_rad)), (0, 0, 0)).rotation_matrix
        np.testing.assert_allclose(rotation, np.array([forward, left, up]).T, atol=2e-6)

    @given(angles, st.floats(-1.5, 1.5), angles)
    def test_any_attitude_by_matrices(self, heading, pitch, roll):
        def about(axis, angle):
            c, s = math.cos(angle), math.sin(angle)
            i, j = (axis + 1) % 3, (axis + 2) % 3
            matrix = np.eye(3)
            matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
            return matrix

        ned_R_frd = about(2, heading) @ about(1, pitch) @ about(0, roll)
        enu_R_ned = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
        truth_matrix = enu_R_ned @ ned_R_frd @ np.diag([1, -1, -1])
        pose = decode_ncom(ncom(heading=heading, pitch=pitch, roll=roll)).pose
        rotation = SE3.create(quaternions_from_rpy(np.array(pose.enu_rpy_rad)), (0, 0, 0)).rotation_matrix
        np.testing.assert_allclose(rotation, truth_matrix, atol=3e-6)

    def test_status_channels(self):
        assert decode_ncom(ncom(channel=status_time(23_000_000))).gps_minute == 23_000_000
        assert decode_ncom(ncom(channel=status_offset(-18))).utc_offset_s == -18
        assert decode_ncom(ncom(channel=(16, bytes(8)))).utc_offset_s is None
        assert decode_ncom(ncom(channel=status_time(-1))).gps_minute is None

    @pytest.mark.parametrize(
        ("status", "has_pose", "has_time", "initialising"),
        [
            (0, False, False, True), (1, False, False, True), (2, False, True, True), (3, True, True, False),
            (4, True, True, False), (10, False, False, False), (11, False, False, False), (22, False, False, False),
        ],
    )  # fmt: skip
    def test_navigation_status(self, status, has_pose, has_time, initialising):
        reading = decode_ncom(ncom(5, status=status, channel=status_time(7)))
        assert (reading.pose is not None, reading.minute_ms is not None) == (has_pose, has_time)
        assert (reading.gps_minute is not None) == has_time
        assert reading.initialising == initialising

    @given(st.integers(1, 71), st.integers(1, 255))
    def test_one_wrong_byte_is_noticed(self, position, change):
        data = bytearray(ncom(1234, heading=1.0, channel=status_time(99)))
        data[position] = (data[position] + change) % 256
        with pytest.raises(DecodeError, match="checksum"):
            decode_ncom(bytes(data))

    @pytest.mark.parametrize("data", [b"", ncom()[:-1], ncom() + b"\0", b"\xe8" + ncom()[1:], bytes(72)])
    def test_what_is_no_packet(self, data):
        with pytest.raises(DecodeError, match="no NCOM packet of 72 bytes"):
            decode_ncom(data)

    @pytest.mark.parametrize(
        ("fields", "problem"),
        [
            ({"lat_deg": math.nan}, "not finite"),
            ({"lat_deg": 91.0}, "not on Earth"),
            ({"heading": None}, "orientation is marked invalid"),
        ],
    )
    def test_poses_that_are_none(self, fields, problem):
        with pytest.raises(DecodeError, match=problem):
            decode_ncom(ncom(**fields))


class TestMessages:
    """Payload and sender, whatever the message type calls them."""

    def test_ethernet_and_udp(self):
        for message in (ethernet(T0, b"abc"), udp(T0, b"abc")):
            assert payload(message) == b"abc"
            assert sender(message) == ("10.1.1.20", 3000)

    def test_a_bare_array(self):
        message = Msg(data=[1, 2, 3])
        assert payload(message) == b"\x01\x02\x03"
        assert sender(message) == ("", 0)

    @pytest.mark.parametrize("name", ["payload", "data", "packet", "raw", "bytes"])
    @pytest.mark.parametrize(
        "value",
        [b"abc", bytearray(b"abc"), memoryview(b"abc"), [97, 98, 99], np.frombuffer(b"abc", np.uint8)],
    )
    def test_names_and_kinds_of_the_payload(self, name, value):
        assert payload(Msg(**{name: value})) == b"abc"

    @pytest.mark.parametrize("address", ["sender_ip", "address", "src_ip", "source_ip"])
    @pytest.mark.parametrize("port", ["sender_port", "src_port", "source_port"])
    def test_names_of_the_sender(self, address, port):
        assert sender(Msg(**{address: "10.1.1.20", port: 3000})) == ("10.1.1.20", 3000)
        assert sender(Msg(**{address: np.array([10, 1, 1, 20], np.uint8)})) == ("10.1.1.20", 0)

    @pytest.mark.parametrize("message", [Msg(other=1), Msg(data=["a"])])
    def test_no_bytes(self, message):
        with pytest.raises(DecodeError, match=r"no field payload or data|not bytes"):
            payload(message)


NCOM = {"source": "ncom", "topic": "/ncom"}


def packet_of(t, gps_s=None, **fields):
    """The packet that a system at `truth(t)` sends; `gps_s` is GPS time."""
    place = np.array([truth(t).translation])
    lat, lon, alt = (float(v[0]) for v in ORIGIN.to_geodetic(place))
    yaw, climb = 0.3 * t, 0.0
    fields = {"heading": math.pi / 2 - yaw, "pitch": climb} | fields
    if fields["heading"] < -math.pi:
        fields["heading"] += 2 * math.pi
    ms = round((gps_s or 0.0) * 1000) % 60_000
    return ncom(ms, lat, lon, alt, **fields)


def packets(times, **fields):
    return [("/ncom", ETHERNET, at(t) + 1_000_000, ethernet(at(t), packet_of(t, **fields))) for t in times]


class TestPoses:
    """The source `ncom` of the step `ego_poses`."""

    def test_between_packets_to_a_millimetre(self, tmp_path):
        made = Posed(tmp_path, NCOM, *packets(TIMES))
        # Height is a single-precision number: 0.03 mm at 500 m. Angles come in microradians.
        metres, radians = made.errors_m_rad(BETWEEN)
        assert metres < 1e-3
        assert radians < 5e-6
        assert made.json["counts"] == {"read": 100, "written": 100, "merged": 0, "lost": {}}
        assert made.json["origin"]["utm_zone"] == "32N"
        assert made.json["global_frame"] == "enu"

    def test_the_system_sits_where_tf_says(self, tmp_path):
        system = SE3.create((0.5, 0.5, -0.5, 0.5), (-0.5, 0.2, 1.1))
        made = Posed(tmp_path, NCOM | {"frame": "ins"}, *packets(TIMES), static("base_link", "ins", system))
        metres, radians = made.errors_m_rad(BETWEEN, lambda t: truth(t) @ system.inverse())
        assert metres < 1e-3
        assert radians < 5e-6

    def test_udp_messages_and_messages_without_header(self, tmp_path):
        datagrams = [("/ncom", UDP, at(t), udp(at(t), packet_of(t))) for t in TIMES]
        bare = [
            ("/ncom", "std_msgs/msg/UInt8MultiArray", at(t), Msg(data=np.frombuffer(packet_of(t), np.uint8)))
            for t in TIMES
        ]
        one, other = Posed(tmp_path / "a", NCOM, *datagrams), Posed(tmp_path / "b", NCOM, *bare)
        assert one.table == other.table
        assert one.errors_m_rad(BETWEEN)[0] < 1e-3

    def test_packets_of_other_senders_are_left_out_and_counted(self, tmp_path):
        noise = [
            ("/ncom", ETHERNET, at(t) + 5, ethernet(at(t) + 5, b"lidar" * 200, sender=(10, 1, 1, 21)))
            for t in TIMES
        ]
        twin = [
            ("/ncom", ETHERNET, at(t) + 6, ethernet(at(t) + 6, packet_of(t + 1), port=3001)) for t in TIMES
        ]
        made = Posed(tmp_path / "a", NCOM | {"sender": "10.1.1.20"}, *packets(TIMES), *noise)
        assert made.errors_m_rad(BETWEEN)[0] < 1e-3
        assert made.json["counts"] == {"read": 200, "written": 100, "merged": 100, "lost": {}}
        made = Posed(tmp_path / "b", NCOM | {"sender": "10.1.1.20:3000"}, *packets(TIMES), *twin)
        assert made.errors_m_rad(BETWEEN)[0] < 1e-3
        with pytest.raises(LossLimitError, match="no NCOM packet of 72 bytes"):
            Posed(tmp_path / "c", NCOM, *packets(TIMES), *noise)

    def test_nobody_of_that_address(self, tmp_path):
        with pytest.raises(PoseError, match=r"from /ncom: none of 100 packets gives a pose"):
            Posed(tmp_path, NCOM | {"sender": "1.2.3.4"}, *packets(TIMES))

    def test_packets_without_pose_are_accounted_for(self, tmp_path):
        entries = [
            *packets([-0.3, -0.2, -0.1], status=2),
            *packets([0.005], status=10),
            *packets([0.007], status=22),
            *packets(TIMES),
        ]
        assert Posed(tmp_path, NCOM, *entries).json["counts"] == {
            "read": 105, "written": 100, "merged": 2, "lost": {"the navigation system has no solution yet": 3},
        }  # fmt: skip

    def test_damaged_packets_are_counted_up_to_the_limit(self, tmp_path):
        damaged = bytearray(packet_of(0.011))
        damaged[30] ^= 1
        entry = ("/ncom", ETHERNET, at(0.011), ethernet(at(0.011), bytes(damaged)))
        made = Posed(tmp_path, NCOM, *packets(TIMES), entry)
        assert made.json["counts"]["lost"] == {"a checksum of its NCOM packet is wrong": 1}
        with pytest.raises(LossLimitError, match="1 of 101 packets cannot be used"):
            Posed(tmp_path / "b", NCOM, *packets(TIMES), entry, limits=Limits(lost_messages=0.001))

    def test_several_packets_in_one_payload(self, tmp_path):
        source = NCOM | {"stamp": "packet"}
        gps = 23_000_000 * 60
        entries = []
        for t in np.arange(0.0, 1.0, 0.1):
            both = packet_of(t, gps + t, channel=status_time(23_000_000)) + packet_of(
                t + 0.05, gps + t + 0.05
            )
            entries.append(("/ncom", ETHERNET, at(t), ethernet(at(t), both)))
        made = Posed(tmp_path, source, *entries)
        assert made.json["counts"] == {"read": 20, "written": 20, "merged": 0, "lost": {}}
        steps = np.diff([row["stamp_ns"] for row in made.table])
        assert set(steps.tolist()) == {50_000_000}

    def test_orientation_is_turned_into_the_frame_of_the_origin(self, tmp_path):
        """30 km to the east, north is 0.3 degrees off that of the origin."""
        far = LocalFrame(48.0, 11.4, 0.0)
        entries = [
            ("/ncom", ETHERNET, at(0), ethernet(at(0), ncom(0, 48.0, 11.0, 0.0))),
            ("/ncom", ETHERNET, at(1), ethernet(at(1), ncom(0, 48.0, 11.4, 0.0))),
        ]
        row = Posed(tmp_path, NCOM, *entries).table[1]
        forward = SE3.create([row[f"q{axis}"] for axis in "wxyz"], (0, 0, 0)).rotation_matrix[:, 0]
        north = (
            LocalFrame(48.0, 11.0, 0.0).ecef_SE3_enu.inverse().rotation_matrix
            @ far.ecef_SE3_enu.rotation_matrix
        )
        np.testing.assert_allclose(forward, north[:, 1], atol=2e-6)
        assert abs(forward[0]) > 4e-3


class TestRecordings:
    """Packets in real files, read by the whole chain of steps."""

    @staticmethod
    def message(t, data):
        def make(store):
            ethernet_packet = store.types[ETHERNET]
            return ethernet_packet(
                recorded_bags.header(store, at(t), "eth"), np.array([10, 1, 1, 20], np.uint8), 3000,
                np.zeros(4, np.uint8), 3000, np.frombuffer(data, np.uint8),
            )  # fmt: skip

        return recorded_bags.Message("/ncom", ETHERNET, at(t) + 1_000_000, make)

    @pytest.mark.parametrize("file_format", ["ros1", "ros2", "mcap"])
    def test_every_format(self, tmp_path, file_format):
        for store in (recorded_bags.ROS1, recorded_bags.ROS2):
            if ETHERNET not in store.types:
                store.register(get_types_from_msg(DEFINITION, ETHERNET))
        messages = [self.message(t, packet_of(t)) for t in TIMES]
        messages.insert(50, recorded_bags.image(at(1.0) + 500_000))
        bags = tmp_path / "bags"
        bags.mkdir()
        {"ros1": write_ros1, "ros2": write_ros2, "mcap": write_mcap}[file_format](
            bags / {"ros1": "a.bag", "ros2": "a", "mcap": "a.mcap"}[file_format], messages
        )
        (tmp_path / "recipe.yaml").write_text(RECIPE)
        recipe = load_recipe(tmp_path / "recipe.yaml")
        (files,) = discover(recipe.bags).recordings.values()
        build = RecordingBuild(
            recipe, Store(recipe.store_path), files, recording_digest(files).digest, recording_stat(files)
        )
        made = {result.asset: result.artifact for result in build.build(["inventory", "ego_poses"])}
        inventory = Inventory.from_json(made["inventory"].read_json("inventory.json"))
        assert inventory.topic("/ncom").packed
        trajectory = load_trajectory(made["ego_poses"])
        positions, _, valid = trajectory.at(np.array([at(t) for t in BETWEEN]))
        assert valid.all()
        expected = np.array([truth(t).translation for t in BETWEEN])
        assert np.abs(positions - expected).max() < 1e-3

    def test_a_recipe_is_proposed_for_them(self, tmp_path):
        for store in (recorded_bags.ROS1, recorded_bags.ROS2):
            if ETHERNET not in store.types:
                store.register(get_types_from_msg(DEFINITION, ETHERNET))
        path = write_ros1(tmp_path / "a.bag", [self.message(t, packet_of(t)) for t in TIMES])
        files = RecordingFiles(
            "a", "a.bag", path, "ros1", (path,), path.stat().st_size, path.stat().st_mtime_ns
        )
        with open_recording(files, ()) as recording:
            seen = scan_recording(recording)
        assert seen.topics["/ncom"].ncom_sender == "10.1.1.20"
        path = write_ros1(tmp_path / "b.bag", [self.message(t, bytes(1206)) for t in TIMES])
        files = RecordingFiles(
            "b", "b.bag", path, "ros1", (path,), path.stat().st_size, path.stat().st_mtime_ns
        )
        with open_recording(files, ()) as recording:
            assert scan_recording(recording).topics["/ncom"].ncom_sender is None

    def test_large_packets_are_not_kept_aside(self, tmp_path):
        for store in (recorded_bags.ROS1, recorded_bags.ROS2):
            if ETHERNET not in store.types:
                store.register(get_types_from_msg(DEFINITION, ETHERNET))
        path = write_mcap(tmp_path / "a.mcap", [self.message(t, bytes(1206)) for t in (0.0, 0.1)])
        files = RecordingFiles(
            "a", "a.mcap", path, "mcap", (path,), path.stat().st_size, path.stat().st_mtime_ns
        )
        with open_recording(files, ()) as recording:
            made = Written(tmp_path / "out", lambda out: make_inventory(recording, out, size=1))
        inventory = Inventory.from_json(made.artifact.read_json("inventory.json"))
        assert not inventory.topic("/ncom").packed


class TestTime:
    """`stamp: packet`: milliseconds from the packet, the minute from the few that tell it."""

    MINUTE = 23_456_789
    UNIX_S = GPS_EPOCH_S + MINUTE * 60 - 18

    def stamps(self, tmp_path, times, *, tell=(0,), channel=None, late_s=0.4, **fields):
        """Packets at seconds into the minute; those whose index is in `tell` carry channel 0."""
        entries = []
        for i, t in enumerate(times):
            minute = self.MINUTE + math.floor(t / 60)
            own = status_time(minute) if i in tell else (channel if channel and i == 1 else (1, bytes(8)))
            data = ncom(round(t * 1000) % 60_000, 48.0, 11.0 + 1e-6 * i, channel=own)
            # In the order given: a packet that was overtaken arrives after the one that overtook it.
            log_ns = self.UNIX_S * S + round((max(times[: i + 1]) + late_s) * S) + i
            entries.append(("/ncom", ETHERNET, log_ns, ethernet(log_ns, data)))
        made = Posed(tmp_path, NCOM | {"stamp": "packet"} | fields, *entries)
        return made, [round(row["stamp_ns"] / 1e6) / 1e3 - self.UNIX_S for row in made.table]

    def test_utc_from_gps_time_whatever_the_host_says(self, tmp_path):
        _, stamps = self.stamps(tmp_path, [1.0, 1.01, 1.02])
        assert stamps == pytest.approx([1.0, 1.01, 1.02], abs=1e-6)

    @pytest.mark.parametrize("tell", [(0,), (3,), (6,), (0, 6)])
    def test_over_the_turn_of_the_minute(self, tmp_path, tell):
        times = [59.97, 59.98, 59.99, 60.0, 60.01, 60.02, 60.03]
        _, stamps = self.stamps(tmp_path, times, tell=tell)
        assert stamps == pytest.approx(times, abs=1e-6)

    def test_packets_that_overtake_each_other_at_the_turn_of_the_minute(self, tmp_path):
        times = [59.98, 60.0, 59.99, 60.01]
        _, stamps = self.stamps(tmp_path, times, tell=(3,))
        assert stamps == pytest.approx(sorted(times), abs=1e-6)

    def test_over_several_minutes(self, tmp_path):
        times = np.arange(0.0, 200.0, 7.0).tolist()
        _, stamps = self.stamps(tmp_path, times, tell=(10,))
        assert stamps == pytest.approx(times, abs=1e-6)

    def test_after_a_long_pause_the_minute_must_be_given_again(self, tmp_path):
        times = [1.0, 1.1, 301.0, 301.1]
        made, stamps = self.stamps(tmp_path / "a", times, tell=(0,))
        assert stamps == pytest.approx([1.0, 1.1], abs=1e-6)
        assert made.json["counts"]["lost"] == {"no packet near it tells the GPS minute": 2}
        _, stamps = self.stamps(tmp_path / "b", times, tell=(0, 3))
        assert stamps == pytest.approx(times, abs=1e-6)

    def test_the_offset_of_utc_in_the_packets_wins(self, tmp_path):
        _, stamps = self.stamps(tmp_path / "a", [1.0, 1.1], channel=status_offset(-17))
        assert stamps == pytest.approx([2.0, 2.1], abs=1e-6)
        _, stamps = self.stamps(tmp_path / "b", [1.0, 1.1], leap_seconds=16)
        assert stamps == pytest.approx([3.0, 3.1], abs=1e-6)

    def test_without_any_minute_there_is_no_pose(self, tmp_path):
        with pytest.raises(PoseError, match="2 because no packet near it tells the GPS minute"):
            self.stamps(tmp_path, [1.0, 1.1], tell=())
