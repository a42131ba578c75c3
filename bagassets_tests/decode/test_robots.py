"""Which namespaces of a recording are robots, and which are not."""

import time

import pytest

from bagassets.decode.robots import robot_of, robots_of

TF, ODOMETRY = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"
IMAGE, CLOUD = "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"
POSE, PACKETS = "geometry_msgs/msg/PoseStamped", "velodyne_msgs/msg/VelodyneScan"


def topics(*namespaces, **of_each):
    """Topics below each namespace: name -> type, and the frame of their headers."""
    return {
        f"{namespace}/{name.replace('__', '/')}": given
        for namespace in namespaces
        for name, given in of_each.items()
    }


def robot(*namespaces, frame="lidar", **more):
    return topics(*namespaces, points=(CLOUD, (frame,)), odom=(ODOMETRY, ("odom",)), **more)


OWN_TF = {"tf": (TF, ()), "tf_static": (TF, ())}


@pytest.mark.parametrize(
    ("recorded", "robots"),
    [
        (robot("/robot1", "/robot2", **OWN_TF), ["/robot1", "/robot2"]),
        (robot("/a", "/b", "/c", **OWN_TF), ["/a", "/b", "/c"]),
        (robot("/fleet/robot1", "/fleet/robot2", **OWN_TF), ["/fleet/robot1", "/fleet/robot2"]),
        (robot("robot1", "robot2", **OWN_TF), ["robot1", "robot2"]),
        (robot("/car", "/west/car", **OWN_TF), ["", "/west"]),
        (robot("/static_1", "/static_2", frame="", **OWN_TF), ["/static_1", "/static_2"]),
        (robot("/robot1", "/robot2"), ["/robot1", "/robot2"]),
        (topics("/a", "/b", scan=(PACKETS, ("velodyne",)), ekf__pose=(POSE, ())), ["/a", "/b"]),
        # Frames with a prefix, in one TF topic.
        (
            robot("/r1", frame="r1/lidar") | robot("/r2", frame="r2/lidar") | topics("", **OWN_TF),
            ["/r1", "/r2"],
        ),
        # The first robot has no namespace.
        (robot("", "/robot2", **OWN_TF), ["", "/robot2"]),
        # The second one brought no sensor.
        (robot("/robot2", **OWN_TF) | topics("/leader", odom=(ODOMETRY, ("odom",)), **OWN_TF), ["/robot2", "/leader"]),
        # Robots with several odometries each.
        (
            topics("/robot1", "/robot2", vo__odom=(ODOMETRY, ()), wheel__odom=(ODOMETRY, ()), points=(CLOUD, ("l",))),
            ["/robot1", "/robot2"],
        ),
        (robot("/robot1/front", "/robot1/rear", "/robot2/front", "/robot2/rear"), ["/robot1", "/robot2"]),
    ],
)  # fmt: skip
def test_namespaces_with_poses_of_their_own_are_robots(recorded, robots):
    assert list(robots_of(recorded)) == robots


@pytest.mark.parametrize(
    "recorded",
    [
        robot(""),
        robot("/robot1", **OWN_TF),
        robot("", **OWN_TF) | topics("/lidar_front", "/lidar_rear", points=(CLOUD, ("lidar",))),
        topics("/camera/front", "/camera/rear", image=(IMAGE, ("camera",))) | topics("", **OWN_TF),
        # Two odometries, of which one is beside a sensor.
        topics("/wheel", odom=(ODOMETRY, ())) | robot("/visual"),
        topics("", tf=(TF, ()), odom=(ODOMETRY, ())) | robot("/zed"),
        robot("") | robot("/zed", frame="zed"),
        # Two cameras that track themselves.
        topics("/zed", image=(IMAGE, ("zed",)), odom=(ODOMETRY, ()))
        | topics("/t265", image=(IMAGE, ("t265",)), odom__sample=(ODOMETRY, ())),
        robot("/zed_front", frame="zed_front") | robot("/zed_rear", frame="zed_rear"),
        # Infrastructure: a camera at the roadside, whose mount is static.
        robot("/robot1", **OWN_TF) | topics("/infra", image=(IMAGE, ("infra",)), tf_static=(TF, ())),
        # Odometries of different names or types.
        robot("/a", vo=(POSE, ())) | topics("/b", points=(CLOUD, ("lidar",)), vo=(ODOMETRY, ())),
        topics("/robot1", "/robot2", odom=(ODOMETRY, ("odom",))),
        # Localization without namespace, or in one.
        robot("/robot1", **OWN_TF) | topics("", **OWN_TF),
        robot("", **OWN_TF) | topics("/localization", pose=(POSE, ()), **OWN_TF),
        # Headers without frame.
        robot("/a", "/b", frame=""),
        {},
    ],
)
def test_these_are_one_robot(recorded):
    assert robots_of(recorded) == {}


def test_which_robot_has_sensors_is_told():
    recorded = robot("/b", **OWN_TF) | topics("/a", **OWN_TF)
    assert robots_of(recorded) == {"/b": True, "/a": False}
    assert robots_of(topics("/a", "/b", **OWN_TF)) == {"/a": False, "/b": False}


def test_thousands_of_topics_take_no_time():
    names = [f"/r{number:04}" for number in range(2500)]
    many = {topic: given for name in names for topic, given in robot(name, frame=name[1:]).items()}
    started_s = time.process_time()
    assert robots_of(many) == {}
    assert len(robots_of(robot(*names, **OWN_TF))) == 100  # each has two sources, of which 200 are looked at
    assert time.process_time() - started_s < 10


def test_a_topic_belongs_to_the_robot_in_whose_namespace_it_is():
    robots = ["/robot1", "/robot10", ""]
    assert [robot_of(name, robots) for name in ("/robot1/tf", "/robot10/a/b", "/tf")] == [
        "/robot1",
        "/robot10",
        "",
    ]
    assert robot_of("/tf", ["/robot1", "/robot2"]) is None
    assert robot_of("/robot1", ["/robot1"]) is None
