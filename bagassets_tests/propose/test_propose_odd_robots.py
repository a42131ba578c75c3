"""What `init` makes of robots that are no car and no arm on a table: drones, boats, legged and mobile ones, and their sensors."""

import numpy as np
import pytest

from bagassets.propose.proposal import propose_recipe
from bagassets.propose.scan import scan_recording
from bagassets.recordings.open import open_recording
from bagassets_tests.propose.test_propose import (
    CLOUD,
    IMAGE,
    ODOMETRY,
    POSE,
    channels_of,
    info,
    odometry,
    summary,
    topic,
)
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


ZED = ("rgb", "left", "right")


@pytest.mark.parametrize(
    "names",
    [
        [f"{one}/image_rect_color" for one in ZED] + [f"{one}_raw/image_raw_color" for one in ZED],
        [f"{one}{how}_gray/image_{how}gray" for one in ZED for how in ("", "_raw")]
        + [f"{one}_raw/image_raw_color" for one in ZED],
        [f"{one}/color/{how}/image" for one in ZED for how in ("rect", "raw")],
    ],
    ids=["4", "4 and grey", "5"],
)
def test_the_many_topics_of_a_stereo_camera_are_two_cameras(names):
    topics = [
        topic(
            f"/zed/zed_node/{name}",
            IMAGE,
            frame=f"zed_{'right' if 'right' in name else 'left'}_optical",
            encoding="bgra8",
        )
        for name in names
    ]
    rig = rig_of(*topics)
    chosen = [sensor.topic.name.removeprefix("/zed/zed_node/") for sensor in rig.channels.values()]
    assert sorted(name.partition("/")[0].removesuffix("_raw") for name in chosen) in (
        ["left", "right"],
        ["rgb", "right"],
    )
    assert all("raw" in name for name in chosen)


def test_a_camera_on_the_left_of_another_is_one_of_its_own():
    names = [f"/front{side}/image_raw" for side in ("", "/left", "/right")]  # all in the frame of the vehicle
    assert len(rig_of(*(topic(name, IMAGE, frame="base_link") for name in names)).channels) == 3


@pytest.mark.parametrize("more", [0, 50])
def test_of_a_drone_the_filter_is_preferred_to_the_receiver(more):
    own = odometry("/mavros/local_position/odom")
    receiver = odometry("/mavros/global_position/local", count=own.count + more)
    rig = rig_of(CAMERA, own, receiver)
    assert rig.pose.fields["topic"] == "/mavros/local_position/odom"
    assert rig_of(CAMERA, receiver).pose.fields["topic"] == "/mavros/global_position/local"
    pose = topic("/mavros/local_position/pose", "geometry_msgs/msg/PoseStamped", frame="map")
    assert rig_of(CAMERA, pose, receiver).pose.fields["topic"] == "/mavros/local_position/pose"


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


@pytest.mark.parametrize("name", ["/tcp_pose_broadcaster/pose", "/left_arm/eef_pose"])
def test_the_pose_of_a_tool_is_not_where_the_robot_is(name):
    """The camera of a wrist got the poses of the tool as those of a vehicle, and a nuScenes dataset."""
    joints = topic("/joint_states", JOINTS, elements=(("elbow", "wrist"),))
    rig = rig_of(CAMERA, joints, topic(name, POSE, frame="base"))
    assert rig.is_arm
    (use,) = (use for use in rig.topic_uses if use.topic.name == name)
    assert (use.status, use.text[:8]) == ("left out", "measured")
    assert not rig_of(CAMERA, joints, topic("/slam/pose", POSE, frame="map")).is_arm


@pytest.mark.parametrize("frame", ["world_ned", "map"])
def test_poses_with_z_down_have_a_note(frame):
    text = propose_recipe(
        {"a": summary(CAMERA, topic("/odom", ODOMETRY, frame=frame))}, name="odd", root="/"
    ).text
    assert (f"{frame} sounds as if z were down" in text) == (frame == "world_ned")


def test_odometry_that_nothing_decodes_is_named_where_poses_are_asked_for():
    px4 = topic("/fmu/out/vehicle_odometry", "px4_msgs/msg/VehicleOdometry")
    (asked,) = propose_recipe({"a": summary(CAMERA, px4)}, name="odd", root="/").questions
    assert f"GNSS fixes but {px4.name}, whose px4_msgs/VehicleOdometry needs a decoder (" in asked.text


def test_a_mount_that_only_the_urdf_knows_is_asked_for_as_one():
    urdf = '<robot><joint type="revolute"><parent link="base_link"/><child link="camera"/></joint></robot>'
    described = topic("/robot_description", "std_msgs/msg/String", urdf=urdf)
    one = summary(CAMERA, odometry(), described)
    (asked,) = propose_recipe({"a": one}, name="odd", root="/", urdfs=True).questions
    assert "in the URDF, joints that move lead from base_link to camera (a mount that pans, " in asked.text


@pytest.mark.parametrize(
    ("name", "channel"), [("/stern_cam/image", "CAM_BACK"), ("/bow_cam/image", "CAM_FRONT")]
)
def test_sides_of_a_boat(name, channel, tmp_path):
    sides = [topic(one, IMAGE, encoding="rgb8") for one in (name, "/starboard_cam/image")]
    assert channels_of(summary(*sides), tmp_path) == {
        channel: name,
        "CAM_RIGHT": "/starboard_cam/image",
    }


def test_the_only_camera_of_a_boat_looks_where_its_name_says():
    """The course over ground is ahead, whatever is seen."""
    fix = topic("/fix", "sensor_msgs/msg/NavSatFix", frame="gps")
    one = summary(topic("/stern_cam/image", IMAGE, frame="stern", encoding="rgb8"), fix)
    text = propose_recipe({"a": one}, name="odd", root="/").text
    assert "extrinsics: {translation: [0, 0, 0], rotation: [0.5, -0.5, -0.5, 0.5]}" in text


@pytest.mark.parametrize("msgtype", ["event_camera_msgs/msg/EventPacket", "dvs_msgs/msg/EventArray"])
def test_an_event_camera_is_one_that_nothing_decodes(msgtype):
    (bare,) = propose_recipe({"a": summary(topic("/events", msgtype))}, name="odd", root="/").bare
    assert [use.status for use in bare.topic_uses] == ["not decodable"]


def test_masters_are_leaders():
    """As ALOHA's arms are called: what the masters did became part of the state, and the action lacked it."""
    arms = ("master_left", "master_right", "puppet_left", "puppet_right")
    joints = [topic(f"/{arm}/joint_states", JOINTS, elements=(("waist", "wrist"),)) for arm in arms]
    assert [one.role for one in rig_of(CAMERA, *joints).signals] == ["state"] * 2 + ["command"] * 2


def test_clouds_in_the_frame_in_which_the_robot_moves_are_no_sensor(tmp_path):
    """As FAST-LIO publishes them: one, the first by name, was LIDAR_TOP."""
    lidar = topic("/livox/lidar", CLOUD, frame="livox")
    computed = topic("/cloud_effected", CLOUD, frame="camera_init")
    poses = topic("/Odometry", ODOMETRY, frame="camera_init", child_frames=("body",))
    rig = rig_of(lidar, computed, poses)
    assert [sensor.topic.name for sensor in rig.channels.values()] == ["/livox/lidar"]
    (use,) = (use for use in rig.topic_uses if use.topic.name == "/cloud_effected")
    assert use.text == "computed: its points are in camera_init, in which the robot moves"
    assert "/cloud_effected" in channels_of(summary(computed), tmp_path).values(), "nothing else is known"


def test_a_mobile_arm_is_told_that_lerobot_needs_no_extrinsics():
    joints = topic("/joint_states", JOINTS, elements=(("elbow", "wrist"),))
    (asked,) = propose_recipe({"a": summary(CAMERA, odometry(), joints)}, name="odd", root="/").questions
    assert "if only LeRobot's dataset is wanted, remove `nuscenes` and this field" in asked.text


def test_of_robots_the_poses_are_those_of_the_one_whose_sensors_are_taken():
    """The poses of a third robot that has no sensors, and no TF of its own, were uncommented with the rest."""
    topics = [odometry("/robot1/odom"), odometry("/robot3/odom"), odometry("/ground_truth/odom")]
    rig = rig_of(CAMERA, *topics, robots={"/robot1": True, "/robot2": True})
    assert rig.pose.fields["topic"] == "/robot1/odom"


def test_joints_beside_a_lidar_have_a_word():
    """A mobile manipulator is proposed as a vehicle; that its arm is left out was not said."""
    joints = topic("/joint_states", JOINTS, elements=(("elbow", "wrist"),))
    rig = rig_of(CAMERA, topic("/points", CLOUD, frame="lidar"), odometry(), joints)
    (use,) = (use for use in rig.topic_uses if use.topic.name == "/joint_states")
    assert (use.status, use.text[:30]) == ("left out", "joints, beside a lidar or rada")


def test_transforms_that_cannot_be_decoded_are_left_out_with_a_word():
    """As of a converter that wrote bytes of another format: they were said to become transforms, and to be the recipe's `tf`."""
    broken = topic("/robot/tf", "tf2_msgs/msg/TFMessage", problem="its bytes do not fit")
    sound = topic("/tf", "tf2_msgs/msg/TFMessage")
    topics = (CAMERA, odometry(), broken, sound)
    uses = {use.topic.name: (use.status, use.text) for use in rig_of(*topics).topic_uses}
    assert uses["/robot/tf"] == ("left out", "transforms that cannot be decoded: its bytes do not fit")
    assert uses["/tf"] == ("used", "transforms")
    assert "tf: [" not in propose_recipe({"a": summary(*topics)}, name="odd", root="/").text


def test_a_namespace_that_states_and_commands_share_says_nothing_of_them():
    """All joints below `teleop` were commands, and the dataset had no state."""
    names = ("joint_cmd", "joint_states", "target_gripper_status")
    joints = [topic(f"/io_teleop/{name}", JOINTS, elements=(("waist", "wrist"),)) for name in names]
    roles = {one.topic.name.split("/")[-1]: one.role for one in rig_of(CAMERA, *joints).signals}
    assert roles == {"joint_cmd": "command", "joint_states": "state", "target_gripper_status": "command"}
    leaders = [
        topic(f"/leader_{side}/joint_states", JOINTS, elements=(("waist",),)) for side in ("left", "right")
    ]
    assert [one.role for one in rig_of(CAMERA, *leaders).signals] == ["command", "command"]
