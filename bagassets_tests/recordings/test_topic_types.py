"""A topic of the wrong type is reported when a channel is asked for, not as messages that were lost."""

from dataclasses import replace

import pytest

from bagassets.assets.frames import FRAMES
from bagassets.base.errors import DecodeError
from bagassets.recipe.model import CameraChannel, RadarChannel, Recipe, Rig
from bagassets_tests.facts import MadeUpFacts, calibrated, use_of
from bagassets_tests.sweep_run import inventory, lidar, request

EXPECTED = {
    "camera": "expected sensor_msgs/Image, CompressedImage, foxglove_msgs/RawImage, CompressedImage, or video (",
    "lidar": "expected sensor_msgs/PointCloud2, PointCloud, LaserScan, MultiEchoLaserScan, "
    "point_cloud_interfaces/CompressedPointCloud2, foxglove_msgs/PointCloud, LaserScan, livox_ros_driver2/CustomMsg, livox_ros_driver/CustomMsg, or Velodyne or "
    "Hesai packets (velodyne_msgs/VelodyneScan, pandar_msgs/PandarScan, ethernet_msgs/Packet and the like) or Ouster packets (ouster_sensor_msgs/PacketMsg)",
    "radar": "expected sensor_msgs/PointCloud2, point_cloud_interfaces/CompressedPointCloud2, foxglove_msgs/PointCloud, or the "
    "targets of a radar",
}
NAMES = {"camera": "CAM_FRONT", "lidar": "LIDAR_TOP", "radar": "RADAR_FRONT"}


def ask(modality, msgtype):
    if modality == "camera":
        channels = {"CAM_FRONT": CameraChannel(topic="/sensor", undistort=False)}
        rig = Rig(name="car", channels=channels, ego_pose={"source": "fixed"})
        facts = MadeUpFacts(inventory(msgtype), calibration=calibrated(CAM_FRONT={}))
        return use_of(FRAMES, rig, facts, "CAM_FRONT")
    return request(lidar() if modality == "lidar" else RadarChannel(topic="/sensor"), msgtype)


@pytest.mark.parametrize(
    ("modality", "msgtype"),
    [
        ("camera", "sensor_msgs/msg/PointCloud2"),
        ("camera", "velodyne_msgs/msg/VelodyneScan"),
        ("lidar", "sensor_msgs/msg/Image"),
        ("lidar", "sensor_msgs/msg/CompressedImage"),
        ("lidar", "nav_msgs/msg/OccupancyGrid"),
        ("lidar", "std_msgs/msg/String"),
        ("radar", "sensor_msgs/msg/Image"),
        ("radar", "sensor_msgs/msg/LaserScan"),
        ("radar", "nav_msgs/msg/Odometry"),
        ("radar", "tf2_msgs/msg/TFMessage"),
    ],
)
def test_a_topic_of_the_wrong_type_is_refused_by_name(modality, msgtype):
    with pytest.raises(DecodeError) as caught:
        ask(modality, msgtype)
    text = str(caught.value)
    assert text.startswith(f"{NAMES[modality]} (/sensor): carries {msgtype}, {EXPECTED[modality]}")
    assert "correct the topic in the recipe" in text


def test_a_channel_of_the_wrong_type_leaves_the_others_alone():
    known = inventory("sensor_msgs/msg/Image")
    cloud = replace(known.topics["/sensor"], name="/cloud", msgtype="sensor_msgs/msg/PointCloud2")
    facts = MadeUpFacts(
        replace(known, topics={"/cloud": cloud, **known.topics}),
        calibration=calibrated(CAM_BACK={}, CAM_FRONT={}),
    )
    channels = {
        "CAM_BACK": CameraChannel(topic="/cloud", undistort=False),
        "CAM_FRONT": CameraChannel(topic="/sensor", undistort=False),
    }
    rig = Rig(name="car", channels=channels, ego_pose={"source": "fixed"})
    recipe = Recipe(name="test", bags={"root": "bags"}, rigs=(rig,))
    uses = FRAMES.use(FRAMES.params(recipe, rig), facts)
    assert isinstance(uses["CAM_BACK"], DecodeError)
    assert uses["CAM_FRONT"].topics == ("/sensor",)


@pytest.mark.parametrize(
    ("modality", "msgtype"),
    [
        ("camera", "sensor_msgs/msg/CompressedImage"),
        ("lidar", "sensor_msgs/msg/LaserScan"),
        ("lidar", "sensor_msgs/msg/MultiEchoLaserScan"),
        ("lidar", "sensor_msgs/msg/PointCloud"),
        ("lidar", "velodyne_msgs/msg/VelodyneScan"),
        ("lidar", "pandar_msgs/msg/PandarScan"),
        ("lidar", "hesai_ros_driver/msg/UdpFrame"),
        ("lidar", "nebula_msgs/msg/NebulaPackets"),
        ("lidar", "acme_msgs/msg/LidarFrame"),
        ("lidar", "std_msgs/msg/UInt8MultiArray"),
        ("radar", "radar_msgs/msg/RadarScan"),
        ("radar", "acme_msgs/msg/Tracks"),
        ("radar", "sensor_msgs/msg/PointCloud"),
    ],
)
def test_types_that_may_hold_what_is_needed_are_taken(modality, msgtype):
    assert ask(modality, msgtype).params.msgtype == msgtype
