"""What `init` makes of robots that are no car and no arm on a table: drones, boats, legged and mobile ones, and their sensors."""

import numpy as np
import pytest

from bagassets.propose.proposal import propose_recipe
from bagassets.propose.scan import scan_recording
from bagassets.recordings.open import open_recording
from bagassets_tests.propose.test_propose import CLOUD, IMAGE, channels_of, info, odometry, summary, topic
from bagassets_tests.recorded_bags import NOON_NS, Message, header, write_mcap

pytestmark = pytest.mark.once

TWIST, JOINTS = "geometry_msgs/msg/TwistStamped", "sensor_msgs/msg/JointState"
CAMERA = topic("/camera/image_raw", IMAGE, frame="camera", encoding="rgb8", rate_hz=30.0)
RADAR_FIELDS = ("x", "y", "z", "range_rate", "rcs")
LIDAR_FIELDS = ("x", "y", "z", "intensity", "velocity")  # such as Aeva's lidars, which measure it, too


def rig_of(*topics, **fields):
    (rig,) = propose_recipe({"a.bag": summary(*topics, **fields)}, name="odd", root="/bags").rigs
    return rig


def moves(name, msgtype=TWIST):
    labels = tuple(f"{half}.{axis}" for half in ("linear", "angular") for axis in "xyz")
    return topic(name, msgtype, elements=(labels,))


def cloud(name, frame, fields):
    """A cloud with fields of float32, one metre ahead."""

    def make(store):
        kind = store.types["sensor_msgs/msg/PointField"]
        layout = [kind(field, 4 * number, 7, 1) for number, field in enumerate(fields)]
        data = np.ones(10 * len(fields), np.float32).view(np.uint8)
        head, step = header(store, NOON_NS, frame), 4 * len(fields)
        return store.types[CLOUD](head, 1, 10, layout, False, step, 10 * step, data, True)

    return Message(name, CLOUD, NOON_NS, make)


@pytest.mark.parametrize(
    ("name", "msgtype", "is_command"),
    [
        ("/mavros/local_position/velocity_body", TWIST, False),
        ("/gps/vel", TWIST, False),
        ("/tcp_twist", TWIST, False),
        ("/mavros/setpoint_velocity/cmd_vel", TWIST, True),
        ("/servo_node/delta_twist_cmds", TWIST, True),
        ("/spacenav/twist", "geometry_msgs/msg/Twist", True),
    ],
)
def test_velocities_that_were_measured_are_no_commands(name, msgtype, is_command):
    rig = rig_of(CAMERA, topic("/joint_states", JOINTS, elements=(("hip", "knee"),)), moves(name, msgtype))
    commands = [one.topic.name for one in rig.signals if one.role == "command"]
    assert commands == [name] * is_command
    (use,) = (use for use in rig.topic_uses if use.topic.name == name)
    assert use.status == ("used" if is_command else "left out")
    assert is_command or "if it is part of the state, " in use.text


def test_a_drone_whose_velocity_was_measured_has_no_actions():
    assert not rig_of(CAMERA, odometry(), moves("/mavros/local_position/velocity_body")).signals


@pytest.mark.parametrize(
    ("name", "frame", "fields", "channel"),
    [
        ("/oculii/pointcloud", "front", RADAR_FIELDS, "RADAR_FRONT"),
        ("/ars548/detections", "front", ("x", "y", "z"), "RADAR_FRONT"),
        ("/sensing/points", "radar0", ("x", "y", "z"), "RADAR_FRONT"),
        ("/aeva/points", "front", LIDAR_FIELDS, "LIDAR_TOP"),
        ("/arson/points", "front", ("x", "y", "z"), "LIDAR_TOP"),
    ],
)
def test_clouds_of_radars_are_known_by_number_and_field(tmp_path, name, frame, fields, channel):
    """They became lidars, and the first by name even LIDAR_TOP."""
    write_mcap(tmp_path / "a.mcap", [cloud(name, frame, fields)])
    with open_recording(tmp_path / "a.mcap") as recording:
        (rig,) = propose_recipe({"a.mcap": scan_recording(recording)}, name="odd", root="/bags").rigs
    assert list(rig.channels) == [channel]


@pytest.mark.parametrize(
    ("name", "encoding", "is_picture"),
    [
        ("/oak/stereo/image_raw", "16uc1", False),  # depth of Luxonis' driver
        ("/oak/stereo/image_raw", "mono8", True),
        ("/oak/tof/image_raw", "16uc1", False),
        ("/lepton/image_raw", "16uc1", True),
        ("/ouster/range_image", "mono16", False),
        ("/ouster/nearir_image2", "mono16", False),
        ("/zed/zed_node/confidence/confidence_map", "32fc1", False),
        ("/long_range/image", "mono16", True),
    ],
)
def test_depth_and_the_panoramas_of_a_lidar_are_no_pictures(tmp_path, name, encoding, is_picture):
    other = topic(name, IMAGE, frame="other", encoding=encoding, is_16_bit=encoding != "mono8")
    found = channels_of(summary(CAMERA, info("/camera/camera_info", "camera"), other), tmp_path)
    assert (name in found.values()) == is_picture
