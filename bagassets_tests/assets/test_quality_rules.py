"""Each rule passes what is right and names the first offender of what is broken."""

import copy
from types import SimpleNamespace

import numpy as np
import pytest
from handmade import Drive, make_tables

from bagassets.assets.boxes.table import BoxTable
from bagassets.assets.quality.box_rules import boxes_plausible
from bagassets.assets.quality.calibration_rules import calibration_plausible
from bagassets.assets.quality.channel_rules import channels_complete
from bagassets.assets.quality.evidence import Evidence
from bagassets.assets.quality.finding import clock
from bagassets.assets.quality.pose_rules import heading_askew, poses_complete, poses_cover_sensors
from bagassets.assets.quality.scene_rules import keyframes_complete, scenes_made
from bagassets.assets.quality.topic_rules import channels_present, stamps_monotonic, topic_rates
from bagassets.formats.nuscenes.part_checks import PART_CHECKS
from bagassets.formats.nuscenes.schema import RECORDING_TABLES
from bagassets.formats.nuscenes.table_integrity import broken_references, duplicate_tokens, files_match
from bagassets.geometry.calibration import Calibration
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import Limits, Recipe, Rig
from bagassets.recipe.model_annotations import AnnotationTopic
from bagassets.recipe.model_checks import (
    BoxesCheck,
    CalibrationCheck,
    ChannelsCheck,
    Checks,
    PosesCheck,
    StampsCheck,
    TopicsCheck,
)
from bagassets.recordings.inventory import Gap, HeaderOffset, Inventory, TopicRecord
from bagassets.recordings.model import Definition
from bagassets.store.store import Store

pytestmark = pytest.mark.once

S = 1_000_000_000
T0 = 1_700_000_000 * S
FORWARD = [0.5, -0.5, 0.5, -0.5]

RIG = Rig.model_validate(
    {
        "name": "car",
        "channels": {
            "CAM_FRONT": {"modality": "camera", "topic": "/cam"},
            "CAM_BACK": {"modality": "camera", "topic": "/back"},
            "LIDAR_TOP": {"modality": "lidar", "topic": "/points"},
        },
        "ego_pose": {"source": "odometry", "topic": "/odom"},
    }
)


def topic(name, **fields):
    values = {
        "msgtype": "sensor_msgs/msg/Image", "count": 100, "bytes": 1, "digest": "", "first_ns": T0, "last_ns": T0 + 10 * S,
        "first_stamp_ns": T0, "last_stamp_ns": T0 + 10 * S, "rate_hz": 9.9, "max_gap_s": 0.1, "gaps": (), "gap_count": 0,
        "header_offset_s": HeaderOffset(0.0, 0.01, 0.1), "unordered_stamps": 0, "frame_ids": (), "serialization": "cdr",
        "packed": False, "problem": None, "definition": Definition("none", ""),
    }  # fmt: skip
    return TopicRecord(name=name, **{**values, **fields})


def inventory(*topics):
    known = {name: topic(name) for name in ("/back", "/cam", "/odom", "/points")}
    known |= {record.name: record for record in topics}
    return Inventory("mcap", 1, T0, T0 + 10 * S, dict(sorted(known.items())), None, None, ())


def without(name):
    whole = inventory()
    return Inventory("mcap", 1, T0, T0, {k: v for k, v in whole.topics.items() if k != name}, None, None, ())


class TestTopics:
    def test_a_good_recording_passes(self):
        assert channels_present(RIG, inventory(), ChannelsCheck()).passed
        assert stamps_monotonic(RIG, inventory(), StampsCheck()).passed
        finding = topic_rates(RIG, inventory(), TopicsCheck())
        assert finding.passed
        assert finding.facts["rates_hz"] == dict.fromkeys(("/back", "/cam", "/odom", "/points"), 9.9)

    @pytest.mark.parametrize(
        ("recording", "reason"),
        [
            (without("/cam"), "is not in the recording"),
            (inventory(topic("/cam", count=0)), "has no messages"),
            (inventory(topic("/cam", problem="its type is unknown")), "cannot be read: its type is unknown"),
        ],
    )
    def test_a_channel_that_is_missing_is_named_with_its_topic(self, recording, reason):
        assert channels_present(RIG, recording, ChannelsCheck()).problems == [
            f"CAM_FRONT: topic /cam {reason}, so its samples lack CAM_FRONT (rigs[].required skips such recordings)"
        ]
        finding = channels_present(RIG, recording, ChannelsCheck(optional=("CAM_FRONT",)))
        assert finding.passed
        assert finding.facts["absent"] == ["CAM_FRONT"]

    def test_a_topic_of_boxes_that_is_missing_is_named(self):
        rig = RIG.model_copy(update={"annotations": (AnnotationTopic(topic="/boxes"),)})
        assert channels_present(rig, inventory(), ChannelsCheck()).problems == [
            "annotations: topic /boxes is not in the recording"
        ]

    @pytest.mark.parametrize(
        ("channel", "fields", "mixed"),
        [
            ("/robot1", {"ego_pose": "/robot1/odom", "tf": "/robot1/tf"}, None),
            ("/robot2", {"ego_pose": "/robot2/odom", "tf": "/robot2/tf"}, None),
            ("/robot1", {"ego_pose": "/robot2/odom"}, "LIDAR_TOP of /robot1; ego_pose of /robot2"),
            ("/robot1", {"ego_pose": "/gnss"}, None),
            ("/robot1", {"ego_pose": "/robot1/odom", "annotations": "/robot2/not_recorded"}, ""),
            ("/robot1", {"ego_pose": "/robot1/odom", "tf": "/robot2/tf"}, "LIDAR_TOP, ego_pose of /robot1; tf of /robot2"),
            (
                "/robot2",
                {"ego_pose": "/robot2/odom", "annotations": "/robot1/boxes"},
                "annotations of /robot1; LIDAR_TOP, ego_pose of /robot2",
            ),
        ],
    )  # fmt: skip
    def test_a_rig_of_two_robots_is_told_what_is_of_which(self, channel, fields, mixed):
        recorded = inventory(
            *(
                topic(f"/robot{number}/{name}", msgtype=msgtype)
                for number in (1, 2)
                for name, msgtype in (
                    ("points", "sensor_msgs/msg/PointCloud2"),
                    ("odom", "nav_msgs/msg/Odometry"),
                    ("tf", "tf2_msgs/msg/TFMessage"),
                    ("boxes", "vision_msgs/msg/Detection3DArray"),
                )
            ),
            topic("/gnss", msgtype="nav_msgs/msg/Odometry"),
        )
        rig = Rig.model_validate(
            {
                "name": "robot",
                "channels": {"LIDAR_TOP": {"modality": "lidar", "topic": f"{channel}/points"}},
                "ego_pose": {"source": "odometry", "topic": fields["ego_pose"]},
                "tf": [fields.get("tf", "/tf")],
                "annotations": [{"topic": fields["annotations"]}] if "annotations" in fields else [],
            }
        )
        problems = channels_present(rig, recorded, ChannelsCheck()).problems
        missing = ["annotations: topic /robot2/not_recorded is not in the recording"] if mixed == "" else []
        words = f"the rig mixes robots that were recorded together: {mixed}; give it the topics of one"
        assert problems == ([words] if mixed else missing)

    def test_rates_out_of_limits_are_named(self):
        slow = TopicsCheck.model_validate({"limits": {"/cam": {"min_hz": 20}, "/odom": {"max_hz": 5}}})
        assert topic_rates(RIG, inventory(), slow).problems == [
            "/cam: 9.9 Hz, at least 20 Hz expected",
            "/odom: 9.9 Hz, at most 5 Hz expected",
        ]
        lone = inventory(topic("/cam", count=1, rate_hz=None, max_gap_s=None))
        assert "1 message has no rate" in topic_rates(RIG, lone, slow).problems[0]

    def test_a_topic_that_is_no_channel_can_be_limited_and_required(self):
        check = TopicsCheck.model_validate({"limits": {"/imu": {"min_hz": 50}}})
        assert topic_rates(RIG, inventory(), check).passed
        required = TopicsCheck.model_validate({"limits": {"/imu": {"min_hz": 50, "required": True}}})
        assert topic_rates(RIG, inventory(), required).problems[0].startswith("/imu: has no messages")
        found = topic_rates(RIG, inventory(topic("/imu", rate_hz=10.0)), check)
        assert found.problems == ["/imu: 10 Hz, at least 50 Hz expected"]

    def test_the_first_long_pause_is_named_with_its_time_and_the_longest(self):
        gaps = (Gap(T0 + S, 0.6), Gap(T0 + 2 * S, 1.5), Gap(T0 + 5 * S, 3.0))
        broken = inventory(topic("/points", max_gap_s=3.0, gaps=gaps))
        (problem,) = topic_rates(RIG, broken, TopicsCheck()).problems
        assert problem.startswith(f"/points: a pause of 1.5 s after 2023-11-14T22:13:22.000Z ({T0 + 2 * S})")
        assert "the longest lasts 3 s" in problem
        patient = TopicsCheck.model_validate({"limits": {"/points": {"max_gap_s": 3.0}}})
        assert topic_rates(RIG, broken, patient).passed

    def test_stamps_that_go_back_are_counted_and_the_first_is_named(self):
        broken = inventory(topic("/cam", unordered_stamps=3, first_unordered_ns=T0 + S))
        (problem,) = stamps_monotonic(RIG, broken, StampsCheck()).problems
        assert problem.startswith("/cam: 3 of 100 header stamps go back in time, the first to 2023-")
        assert str(T0 + S) in problem
        assert stamps_monotonic(RIG, broken, StampsCheck(max_backward=3)).passed
        elsewhere = inventory(topic("/other", unordered_stamps=3))
        assert stamps_monotonic(RIG, elsewhere, StampsCheck()).passed

    def test_stamps_far_from_the_log_time_are_named(self):
        broken = inventory(topic("/odom", header_offset_s=HeaderOffset(3599.0, 3600.0, 3601.0)))
        (problem,) = stamps_monotonic(RIG, broken, StampsCheck()).problems
        assert problem.startswith("/odom: header stamps are 3600 s before the log time")
        older = inventory(topic("/odom", header_offset_s=HeaderOffset(-9e6, -9e6, -9e6)))
        (problem,) = stamps_monotonic(RIG, older, StampsCheck()).problems
        assert problem.startswith("/odom: header stamps are 104.2 days after the log time")

    def test_a_clock_that_is_ahead_of_the_others_is_named(self):
        """As one of TAI, by 37 s: each topic is near the log time, and nothing belongs together."""
        points = topic("/points", header_offset_s=HeaderOffset(-37.1, -36.99, -36.9))
        (problem,) = stamps_monotonic(RIG, inventory(points), StampsCheck()).problems
        assert problem == (
            "/points: by the log times, its stamps are 37 s ahead of those of /odom, at most 2 s expected; if a clock was "
            "off, `stamp_offset_s` of a lidar corrects it, or use `clock: log`"
        )
        assert stamps_monotonic(RIG, inventory(points), StampsCheck(max_apart_s=38.0)).passed
        lidar = RIG.channels["LIDAR_TOP"].model_copy(update={"stamp_offset_s": -37.0})
        corrected = RIG.model_copy(update={"channels": {**RIG.channels, "LIDAR_TOP": lidar}})
        assert stamps_monotonic(corrected, inventory(points), StampsCheck()).passed
        clocks = dict.fromkeys(["CAM_FRONT", "ego_pose", "CAM_BACK"], "header") | {"LIDAR_TOP": "log"}
        assert stamps_monotonic(RIG, inventory(points), StampsCheck(), clocks.__getitem__).passed
        nothing = Inventory("mcap", 1, T0, T0, {}, None, None, ())
        assert stamps_monotonic(RIG, nothing, StampsCheck()).passed

    def test_stamps_that_do_not_count_may_be_anything(self):
        zero = inventory(
            topic("/cam", header_offset_s=HeaderOffset(1e9, 1e9, 1e9), unordered_stamps=3),
            topic("/odom", header_offset_s=HeaderOffset(3600.0, 3600.0, 3600.0)),
        )
        clocks = {"CAM_FRONT": "log", "ego_pose": "header", "LIDAR_TOP": "header", "CAM_BACK": "log"}
        (problem,) = stamps_monotonic(RIG, zero, StampsCheck(), clocks.__getitem__).problems
        assert problem.startswith("/odom:")


COUNTS = {"read": 100, "written": 99, "merged": 0, "lost": {"too short": 1}}
STAMPS = {"CAM_FRONT": T0 + np.arange(100, dtype=np.int64) * S // 10}


def _no_artifact(asset):
    raise AssertionError(f"{asset} is read")


class TestChannels:
    def find(self, **counts):
        return channels_complete(
            {"CAM_FRONT": {"counts": {**COUNTS, **counts}}}, 0.01, lambda _channel: "header"
        )

    def test_few_losses_pass_and_are_reported(self):
        finding = self.find()
        assert finding.passed
        assert finding.facts == {"files": {"CAM_FRONT": 99}, "lost": {"CAM_FRONT": 1}}

    @pytest.mark.parametrize(
        ("counts", "words"),
        [
            ({"written": 98}, "CAM_FRONT: 100 messages were read, but 98 written, 0 merged and 1 lost"),
            (
                {"written": 0, "lost": {"it is cut off": 100}},
                "CAM_FRONT: 100 messages were read, but no file was written because it is cut off",
            ),
            (
                {"written": 95, "lost": {"a": 2, "b": 3}},
                "CAM_FRONT: 5 of 100 messages (5%) were lost, most often (3 times) because b. If that is acceptable, raise limits",
            ),
            (
                {"written": 13, "lost": {"duplicate stamp": 87}},
                "CAM_FRONT: 87 of 100 messages (87%) were lost because of duplicate stamps. If these are ",
            ),
            (
                {"read": 2, "written": 1, "lost": {"its data are cut off": 1}},
                "CAM_FRONT: 1 of 2 messages (50%) was lost because its data are cut off. If that is ",
            ),
            (
                {"written": 1, "merged": 75, "lost": {"incomplete revolution": 24}},
                "CAM_FRONT: 24 of 100 packets (24%) were lost because they belong to incomplete revolutions. ",
            ),
            (
                {"written": 1, "merged": 75, "lost": {"duplicate stamp": 24}},
                "CAM_FRONT: 24 of 100 packets (24%) were lost because of duplicate stamps. ",
            ),
            (
                {"written": 0, "lost": {"incomplete revolution": 100}},
                "CAM_FRONT: 100 packets were read, but no file was written because they belong to incomplete revolutions",
            ),
        ],
    )
    def test_broken_counts_are_named(self, counts, words):
        (problem,) = self.find(**counts).problems
        assert problem.startswith(words)

    def test_duplicates_by_log_time_have_another_way_out(self):
        counts = {"read": 100, "written": 13, "merged": 0, "lost": {"duplicate stamp": 87}}
        clocks = {"RADAR": "log", "CAM_FRONT": "header"}
        channels = {name: {"counts": counts} for name in clocks}
        camera, radar = channels_complete(channels, 0.05, clocks.__getitem__).problems
        assert "`clock: header` for this channel (rigs[].channels.RADAR.clock)" in radar
        assert camera.endswith(
            "If these are separate readings, `clock: log` tells them apart by their log times: for this channel "
            "(rigs[].channels.CAM_FRONT.clock), while others keep their stamps, or for all (clock), as where a simulation was restarted"
        )
        assert radar.endswith("; other channels keep their stamps")

    def test_the_clock_is_that_of_the_channel_and_by_default_that_of_the_recipe(self):
        rig = RIG.model_dump(exclude_none=True)
        recipe = {"name": "t", "bags": {"root": "bags"}, "clock": "log", "rigs": [rig]}
        evidence = Evidence(Recipe.model_validate(recipe), RIG, None, _no_artifact)
        assert {name: evidence.clock_of(name) for name in RIG.channels} == dict.fromkeys(RIG.channels, "log")
        name, channel = next(iter(RIG.channels.items()))
        own = {**RIG.channels, name: channel.model_copy(update={"clock": "header"})}
        evidence = Evidence(evidence.recipe, RIG.model_copy(update={"channels": own}), None, _no_artifact)
        assert evidence.clock_of(name) == "header"
        assert {evidence.clock_of(other) for other in {*own, "GONE"} - {name}} == {"log"}

    def test_the_share_is_that_of_the_recipe_and_five_percent_by_default(self):
        recipe = Recipe.model_validate(
            {"name": "t", "bags": {"root": "bags"}, "rigs": [RIG.model_dump(exclude_none=True)]}
        )
        assert Evidence(recipe, RIG, None, _no_artifact).max_lost == 0.05
        own = recipe.model_copy(update={"limits": Limits(reported_losses=0.2)})
        assert Evidence(own, RIG, None, _no_artifact).max_lost == 0.2
        check = Checks.model_validate({"channels_present": {"max_lost": 0.0}})
        assert Evidence(own.model_copy(update={"checks": check}), RIG, None, _no_artifact).max_lost == 0.0


def drive_along(speed_mps=10.0, until_s=10.0, jump_at=None):
    times = np.arange(0, until_s + 1e-9, 0.1)
    x = speed_mps * times
    if jump_at is not None:
        x[jump_at:] += 50.0
    zeros = np.zeros_like(x)
    rotations = np.tile([1.0, 0, 0, 0], (len(x), 1))
    stamps = T0 + np.round(times * S).astype(np.int64)
    return Trajectory(stamps, np.stack([x, zeros, zeros], 1), rotations, S // 2, 0)


def turning(heading_deg, seconds=30.0):
    """A loop to the left at 5 m/s; `heading_deg` gives the heading by the course, both in degrees."""
    times = np.arange(0, seconds, 0.1)
    course = 0.2 * times
    x, y = np.sin(course) * 25.0, (1 - np.cos(course)) * 25.0
    half = np.radians(heading_deg(np.degrees(course))) / 2
    zeros = np.zeros_like(half)
    rotations = np.stack([np.cos(half), zeros, zeros, np.sin(half)], 1)
    stamps = T0 + np.round(times * S).astype(np.int64)
    return Trajectory(stamps, np.stack([x, y, zeros], 1), rotations, S // 2, 0)


class TestHeadings:
    @pytest.mark.parametrize(
        ("heading_deg", "words"),
        [
            (lambda course: course - 90.0, "moves 90 degrees to the left of where it heads"),
            (lambda course: course + 40.0, "moves 40 degrees to the right of where it heads"),
            (lambda course: 90.0 - course, "heads to the right when it turns left"),
        ],
    )
    def test_an_imu_that_is_not_east_north_up_is_noticed(self, heading_deg, words):
        (said,) = heading_askew(turning(heading_deg), "/imu")
        assert said.startswith(f"the vehicle {words}, by the orientation in /imu: it must be east-north-up")

    @pytest.mark.parametrize(
        "heading_deg",
        [
            lambda course: course + 2.0,
            lambda course: course + 180.0,  # backwards
            lambda course: course + 20.0,  # a boat in a current
            lambda course: np.where(course < 170.0, course, course + 180.0),  # to and fro
            lambda course: 0.0 * course,  # a drone that looks one way
        ],
    )
    def test_what_a_vehicle_does_is_not(self, heading_deg):
        assert not list(heading_askew(turning(heading_deg), "/imu"))

    def test_only_an_imu_beside_gnss_is_asked(self):
        """A robot that moves sideways may well say so in its odometry."""
        (check,) = (one for one in PART_CHECKS if one.name == "poses_cover_sensors")
        counts = {"counts": {"read": 1, "lost": {}}}
        artifact = SimpleNamespace(read_json=lambda _: counts)

        def passed(**pose):
            evidence = SimpleNamespace(
                rig=Rig.model_validate({**RIG.model_dump(exclude_none=True), "ego_pose": pose}),
                recipe=SimpleNamespace(limits=Limits()),
                checks=Checks(),
                trajectory=turning(lambda course: course - 90.0),
                stamps_ns=dict,
                artifact=lambda _: artifact,
            )
            return check.rule(evidence).passed

        assert not passed(source="navsat", topic="/fix", imu="/imu")
        assert passed(source="navsat", topic="/fix")
        assert passed(source="odometry", topic="/odom")

    def test_of_a_few_metres_nothing_is_said(self):
        assert not list(heading_askew(turning(lambda course: course - 90.0, seconds=3.0), "/imu"))
        at_rest = Trajectory(np.array([T0]), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), S, 0)
        assert not list(heading_askew(at_rest, "/imu"))


class TestPoses:
    def test_covered_readings_pass(self):
        finding = poses_cover_sensors(drive_along(), STAMPS, PosesCheck())
        assert finding.passed
        assert finding.facts["with_pose"] == {"CAM_FRONT": 1.0}

    def test_poses_farther_apart_than_the_recipe_allows_are_said_to_be(self):
        second = np.arange(0, 11, dtype=np.int64) * S + T0
        poses = Trajectory(second, np.zeros((11, 3)), np.tile([1.0, 0, 0, 0], (11, 1)), S // 2, 0)
        (problem,) = poses_cover_sensors(poses, STAMPS, PosesCheck()).problems
        assert problem.endswith("; poses come every 1 s only: raise max_gap_s of ego_pose (0.5)")

    def test_the_first_reading_without_pose_is_named(self):
        stamps = {**STAMPS, "A": np.zeros(0, np.int64)}
        (problem,) = poses_cover_sensors(drive_along(until_s=8.0), stamps, PosesCheck()).problems
        assert problem.startswith("CAM_FRONT: 19 of 100 readings have no ego pose, the first at 2023-")
        assert str(T0 + 81 * S // 10) in problem
        assert poses_cover_sensors(drive_along(until_s=8.0), stamps, PosesCheck(min_share=0.8)).passed
        only = {"CAM_FRONT": np.array([T0, T0 + 9 * S])}
        (problem,) = poses_cover_sensors(drive_along(until_s=8.0), only, PosesCheck()).problems
        assert problem.startswith(
            f"CAM_FRONT: 1 of 2 readings has no ego pose, that at {clock(T0 + 9 * S)}; "
        )

    @pytest.mark.parametrize(
        ("lost", "said"),
        [
            ({"its quaternion is zero": 20}, "20 of 101 messages of /odom gave no pose (20 because its quaternion is zero)"),
            (
                {"a": 3, "b": 40, "c": 3},
                "46 of 101 messages of /odom gave no pose (40 because b, 3 because a, 3 because c)",
            ),
        ],
    )  # fmt: skip
    def test_messages_without_pose_are_a_warning(self, lost, said):
        counts = {"read": 101, "written": 101 - sum(lost.values()), "merged": 0, "lost": lost}
        (warning,) = poses_complete(counts, "messages of /odom", 0.05)
        assert warning.startswith(said)
        assert warning.endswith(
            "raise limits.reported_losses in the recipe; else name another source as ego_pose"
        )
        (of_packets,) = poses_complete(counts, "packets of /odom", 0.05)
        assert of_packets == warning.replace("messages of", "packets of")
        finding = poses_cover_sensors(drive_along(), STAMPS, PosesCheck(), [warning])
        assert (finding.problems, finding.sentences, finding.weight("error")) == ([], [warning], "warn")

    def test_what_was_lost_stays_a_warning_beside_an_error(self):
        """What to do about it would not let the check pass."""
        finding = poses_cover_sensors(drive_along(until_s=8.0), STAMPS, PosesCheck(), ["lost"])
        problem, warning = finding.sentences
        assert problem.startswith("CAM_FRONT: ")
        assert (warning, finding.weight("error")) == ("warning: lost", "error")

    @pytest.mark.parametrize(
        ("read", "number"), [(100, 0), (100, 5), (0, 0)], ids=["clean", "a few", "fixed"]
    )  # fmt: skip
    def test_a_few_before_the_source_knows_are_none(self, read, number):
        counts = {
            "read": read,
            "written": read - number,
            "merged": 0,
            "lost": {"it is": number} if number else {},
        }
        assert list(poses_complete(counts, "messages of /odom", 0.05)) == []
        assert len(list(poses_complete(counts, "messages of /odom", 0.04))) == (number > 0)

    def test_a_jump_is_named(self):
        (problem,) = poses_cover_sensors(drive_along(jump_at=50), STAMPS, PosesCheck()).problems
        assert problem.startswith("ego poses jump once, by 51.0 m at ")
        assert str(T0 + 49 * S // 10) in problem

    def test_a_fixed_rig_passes(self):
        fixed = Trajectory(
            np.zeros(1, np.int64), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), 0, 0, fixed=True
        )
        assert poses_cover_sensors(fixed, STAMPS, PosesCheck()).passed


def boxes(**changes):
    """Two tracks along x at 5 m/s, ten boxes each; `x` and `size` replace those of rows."""
    rows = 20
    t = np.repeat(np.arange(10) / 10, 2)
    centers = np.stack([5.0 * t, np.tile([0.0, 8.0], 10), np.ones(rows)], axis=1)
    sizes = np.tile([1.9, 4.5, 1.6], (rows, 1))
    for row, x in changes.get("x", {}).items():
        centers[row, 0] = x
    for row, size in changes.get("size", {}).items():
        sizes[row] = size
    return BoxTable(
        stamps_ns=T0 + np.round(t * S).astype(np.int64), tracks=["a", "b"] * 10, categories=["car"] * rows,
        attributes=[()] * rows, centers_m=centers, rotations=np.tile([1.0, 0, 0, 0], (rows, 1)), sizes_m=sizes,
        scores=np.ones(rows), sources=["/boxes"] * rows,
    )  # fmt: skip


def box_counts(written=20, **lost):
    names = {name.replace("_", " "): number for name, number in lost.items()}
    first = dict.fromkeys(names, "x.json:7")
    read = written + sum(lost.values())
    return {
        "/boxes": {"boxes": {"read": read, "written": written, "lost": names, "first": first, "kept": {}}}
    }


class TestBoxes:
    def find(self, counts=None, **changes):
        return boxes_plausible(box_counts() if counts is None else counts, boxes(**changes), BoxesCheck())

    def test_sound_boxes_pass(self):
        finding = self.find()
        assert finding.problems == []
        assert finding.facts == {"boxes": 20, "tracks": 2, "without_track": 0, "kept": {}}

    def test_no_boxes_pass(self):
        nothing = BoxTable.from_arrow(boxes().to_arrow().slice(0, 0))
        assert boxes_plausible({}, nothing, BoxesCheck()).passed

    def test_lost_boxes_are_named_with_the_first(self):
        (problem,) = self.find(box_counts(written=18, its_size_is_not_positive=2)).problems
        assert problem.startswith(
            "/boxes: 2 of 20 boxes were lost, most often for this reason: its size is not positive (first: x.json:7);"
        )
        assert self.find(box_counts(written=1999, its_size_is_not_positive=1)).passed

    def test_a_track_that_jumps_is_named(self):
        (problem,) = self.find(x={7: 40.0}).problems
        assert problem.startswith("1 track jumps: b of /boxes: 39.0 m from 2023-")
        assert str(T0 + 2 * S // 10) in problem
        assert self.find(x={7: 6.0}).passed  # labels are not that exact

    def test_a_size_of_nothing_on_roads_is_named(self):
        (problem,) = self.find(size={5: (1.9, 450.0, 1.6)}).problems
        assert problem.startswith("1 box is smaller than 0.05 m or larger than 40 m: b of /boxes at 2023-")
        assert problem.endswith(": 1.9 x 450 x 1.6 m")
        assert not self.find(size={5: (0.01, 4.0, 1.6)}).passed


def calibration(**changes):
    """Calibration of a sound front camera and a lidar; `changes` replace fields of the camera."""
    camera = {
        "model": "plumb_bob", "width": 640, "height": 480, "k": [400.0, 0, 319.5, 0, 400.0, 239.5, 0, 0, 1],
        "d": [-0.2, 0.05, 0, 0, 0], "r": [], "p": [], "binning": [1, 1], "source": "recipe",
        "roi": {"x_offset": 0, "y_offset": 0, "width": 640, "height": 480, "do_rectify": False},
    }  # fmt: skip
    pose = {
        "translation": changes.pop("translation", [1.5, 0.0, 1.2]),
        "rotation": changes.pop("rotation", FORWARD),
    }
    channels = {
        "CAM_FRONT": {
            "frame": "cam",
            "ego_SE3_sensor": pose,
            "source": "tf",
            "camera": {**camera, **changes},
        },
        "LIDAR_TOP": {
            "frame": "lidar",
            "ego_SE3_sensor": {"translation": [0, 0, 1.8], "rotation": [1, 0, 0, 0]},
            "source": "tf",
            "camera": None,
        },
    }
    return {"ego_frame": "base_link", "channels": channels, "notes": []}


class TestCalibration:
    def find(self, content):
        return calibration_plausible(Calibration.from_json(content), RIG, CalibrationCheck()).problems

    def test_a_sound_calibration_passes(self):
        finding = calibration_plausible(Calibration.from_json(calibration()), RIG, CalibrationCheck())
        assert finding.problems == []
        assert finding.facts["cameras"]["CAM_FRONT"]["view_deg"] == pytest.approx(77.3, abs=0.1)

    def test_a_camera_without_intrinsics_is_said(self):
        content = calibration()
        content["channels"]["CAM_FRONT"]["camera"] = None
        said = "CAM_FRONT: has no intrinsics, so nothing can be projected into its images; "
        give = " give `intrinsics` in the recipe"
        assert self.find(content) == [f"{said}record its CameraInfo, or{give}"]
        why = "no usable CameraInfo on /info: distortion model 'fov' is not known"  # recorded, it is no help
        content["notes"] = [f"CAM_FRONT: {why}; its images have no intrinsics."]
        assert self.find(content) == [f"{said}{why};{give}"]

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"translation": [1500.0, 0, 1200]}, "is 1920.94 m from the ego frame"),
            ({"rotation": [1.0, 0, 0, 0]}, "looks 90 degrees up"),
            (
                {"rotation": [0.0, 1.0, 0, 0]},
                "if it does look there, raise checks.calibration_plausible.max_tilt_deg",
            ),
            ({"k": [4.0, 0, 319.5, 0, 4.0, 239.5, 0, 0, 1], "d": []}, "a field of view of 178"),
            ({"k": [40000.0, 0, 319.5, 0, 40000.0, 239.5, 0, 0, 1]}, "a field of view of 0.9 degrees"),
            ({"k": [400.0, 0, 319.5, 0, 225.0, 239.5, 0, 0, 1]}, "differ by a factor of 1.78"),
            ({"k": [400.0, 0, 639.5, 0, 400.0, 239.5, 0, 0, 1]}, "cx 639.5 is 50% of 640 pixels off"),
            ({"k": [400.0, 0, 319.5, 0, 400.0, 0.5, 0, 0, 1]}, "cy 0.5 is 50% of 480 pixels off"),
            ({"k": [0.0, 0, 319.5, 0, 400.0, 239.5, 0, 0, 1]}, "are impossible for a lens"),
            ({"d": [-0.9, 0.1, 0, 0, 0]}, "distortion folds the image"),
        ],
    )
    def test_what_no_vehicle_has_is_named(self, changes, words):
        check = CalibrationCheck(max_view_deg=170.0)
        problems = calibration_plausible(Calibration.from_json(calibration(**changes)), RIG, check).problems
        assert problems
        assert problems[0].startswith("CAM_FRONT: ")
        assert any(words in problem for problem in problems)

    @pytest.mark.parametrize(
        ("model", "d"),
        [
            ("plumb_bob", [-0.16, 0.03, 0.0008, -0.0006, 0.0]),
            ("rational_polynomial", [0.12, -0.06, 0.0005, 0.0007, 0.004, 0.31, -0.05, 0.006]),
            ("equidistant", [0.03, -0.008, 0.002, -0.0005]),
            ("none", []),
        ],
    )
    def test_real_lenses_of_each_model_pass(self, model, d):
        assert self.find(calibration(model=model, d=d)) == []

    def test_a_region_of_interest_may_be_off_centre(self):
        roi = {"x_offset": 0, "y_offset": 0, "width": 640, "height": 120, "do_rectify": False}
        assert self.find(calibration(roi=roi)) == []

    def test_copied_extrinsics_are_named(self):
        content = calibration()
        content["channels"]["CAM_BACK"] = {**content["channels"]["CAM_FRONT"], "frame": "back"}
        assert self.find(content) == [
            "CAM_FRONT: has the same extrinsics as CAM_BACK; one of them was probably copied"
        ]
        content["channels"]["CAM_BACK"]["frame"] = "cam"  # colour and depth of one sensor
        assert self.find(content) == []


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    store = Store(tmp_path_factory.mktemp("store"))
    artifact = make_tables(store, Drive(seconds=3.0)).artifact
    tables = {name: artifact.read_json(f"{name}.json") for name in RECORDING_TABLES}
    return store, artifact, tables, artifact.read_json("files.json")


class TestTables:
    """References and tokens; the rules themselves are tested table by table in test_tables."""

    def test_sound_tables_pass(self, made):
        _, _, tables, _ = made
        assert broken_references(tables) == duplicate_tokens(tables) == []

    def test_a_dangling_token_is_named(self, made):
        tables = copy.deepcopy(made[2])
        row = tables["sample_data"][3]
        row["ego_pose_token"] = "nowhere"
        (problem,) = broken_references(tables)
        assert "1 value of ego_pose_token is in no row of ego_pose: " in problem
        assert row["token"] in problem
        assert duplicate_tokens(tables) == []

    def test_a_token_twice_is_named(self, made):
        tables = copy.deepcopy(made[2])
        tables["ego_pose"].append(dict(tables["ego_pose"][0]))
        (problem,) = duplicate_tokens(tables)
        assert tables["ego_pose"][0]["token"] in problem


class TestFiles:
    def find(self, made, *, sample_data=None, files=None):
        store, _, tables, listed = made
        return files_match(sample_data or tables["sample_data"], files or listed, store.artifact)

    def test_files_in_the_store_pass(self, made):
        finding = self.find(made)
        assert finding.passed
        assert finding.facts["files"] == len(made[2]["sample_data"])

    def test_a_row_without_file_and_a_file_without_row_are_named(self, made):
        first, *rest = made[3]
        assert self.find(made, files=rest).problems == [
            f"1 file of sample_data is in no artifact: {first['filename']}"
        ]
        row = next(row for row in made[2]["sample_data"] if row["filename"] == first["filename"])
        others = [other for other in made[2]["sample_data"] if other is not row]
        assert self.find(made, sample_data=others).problems == [
            f"1 listed file is not in sample_data: {first['filename']}"
        ]

    def test_removed_torn_and_collected_files_are_named(self, tmp_path):
        store = Store(tmp_path)
        artifact = make_tables(store, Drive(seconds=2.0)).artifact
        rows, files = artifact.read_json("sample_data.json"), artifact.read_json("files.json")
        removed, torn = (store.artifact(entry["artifact"]).path(entry["file"]) for entry in files[:2])
        removed.unlink()
        torn.write_bytes(b"x")
        gone, kept = files_match(rows, files, store.artifact).problems
        assert gone == f"1 file is not in the store: {files[0]['filename']}"
        assert kept.startswith(
            f"1 file does not have the size in its artifact's manifest: {files[1]['filename']} (1 bytes"
        )
        manifest = store.artifact(files[0]["artifact"]).folder / "manifest.json"
        manifest.unlink()
        problems = files_match(rows, files, store.artifact).problems
        assert len(problems) == 1
        assert "is not in the store" in problems[0]


SHORT = {"lacking_at_keyframes": {"keyframes": 4, "before_first": 0, "after_last": 0}}


def ten_hz(_channel):
    return T0 + np.arange(30) * (S // 10)


class TestScenes:
    @pytest.mark.parametrize(
        ("counts", "reason"),
        [
            (
                {"dropped_keyframes": 4, "channels": {"LIDAR_TOP": SHORT | {"span_ns": [T0, T0]}}},
                "4 of 4 keyframes were dropped, where a channel has no reading within 0.1 s",
            ),
            (
                {"remainder_s": 0.5},
                "its 0.5 s are shorter than scenes.min_length_s (1.5); set that to 0.49 for a scene",
            ),
            (
                {"remainder_s": 0.004},
                "its 0.004 s are shorter than scenes.min_length_s (1.5); set that to 0 for",
            ),
            (
                {"remainder_s": 2.4, "longest_remainder_s": 1.4},
                "its 1.4 s are shorter than scenes.min_length_s (1.5) (the longest stretch between pauses); set that to 1.39",
            ),
            ({"channels": {"LIDAR_TOP": {"without_pose": 3}}}, "the readings of LIDAR_TOP have no ego pose"),
            ({}, "LIDAR_TOP has too few readings for one of scenes.min_length_s (1.5); set that to 0"),
        ],
    )
    def test_a_recording_without_scene_says_why(self, counts, reason):
        none = {
            "scenes": 0,
            "samples": 0,
            "remainder_s": 0.0,
            "dropped_keyframes": 0,
            "channels": {"LIDAR_TOP": {}},
        }
        facts = {"reference": "LIDAR_TOP", "tolerance_s": 0.1, "counts": none | counts}
        (problem,) = scenes_made(facts, ten_hz, 1.5).problems
        assert problem.startswith("it has no scene: ")
        assert reason in problem

    def test_one_with_a_scene_passes(self):
        channels = {"LIDAR_TOP": {"span_ns": [T0, T0 + 10 * S]}}
        counts = {"scenes": 1, "samples": 4, "remainder_s": 0.0, "dropped_keyframes": 1, "channels": channels}
        assert scenes_made({"reference": "LIDAR_TOP", "counts": counts}, ten_hz, 1.5, 0.0).passed

    @pytest.mark.parametrize(
        ("remainders", "words"),
        [
            ({"remainder_s": 0.5}, ""),
            (
                {"remainder_s": 0.6},
                "0.6 s are in no scene, since scenes.min_length_s (1.5) is longer than that stretch; set it to 0.59 for a scene more",
            ),
            (
                {"remainder_s": 2.4, "longest_remainder_s": 1.4},
                "2.4 s are in no scene, since scenes.min_length_s (1.5) is longer than those stretches, up to 1.4 s long; set it to 1.39 for a scene more",
            ),
        ],
    )
    def test_stretches_too_short_for_a_scene_are_named_beside_one(self, remainders, words):
        channels = {"LIDAR_TOP": {"span_ns": [T0, T0 + 10 * S]}}
        counts = {"scenes": 1, "samples": 4, "dropped_keyframes": 0, "channels": channels} | remainders
        found = scenes_made({"reference": "LIDAR_TOP", "counts": counts}, ten_hz, 1.5, 0.05)
        assert "".join(found.problems) == words

    @pytest.mark.parametrize(
        ("span_s", "words"),
        [
            ((0, 29.9), ""),
            ((0.5, 29.5), ""),
            (
                (0, 10),
                (
                    "20.0 of 30.0 s are in no scene, since LIDAR_TOP, which decides where keyframes are, stops at 10.0 s, "
                    "2023-11-14T22:13:30.000Z; to use them, set `reference: CAM_FRONT` and `missing: allow` under scenes"
                ),
            ),
            (
                (2, 30),
                "2.0 of 30.0 s are in no scene, since LIDAR_TOP, which decides where keyframes are, starts at 2.0 s,",
            ),
            (
                (6, 20),
                (
                    "16.0 of 30.0 s are in no scene, since LIDAR_TOP, which decides where keyframes are, starts at 6.0 s, "
                    "2023-11-14T22:13:26.000Z and stops at 20.0 s, 2023-11-14T22:13:40.000Z;"
                ),
            ),
        ],
    )
    def test_a_reference_that_is_silent_for_long_is_named(self, span_s, words):
        spans = {
            "CAM_FRONT": [T0, T0 + 30 * S],
            "LIDAR_TOP": [T0 + int(s * S) for s in span_s],
            "RADAR_FRONT": [],
        }
        channels = {name: {"span_ns": span} for name, span in spans.items()}
        counts = {"scenes": 1, "samples": 4, "remainder_s": 0.0, "dropped_keyframes": 0, "channels": channels}
        (*problems,) = scenes_made({"reference": "LIDAR_TOP", "counts": counts}, ten_hz, 1.5, 0.05).problems
        assert (len(problems), " ".join(problems)[: len(words)]) == (int(bool(words)), words)

    def test_a_slow_reference_need_not_be_silent(self):
        spans = {"CAM_FRONT": [T0, T0 + 9 * S], "LIDAR_TOP": [T0 + S, T0 + 8 * S]}
        channels = {name: {"span_ns": span} for name, span in spans.items()}
        counts = {"scenes": 1, "samples": 4, "remainder_s": 0.0, "dropped_keyframes": 0, "channels": channels}
        facts = {"reference": "LIDAR_TOP", "counts": counts}
        assert scenes_made(facts, lambda _: T0 + S * np.arange(1, 9), 1.5, 0.05).passed


class TestKeyframes:
    def find(self, stamps_of=ten_hz, **counts):
        channels = {
            name: {
                "span_ns": [T0, T0 + 20 * S],
                "lacking_at_keyframes": dict.fromkeys(SHORT["lacking_at_keyframes"], 0),
            }
            for name in ("CAM_FRONT", "LIDAR_TOP", "RADAR_FRONT")
        }
        channels |= counts.pop("channels", {})
        none = {
            "scenes": 1,
            "samples": 24,
            "dropped_keyframes": 0,
            "lacking_samples": 0,
            "channels": channels,
        }
        return keyframes_complete({"tolerance_s": 0.1, "counts": none | counts}, stamps_of)

    def test_complete_ones_pass(self):
        finding = self.find()
        assert finding.passed
        assert finding.facts["lacking_at_keyframes"] == {}

    def test_a_channel_that_stops_is_named_with_time_and_cost(self):
        stops = {"keyframes": 16, "before_first": 0, "after_last": 15}
        late = {"keyframes": 1, "before_first": 1, "after_last": 0}
        (problem,) = self.find(
            dropped_keyframes=16,
            channels={
                "CAM_FRONT": {"span_ns": [T0, T0 + 12 * S], "lacking_at_keyframes": stops},
                "RADAR_FRONT": {"span_ns": [T0 + S // 2, T0 + 20 * S], "lacking_at_keyframes": late},
            },
        ).problems
        assert problem.startswith(
            "16 of 40 keyframes were dropped, where a channel has no reading within 0.1 s (scenes.tolerance_s): "
            "CAM_FRONT at 16 keyframes (15 after it stops at 12.0 s, 2023-11-14T22:13:32.000Z), "
            "RADAR_FRONT at 1 keyframe (1 before it starts at 0.5 s, 2023-11-14T22:13:20.500Z)"
        )
        assert "raise scenes.tolerance_s" in problem
        assert "`missing: allow`" in problem

    @pytest.mark.parametrize(
        ("missing_s", "words"), [(1.9, " "), (2.0, " "), (2.1, " (4 after it stops at 17.9 s, ")]
    )
    def test_a_slow_channel_stops_only_if_two_of_its_periods_are_missing(self, missing_s, words):
        short = {"lacking_at_keyframes": {"keyframes": 4, "before_first": 0, "after_last": 4}}
        ends_ns = T0 + 20 * S - round(missing_s * S)
        # Of its pauses one is long, so that their mean is no measure.
        stamps_ns = np.append(T0, ends_ns - np.arange(9, -1, -1) * S)
        camera = {"span_ns": [T0, ends_ns], **short}
        (problem,) = self.find(
            lambda _channel: stamps_ns, dropped_keyframes=4, channels={"CAM_FRONT": camera}
        ).problems
        assert f"CAM_FRONT at 4 keyframes{words}".rstrip() in problem
        assert ("stops" in problem) == ("stops" in words)

    @pytest.mark.parametrize(("late_s", "starts"), [(1.9, False), (2.1, True)])
    def test_nor_does_it_start_late_unless_two_of_its_periods_are_missing(self, late_s, starts):
        short = {"lacking_at_keyframes": {"keyframes": 4, "before_first": 4, "after_last": 0}}
        stamps_ns = T0 + round(late_s * S) + np.arange(10) * S
        camera = {"span_ns": [int(stamps_ns[0]), T0 + 20 * S], **short}
        (problem,) = self.find(
            lambda _channel: stamps_ns, dropped_keyframes=4, channels={"CAM_FRONT": camera}
        ).problems
        assert ("4 before it starts at 2.1 s" in problem) == starts
        assert ("starts" in problem) == starts

    def test_samples_that_were_allowed_to_lack_one_are_counted(self):
        short = {"span_ns": [T0, T0 + 20 * S], **SHORT}
        (problem,) = self.find(lacking_samples=4, channels={"CAM_FRONT": short}).problems
        assert problem == "4 of 24 samples lack a channel, as scenes.missing allows: CAM_FRONT at 4 keyframes"
