"""What `bagassets init` makes of recordings as strangers have them: what a first build would refuse is a question before."""

import re

import numpy as np
import pytest
import zstandard
from mcap.writer import Writer as McapWriter

from bagassets.base.errors import RecipeError
from bagassets.cli.main import main
from bagassets.propose.poses import propose_pose
from bagassets.propose.summary import RecordingSummary, TopicSummary
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.store.store import Store
from bagassets_tests.cli.test_init import write_bag
from bagassets_tests.odd_drive import OddDrive
from bagassets_tests.recording_build import RecordingBuild
from bagassets_tests.series import write_parts
from bagassets_tests.small_drive import START_NS, STORE1, messages, write_drive

pytestmark = pytest.mark.once

URDF = """<?xml version="1.0"?>
<!-- made by xacro -->
<robot name="cart">
  <joint name="mast" type="fixed">
    <parent link="base_link"/><child link="cam"/><origin xyz="1 0 2" rpy="0 0 0"/>
  </joint>
  <joint name="roof" type="fixed"><parent link="base_link"/><child link="lidar"/></joint>
</robot>
"""


@pytest.fixture
def init(tmp_path, capsys, monkeypatch):
    """Run `bagassets init project --bags PATH`; return its exit status and what it printed."""
    monkeypatch.setenv("COLUMNS", "400")

    def run(bags, *options):
        status = main(["init", str(tmp_path / "project"), "--bags", str(bags), *options])
        captured = capsys.readouterr()
        return status, captured.out + captured.err

    return run


def asked(output):
    """Return the subject, line and text of each question."""
    found = re.findall(r"^  (\S+) \(line (\d+)\): (.*(?:\n    .*)*)", output, re.MULTILINE)
    return {subject: (int(line), re.sub(r"\s+", " ", text)) for subject, line, text in found}


@pytest.mark.parametrize(
    ("odd", "why"),
    [
        ("static-loop", "the transforms go round in a circle, lidar_top <- base_link <- lidar_top"),
        ("static-disputed", "the transform base_link -> lidar_top (tf_static) changes"),
    ],
)
def test_a_sensor_whose_place_tf_contradicts_is_a_question(init, tmp_path, odd, why):
    drive = OddDrive(tmp_path, odd)
    status, output = init(drive.path)
    questions = asked(output)
    assert (status, list(questions)) == (2, ["LIDAR_TOP"])
    line, text = questions["LIDAR_TOP"]
    assert why in text
    assert text.endswith("; correct that and remove this field, or measure `extrinsics`")
    with pytest.raises(RecipeError, match=rf"recipe\.yaml:{line}: rigs\[rig\].channels.LIDAR_TOP.extrinsics"):
        load_recipe(tmp_path / "project" / "recipe.yaml")


@pytest.mark.parametrize(
    ("named", "said"),
    [
        ("/notes", "no recording has a camera, lidar or radar, so there is nothing to convert; "),
        (
            "/depth/points",
            "no topic is proposed for a sensor. /depth/points: the cloud of a depth camera; add what is one as a channel, or ",
        ),
    ],
)
def test_where_nothing_is_proposed_the_line_is_that_of_the_build_and_the_advice_works(
    init, tmp_path, named, said
):
    keep = "/odom" if named == "/notes" else "/points"
    renamed = [
        (named if topic == "/points" else topic, *rest)
        for topic, *rest in messages(STORE1, 1.0, ros1=True)
        if topic == keep
    ]
    write_bag(tmp_path / "a.bag", renamed)
    status, output = init(tmp_path / "a.bag")
    line, text = asked(output)["rigs"]
    assert status == 2
    assert text == f"{said}name another folder with --bags, and --force to replace this recipe"
    says = rf"recipe\.yaml:{line}: rigs: needs a value: sensor set-ups; .* other recordings with --bags and --force"
    with pytest.raises(RecipeError, match=says):
        load_recipe(tmp_path / "project" / "recipe.yaml")
    write_drive(tmp_path / "other" / "a.bag", "ros1", duration_s=1.0)
    status, output = init(tmp_path / "other")
    assert (status, "--force does that" in output) == (1, True)
    assert init(tmp_path / "other", "--force")[0] == 0


def described(folder, urdf, *, static=False):
    """Write a drive with a robot description, without static transforms unless they are wanted."""
    text = STORE1.types["std_msgs/msg/String"](urdf)
    drive = [entry for entry in messages(STORE1, 3.0, ros1=True) if static or entry[0] != "/tf_static"]
    write_bag(folder / "a.bag", [("/robot_description", "std_msgs/msg/String", START_NS, text), *drive])
    return folder / "a.bag"


def header(stamp_ns):
    stamp = STORE1.types["builtin_interfaces/msg/Time"](START_NS // 10**9, stamp_ns)
    return STORE1.types["std_msgs/msg/Header"](0, stamp, "gps")


class TestRobotDescription:
    def test_it_becomes_the_urdf_that_places_the_sensors(self, init, tmp_path):
        status, output = init(described(tmp_path, URDF))
        assert (status, asked(output)) == (0, {})
        assert re.search(r"/robot_description +std_msgs/String +1 +URDF", output)
        project = tmp_path / "project"
        assert (project / "rig.urdf").read_text() == URDF
        recipe = load_recipe(project / "recipe.yaml")
        assert recipe.rigs[0].urdf == project / "rig.urdf"
        assert (
            "urdf: rig.urdf  # guess: /robot_description, for frames" in (project / "recipe.yaml").read_text()
        )
        (recording,) = discover(recipe.bags).recordings.values()
        build = RecordingBuild(
            recipe,
            Store(recipe.store_path),
            recording,
            recording_digest(recording).digest,
            recording_stat(recording),
        )
        (made,) = (one for one in build.build({"inventory", "calibration"}) if one.asset == "calibration")
        channels = made.artifact.read_json("calibration.json")["channels"]
        assert channels["CAM_FRONT"]["ego_SE3_sensor"]["translation"] == [1.0, 0.0, 2.0]
        assert channels["LIDAR_TOP"]["source"] == "urdf"

    def test_it_is_not_needed_where_tf_has_all(self, init, tmp_path):
        status, output = init(described(tmp_path, URDF, static=True))
        assert (status, asked(output)) == (0, {})
        assert re.search(r"/robot_description +std_msgs/String +1 +not needed", output)
        assert not (tmp_path / "project" / "rig.urdf").exists()

    def test_one_without_the_frames_of_sensors_is_a_comment(self, init, tmp_path):
        status, output = init(
            described(tmp_path, URDF.replace('"cam"', '"hand"').replace('"lidar"', '"foot"'))
        )
        assert (status, set(asked(output))) == (2, {"CAM_FRONT", "LIDAR_TOP"})
        assert re.search(r"/robot_description .* left out: a URDF that places no sensor", output)
        project = tmp_path / "project"
        assert "\n    # urdf: rig.urdf\n" in (project / "recipe.yaml").read_text()
        assert (project / "rig.urdf").exists()

    def test_one_that_cannot_be_used_is_left_out_with_the_reason(self, init, tmp_path):
        status, output = init(described(tmp_path, "<robot><joint</robot>"))
        assert (status, set(asked(output)) > set()) == (2, True)
        assert re.search(r"/robot_description .* left out: URDF, line 1: not XML", output)

    def test_a_file_of_that_name_is_not_replaced_unasked(self, init, tmp_path):
        (tmp_path / "project").mkdir()
        (tmp_path / "project" / "rig.urdf").write_text("mine")
        bag = described(tmp_path, URDF)
        status, output = init(bag)
        assert (status, "rig.urdf would be replaced; --force does that" in output) == (1, True)
        assert [path.name for path in (tmp_path / "project").iterdir()] == ["rig.urdf"]
        assert init(bag, "--force")[0] == 0
        assert (tmp_path / "project" / "rig.urdf").read_text() == URDF


def test_one_part_of_a_drive_is_said_to_be_one(init, tmp_path):
    part, _ = write_parts(tmp_path / "bags" / "drive.mcap", [0.5], 1.0)
    assert "drive_0.mcap is part of drive.mcap; for the whole drive, name the folder.\n" in init(part)[1]
    assert "is part of" not in init(part.parent, "--force")[1]


def test_messages_that_were_compressed_are_said_to_be(init, tmp_path):
    path = tmp_path / "part_12.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros2")
        definition = (
            b"std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\n"
        )
        schema = writer.register_schema(
            "sensor_msgs/msg/Image", "ros2msg", definition + b"uint32 step\nuint8[] data"
        )
        channel = writer.register_channel("/camera/image_raw", "cdr", schema)
        writer.add_message(channel, START_NS, zstandard.compress(bytes(1000)), START_NS)
        writer.finish()
    status, output = init(path)
    assert status == 2
    _, text = asked(output)["rigs"]
    assert (
        "/camera/image_raw: its messages are compressed, which only the metadata.yaml of its bag says" in text
    )


def test_a_single_fix_is_named_where_poses_are_asked_for(init, tmp_path):
    fix = STORE1.types["sensor_msgs/msg/NavSatFix"]
    status = STORE1.types["sensor_msgs/msg/NavSatStatus"](0, 1)
    one = fix(header(0), status, 49.0, 8.4, 115.0, np.zeros(9), 0)
    drive = [entry for entry in messages(STORE1, 1.0, ros1=True) if entry[0] != "/odom"]
    write_bag(tmp_path / "a.bag", [("/fix", "sensor_msgs/msg/NavSatFix", START_NS, one), *drive])
    _, text = asked(init(tmp_path / "a.bag")[1])["ego_pose"]
    assert text.startswith(
        "the recordings hold no odometry, pose, TF chain or GNSS fixes but one of /fix; name "
    )


def test_poses_that_are_called_the_truth_come_first():
    topics = {
        name: TopicSummary(name, "geometry_msgs/msg/PoseStamped", count)
        for name, count in (("ORB-SLAM", 8362), ("S-PTAM", 9000), ("groundtruth", 8363))
    }
    assert propose_pose(RecordingSummary(topics), "base_link").fields["topic"] == "groundtruth"
