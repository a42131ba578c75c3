"""What `init` proposes for robots without lidar: signals, and a LeRobot dataset of them and the cameras."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from bagassets.propose.proposal import propose_recipe
from bagassets.propose.scan import scan_recording
from bagassets.recipe import parse_recipe
from bagassets.recordings.discover import find_one
from bagassets.recordings.open import open_recording
from bagassets.sample.arm import ELEMENTS
from bagassets.sample.drive import Target, write_arm_recordings, write_recordings
from bagassets_tests.recorded_bags import NOON_NS, SECOND, Message, header, write_ros1

pytestmark = pytest.mark.once

JOINT = "sensor_msgs/msg/JointState"


def proposed(*paths):
    """The proposal of recordings, and its recipe as plain data."""
    summaries = {}
    for path in paths:
        with open_recording(find_one(path)) as recording:
            summaries[path.name] = scan_recording(recording)
    proposal = propose_recipe(summaries, name="arm", root=str(paths[0].parent))
    if proposal.rigs:
        parse_recipe(proposal.text, paths[0].with_name("recipe.yaml"))
    return proposal, yaml.safe_load(proposal.text)


@pytest.fixture(scope="module")
def arms(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arms")
    targets = {
        "ros1": folder / "a.bag",
        "ros2": folder / "b",
        "mcap": folder / "c.mcap",
        "foxglove": folder / "d.mcap",
    }
    write_arm_recordings([Target(path, kind) for kind, path in targets.items()], duration_s=2.5)
    return targets


@pytest.mark.parametrize("kind", ["ros1", "ros2", "mcap", "foxglove"])
def test_the_arm_gets_all_that_it_needs(arms, kind):
    proposal, recipe = proposed(arms[kind])
    joints, text = ("joints.position", "message") if kind == "foxglove" else ("position", "data")
    (rig,) = recipe["rigs"]
    names = list(ELEMENTS)
    assert rig["signals"] == {
        "joint_states": {"topic": "/joint_states", "field": joints, "names": names},
        "joint_commands": {"topic": "/joint_commands", "field": joints, "names": names},
    }
    assert list(rig["channels"]) == ["CAM_WORKSPACE", "CAM_WRIST"]
    assert recipe["lerobot"] == {
        "fps": 30,
        "features": {
            "observation.state": {"signals": ["joint_states"]},
            "action": {"signals": ["joint_commands"]},
            "observation.images.workspace": {"camera": "CAM_WORKSPACE", "at": "nearest"},
            "observation.images.wrist": {"camera": "CAM_WRIST", "at": "nearest"},
        },
        "episodes": {"topic": "/episode", "field": text, "start": ["start"], "end": ["end"]},
        "task": {"topic": "/task", "field": text},
    }
    # Nothing asks for poses or places of sensors, which an arm on a table has none of.
    assert proposal.questions == []
    assert {"nuscenes", "scenes", "splits"}.isdisjoint(recipe)
    assert {"ego_pose", "ego_frame"}.isdisjoint(rig)
    uses = {use.topic.name: use.text for use in proposal.rigs[0].topic_uses}
    assert uses["/joint_states"] == "signal joint_states"
    assert (uses["/episode"], uses["/task"]) == ("episodes", "task")


def test_commands_that_no_rule_makes_a_signal_are_left_out_with_a_word(tmp_path):
    """The height of a lift, say: the action would lack it, and `not needed` would be untrue."""

    def number(topic):
        return Message(topic, "std_msgs/msg/Float64", NOON_NS, lambda s: s.types["std_msgs/msg/Float64"](0.5))

    def joints(store):
        empty = np.zeros(0)
        return store.types[JOINT](header(store, NOON_NS, ""), ["a"], np.zeros(1), empty, empty)

    topics = [
        number("/lift/command"),
        number("/temperature"),
        number("/gripper/force"),
        Message("/joint_states", JOINT, NOON_NS, joints),
    ]
    write_ros1(tmp_path / "a.bag", topics)
    proposal, _ = proposed(tmp_path / "a.bag")
    uses = {use.topic.name: (use.status, use.text) for use in proposal.rigs[0].topic_uses}
    assert uses["/lift/command"][0] == "left out"
    assert uses["/lift/command"][1].startswith("commands, by its name; ")
    assert uses["/gripper/force"][1].startswith("measured, by type and name; if it is part of the state, ")
    assert uses["/temperature"] == ("not needed", "")


def test_names_of_commands_do_not_make_commands_of_texts_times_and_sensors(tmp_path):
    """To describe them as signals, as the word on commands advises, would be a dead end: they hold no command."""

    def text(store):
        return store.types["std_msgs/msg/String"]("arm 7")

    def time_reference(store):
        now = header(store, NOON_NS, "")
        return store.types["sensor_msgs/msg/TimeReference"](now, now.stamp, "gps")

    def joy(store):
        now = header(store, NOON_NS, "")
        return store.types["sensor_msgs/msg/Joy"](now, np.zeros(2, np.float32), np.zeros(1, np.int32))

    def joints(store):
        empty = np.zeros(0)
        return store.types[JOINT](header(store, NOON_NS, ""), ["a"], np.zeros(1), empty, empty)

    messages = [
        Message("/teleop/robot_info", "std_msgs/msg/String", NOON_NS, text),
        Message("/gripper/serial", "std_msgs/msg/String", NOON_NS, text),
        Message("/gps/time_reference", "sensor_msgs/msg/TimeReference", NOON_NS, time_reference),
        Message("/teleop/joy", "sensor_msgs/msg/Joy", NOON_NS, joy),
        Message("/joint_states", JOINT, NOON_NS, joints),
    ]
    write_ros1(tmp_path / "a.bag", messages)
    proposal, _ = proposed(tmp_path / "a.bag")
    uses = {use.topic.name: use.text for use in proposal.rigs[0].topic_uses}
    assert uses["/teleop/robot_info"] == uses["/gripper/serial"] == uses["/gps/time_reference"] == ""
    assert uses["/teleop/joy"].startswith("commands, by its name; ")


def test_joints_of_a_trajectory_are_commands(tmp_path):
    def joints(store):
        empty = np.zeros(0)
        return store.types[JOINT](header(store, NOON_NS, ""), ["a"], np.zeros(1), empty, empty)

    topics = ("/joint_states", "/humanoid_arm_traj")
    write_ros1(tmp_path / "a.bag", [Message(topic, JOINT, NOON_NS, joints) for topic in topics])
    _, recipe = proposed(tmp_path / "a.bag")
    features = recipe["lerobot"]["features"]
    assert features["observation.state"] == {"signals": ["joint_states"]}
    assert features["action"] == {"signals": ["humanoid_arm_traj"]}


def test_texts_of_two_kinds_of_recordings_have_a_field_each(arms):
    _, recipe = proposed(arms["ros1"], arms["foxglove"])
    assert len(recipe["rigs"]) == 2
    assert recipe["lerobot"]["episodes"]["field"] == ["data", "message"]
    assert recipe["lerobot"]["task"]["field"] == ["data", "message"]


def test_an_arm_among_vehicles_gets_the_poses_that_their_dataset_needs(arms, tmp_path):
    drive = tmp_path / "drive.bag"
    write_recordings([Target(drive, "ros1")], duration_s=1.0)
    paths = {"drive.bag": drive, "a.bag": arms["ros1"]}
    summaries = {}
    for name, path in paths.items():
        with open_recording(find_one(path)) as recording:
            summaries[name] = scan_recording(recording)
    proposal = propose_recipe(summaries, name="both", root=str(tmp_path))
    recipe = parse_recipe(proposal.text, tmp_path / "recipe.yaml")
    asked = [int(said.split(":")[1]) for rig in recipe.rigs for said in rig.questions]
    assert asked == [question.line for question in proposal.questions], "each is marked in the recipe"
    assert proposal.questions[0].subject == "ego_pose"


def state(number, names, *, topic="/joint_states", stamped=True):
    stamp_ns = NOON_NS + number * SECOND // 50

    def make(store):
        nothing, values = np.zeros(0), np.arange(len(names), dtype=float)
        return store.types[JOINT](
            header(store, stamp_ns * stamped, ""), list(names), values, nothing, nothing
        )

    return Message(topic, JOINT, stamp_ns, make)


def of(msgtype, topic, number, make):
    return Message(topic, msgtype, NOON_NS + number * SECOND // 50, lambda store: make(store.types))


def array(number, topic="/gripper/command"):
    kind = "std_msgs/msg/Float64MultiArray"
    return of(kind, topic, number, lambda t: t[kind](t["std_msgs/msg/MultiArrayLayout"]([], 0), np.zeros(2)))


def twist(number):
    kind = "geometry_msgs/msg/Twist"
    return of(
        kind, "/cmd_vel", number, lambda t: t[kind](*[t["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)] * 2)
    )


def flag(number):
    return of("std_msgs/msg/Bool", "/episode/running", number, lambda t: t["std_msgs/msg/Bool"](True))


def test_drivers_that_share_a_topic_get_a_signal_each(tmp_path):
    messages = [state(n, ("b", "a", "c") if n % 2 else ("finger",)) for n in range(100)]
    messages[1] = state(1, ("c", "a", "b"))
    _, recipe = proposed(write_ros1(tmp_path / "a.bag", messages))
    signals = recipe["rigs"][0]["signals"]
    assert {name: one["names"] for name, one in signals.items()} == {
        "joint_states": ["finger"],
        "joint_states_2": ["c", "a", "b"],
    }
    assert recipe["lerobot"]["features"] == {
        "observation.state": {"signals": ["joint_states", "joint_states_2"]},
        "action": {"next_of": "observation.state"},
    }
    assert recipe["lerobot"]["fps"] == 25  # they take turns


def test_joints_that_only_some_messages_have_are_a_signal_of_their_own(tmp_path):
    """A gripper's driver beside one of all joints: half of the messages lacked the arm, so that no episode was whole."""
    messages = [state(n, ("grip",) if n % 2 else ("a", "b", "grip")) for n in range(100)]
    proposal, recipe = proposed(write_ros1(tmp_path / "a.bag", messages))
    signals = recipe["rigs"][0]["signals"]
    assert [one["names"] for one in signals.values()] == [["a", "b"], ["grip"]]
    assert [one.rate_hz for one in proposal.rigs[0].signals] == pytest.approx([25.0, 50.0])


def test_commands_without_header_and_episodes_by_a_flag(tmp_path):
    messages = [make(n) for n in range(100) for make in (array, twist, flag)]
    messages += [state(n, ("a", "b")) for n in range(100)]
    messages += [array(n, "/measured") for n in range(100)]  # may be anything
    proposal, recipe = proposed(write_ros1(tmp_path / "a.bag", sorted(messages, key=lambda m: m.log_time_ns)))
    assert recipe["rigs"][0]["signals"] == {
        "joint_states": {"topic": "/joint_states", "field": "position", "names": ["a", "b"]},
        "cmd_vel": {"topic": "/cmd_vel", "field": ["linear", "angular"], "clock": "log"},
        "gripper_command": {"topic": "/gripper/command", "field": "data", "clock": "log"},
        "episode_running": {"topic": "/episode/running", "field": "data", "clock": "log"},
    }
    assert recipe["lerobot"]["features"]["action"] == {"signals": ["cmd_vel", "gripper_command"]}
    assert recipe["lerobot"]["episodes"] == {"signal": "episode_running"}
    assert "# task: " in proposal.text


def test_a_gripper_with_a_topic_of_its_own_and_a_flag_that_says_what_succeeded(tmp_path):
    """The flag is set once, behind an episode: as the signal of episodes it left all of them out."""

    def number(topic, kind="std_msgs/msg/Float32"):
        return lambda n: of(kind, topic, n, lambda t: t[kind](0.5))

    makers = [
        lambda n: state(n, "ba" if n % 2 else "ab", topic="/follower/joint_states"),
        lambda n: state(n, "ba", topic="/leader/joint_states"),
        number("/gripper/position"),
        number("/gripper/command", "std_msgs/msg/Float64"),
        number("/gripper/temperature"),
    ]
    messages = [make(n) for n in range(50) for make in makers]
    kind = "std_msgs/msg/String"
    messages += [
        of(kind, "/episode_event", n, lambda t, n=n: t[kind]("start" if n == 1 else "stop")) for n in (1, 49)
    ]
    messages.append(of("std_msgs/msg/Bool", "/episode/success", 50, lambda t: t["std_msgs/msg/Bool"](True)))
    _, recipe = proposed(write_ros1(tmp_path / "a.bag", sorted(messages, key=lambda m: m.log_time_ns)))
    features = recipe["lerobot"]["features"]
    assert features["observation.state"] == {"signals": ["follower_joint_states", "gripper_position"]}
    assert features["action"] == {"signals": ["gripper_command", "leader_joint_states"]}
    # A policy whose state and action count joints differently learns nothing useful from their difference.
    signals = recipe["rigs"][0]["signals"]
    assert signals["leader_joint_states"]["names"] == signals["follower_joint_states"]["names"] == ["a", "b"]
    assert recipe["lerobot"]["episodes"]["topic"] == "/episode_event"


def test_what_was_aborted_ends_an_episode_too(tmp_path):
    """Else it would go on until the next begins, with all that the robot did in between; nothing is to be missed because it comes late."""
    kind = "std_msgs/msg/String"
    said = ((5, "start"), (20, "stop"), (25, "start"), (700, "aborted"))
    texts = [of(kind, "/episode", n, lambda t, text=text: t[kind](text)) for n, text in said]
    messages = sorted([*(state(n, "ab") for n in range(750)), *texts], key=lambda one: one.log_time_ns)
    _, recipe = proposed(write_ros1(tmp_path / "a.bag", messages))
    assert recipe["lerobot"]["episodes"]["end"] == ["stop", "aborted"]


def test_fast_joints_are_sampled_and_the_recipe_says_how_fast_they_are(tmp_path):
    messages = [replace(state(n, ("a", "b")), log_time_ns=NOON_NS + n * SECOND // 200) for n in range(100)]
    proposal, recipe = proposed(write_ros1(tmp_path / "a.bag", messages))
    assert recipe["lerobot"]["fps"] == 50
    assert "fps: 50  # guess: at most 50; the slowest signal, joint_states, has 200 Hz\n" in proposal.text


def image(number, topic):
    def make(store):
        data = np.zeros(12, np.uint8)
        return store.types[kind](header(store, stamp_ns, "cam"), 2, 2, "rgb8", 0, 6, data)

    stamp_ns, kind = NOON_NS + number * SECOND // 50, "sensor_msgs/msg/Image"
    return Message(topic, kind, stamp_ns, make)


def test_values_slower_than_the_frames_may_be_older(tmp_path):
    """By default a value is 1.5 frames old at most: no frame beside a gripper of 10 Hz would have one."""
    messages = [
        make(n)
        for n in range(50)
        for make in (lambda n: image(n, "/wrist/image_raw"), lambda n: state(n, "ab"))
    ]
    slow = [replace(one, topic="/gripper/joint_states") for one in messages[1::10]]
    _, recipe = proposed(
        write_ros1(tmp_path / "a.bag", sorted([*messages, *slow], key=lambda one: one.log_time_ns))
    )
    features = recipe["lerobot"]["features"]
    joints = ["gripper_joint_states", "joint_states"]
    assert features["observation.state"] == {"signals": joints, "tolerance_s": 0.15}


@pytest.mark.parametrize(
    ("topic", "name"), [("/wrist_cam/image_raw", "wrist"), ("/camera/color/image_raw", "front")]
)
def test_the_only_camera_of_an_arm_keeps_its_name(tmp_path, topic, name):
    """Vehicles have a front; what an arm sees is named after where its camera is, if the topic says that."""
    messages = [make(n) for n in range(20) for make in (lambda n: image(n, topic), lambda n: state(n, "ab"))]
    _, recipe = proposed(write_ros1(tmp_path / "a.bag", messages))
    camera = {"camera": f"CAM_{name.upper()}", "at": "nearest"}
    assert recipe["lerobot"]["features"][f"observation.images.{name}"] == camera


@pytest.mark.parametrize(("ahead_s", "clock"), [(0.5, "header"), (640_413, "log")])
def test_a_computer_whose_clock_is_days_ahead_of_that_of_the_cameras(tmp_path, ahead_s, clock):
    """Joints and images by header stamps would never meet; no episode would have both."""
    messages = [image(n, "/wrist/image_raw") for n in range(20)]
    for n in range(20):
        ahead = state(n + int(ahead_s * 50), ("a", "b"))
        messages.append(replace(ahead, log_time_ns=messages[n].log_time_ns))
    proposal, recipe = proposed(write_ros1(tmp_path / "a.bag", messages))
    assert recipe["clock"] == "header"
    assert recipe["rigs"][0]["signals"]["joint_states"].get("clock", "header") == clock
    said = "header stamps of /joint_states and /wrist/image_raw are 177:53:33 h apart"
    assert (said in " ".join(proposal.text.replace("#", "").split())) == (clock == "log")


def test_a_car_with_lidar_is_no_arm(tmp_path):
    write_recordings([Target(tmp_path / "a.bag", "ros1")], duration_s=0.3)
    _, recipe = proposed(tmp_path / "a.bag")
    assert "lerobot" not in recipe
    assert "signals" not in recipe["rigs"][0]
    assert "nuscenes" in recipe


def test_stamps_of_zero_and_topics_without_letters(tmp_path):
    messages = [state(n, ("a", "b"), topic="/1/2", stamped=False) for n in range(20)]
    _, recipe = proposed(write_ros1(tmp_path / "a.bag", messages))
    expected = {"topic": "/1/2", "field": "position", "names": ["a", "b"], "clock": "log"}
    assert recipe["rigs"][0]["signals"] == {"signal_1_2": expected}


def test_commands_alone_are_nothing_to_convert(tmp_path):
    proposal, recipe = proposed(write_ros1(tmp_path / "a.bag", [twist(n) for n in range(50)]))
    assert not proposal.rigs
    assert "lerobot" not in recipe


def test_recordings_of_joints_alone_are_of_one_rig(tmp_path):
    """Without any camera, joints say which recordings belong together."""
    paths = [tmp_path / f"{name}.bag" for name in "ab"]
    for path in paths:
        write_ros1(path, [state(n, ("a", "b")) for n in range(20)])
    proposal, recipe = proposed(*paths)
    assert len(recipe["rigs"]) == 1
    assert "channels" not in recipe["rigs"][0]
    assert not proposal.bare
