"""What the velocities of a radar are, from its first minute: found from what stands still, and left open where traffic would do."""

from dataclasses import dataclass

import numpy as np
import pytest

from bagassets.geometry.se3 import SE3
from bagassets.propose.proposal import propose_recipe
from bagassets.propose.radar_velocities import velocities_of
from bagassets.propose.summary import RecordingSummary, TopicSummary
from bagassets.sample.messages import Messages
from bagassets_tests.plugin_install import Site
from bagassets_tests.sweep_data import Messages as Stub
from bagassets_tests.sweep_data import cloud, raw

pytestmark = pytest.mark.once

START_NS, MS = 1_750_000_000_000_000_000, 1_000_000
CLOUD, SCAN = "sensor_msgs/msg/PointCloud2", "radar_msgs/msg/RadarScan"
MOUNT_YAW = -1.2
MAKE = Messages(ros1=False)


class Topic:
    def __init__(self, msgtype):
        self.msgtype = msgtype


class Drive(Stub):
    """A recording of a straight drive: a radar with a yaw that nobody knows, and one source of poses."""

    def __init__(
        self, scenes, speed=10.0, *, still_s=0.0, seconds=4.0, source="odometry", msgtype=CLOUD, extra=()
    ):
        self.topics = {"/radar": Topic(msgtype), "/ego": Topic(SOURCES[source][0])}
        self.taken = 0
        self._messages = list(extra)
        for step in range(round(seconds * 50)):
            now_ns = START_NS + step * 20 * MS
            moving_s = max(0.0, step / 50 - still_s)
            self._messages.append(
                raw(SOURCES[source][1](now_ns, moving_s * speed), SOURCES[source][0], now_ns, "/ego")
            )
            if step % 3 == 0:
                columns = scenes(speed if moving_s else 0.0)
                self._messages.append(raw(cloud(now_ns, columns, "radar"), msgtype, now_ns + MS, "/radar"))
        self._messages.sort(key=lambda one: one.log_time_ns)

    def messages(self, topics):
        for one in self._messages:
            if one.topic in topics:
                self.taken += 1
                yield one


def fix(stamp_ns, x_m):
    return MAKE.fix(stamp_ns, "gnss", 48.0 + np.degrees(x_m / 6_367_000), 11.0, 500.0)


def transforms(stamp_ns, x_m):
    wheel = SE3((1.0, 0.0, 0.0, 0.0), (0.0, 0.01 * (stamp_ns % 3), 0.0))
    moved = SE3((1.0, 0.0, 0.0, 0.0), (x_m, 0.0, 0.0))
    return MAKE.transforms(stamp_ns, "odom", [("wheel", wheel), ("base_link", moved)])


SOURCES = {
    "odometry": (
        "nav_msgs/msg/Odometry",
        lambda t, x: MAKE.odometry(t, SE3((1.0, 0, 0, 0), (x, 0.0, 0.0)), 0.0, 0.0),
    ),
    "fixes": ("sensor_msgs/msg/NavSatFix", fix),
    "transforms": ("tf2_msgs/msg/TFMessage", transforms),
}
DICE = np.random.default_rng(8)


def targets(still, moving_mps, speed, *, relative, suffix=""):
    """Columns of a radar message; velocities over ground along the road, for those that move."""
    along = np.concatenate([np.zeros(still), np.asarray(moving_mps, dtype=float)])
    road = np.array([np.cos(MOUNT_YAW), -np.sin(MOUNT_YAW)])  # the direction of travel, as the radar sees it
    velocities = (along - (speed if relative else 0.0))[:, None] * road + DICE.normal(
        0, 0.05, (len(along), 2)
    )
    angles, distances = DICE.uniform(-1.0, 1.0, len(along)), DICE.uniform(8.0, 60.0, len(along))
    told = {"x": distances * np.cos(angles), "y": distances * np.sin(angles), "z": np.zeros(len(along))}
    return told | {f"vx{suffix}": velocities[:, 0], f"vy{suffix}": velocities[:, 1]}


def street(relative):
    return lambda speed: targets(14, [9.0, 10.5, -12.0], speed, relative=relative)


def decided(drive, movers=("/ego",)):
    return velocities_of(drive, ["/radar"], movers)


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("relative", [True, False])
def test_most_things_stand_still(relative, source):
    expected = "relative" if relative else "over_ground"
    assert decided(Drive(street(relative), source=source)) == {"/radar": expected}


def test_a_vehicle_that_stands_first_is_waited_for():
    assert decided(Drive(street(True), still_s=5.0, seconds=9.0)) == {"/radar": "relative"}


def test_no_more_is_read_than_needed():
    drive = Drive(street(True), seconds=30.0)
    decided(drive)
    assert drive.taken < 250


@pytest.mark.parametrize("relative", [True, False])
def test_a_column_around_the_car_decides_nothing(relative):
    """Relative to the radar it would stand still, over ground it would look like things that stand, seen from the car."""

    def column(speed):
        return targets(5, speed + DICE.normal(0, 1.0, 10), speed, relative=relative)

    assert decided(Drive(column)) == {"/radar": "undecided"}


@pytest.mark.parametrize("speed", [0.0, 0.8])
def test_without_motion_nothing_is_decided(speed):
    assert decided(Drive(street(True), speed)) == {"/radar": "undecided"}


def test_without_poses_nothing_is_decided_and_little_read():
    drive = Drive(street(True), seconds=30.0)
    assert decided(drive, ()) == {"/radar": "undecided"}
    assert drive.taken < 25


def test_few_targets_decide_nothing():
    assert decided(Drive(lambda speed: targets(3, [], speed, relative=True))) == {"/radar": "undecided"}


@pytest.mark.parametrize(
    ("scenes", "msgtype"),
    [
        (
            lambda speed: (
                targets(9, [], speed, relative=True) | targets(9, [], 0.0, relative=False, suffix="_comp")
            ),
            CLOUD,
        ),
        (lambda _: {axis: np.ones(5) for axis in "xyz"}, CLOUD),
        (lambda speed: targets(0, [], speed, relative=True), CLOUD),
        (street(True), SCAN),
    ],
    ids=["compensated", "no velocities", "no targets", "defined"],
)
def test_where_there_is_nothing_to_decide_nothing_is_said(scenes, msgtype):
    assert decided(Drive(scenes, msgtype=msgtype)) == {}


@dataclass
class Place:
    stamp_ns: int
    x_m: float


ACME = """
from bagassets.decode.model import PoseReading
from bagassets.geometry.se3 import SE3

def pose(message):
    return PoseReading(message.stamp_ns, "map", "base_link", SE3((1.0, 0.0, 0.0, 0.0), (message.x_m, 0.0, 0.0)))
"""


def test_poses_may_come_from_a_plug_in(tmp_path, monkeypatch):
    site = Site(monkeypatch, tmp_path / "site")
    site.install("acme", "1.0", ACME, pose__acme_msgs__Ego="pose")
    monkeypatch.setitem(SOURCES, "plug-in", ("acme_msgs/msg/Ego", Place))
    assert decided(Drive(street(True), source="plug-in")) == {"/radar": "relative"}
    site.close()


def test_a_message_that_cannot_be_decoded_is_passed_over():
    damaged = raw(cloud(START_NS, {"x": np.ones(2)}), CLOUD, START_NS, "/radar")
    assert decided(Drive(street(True), extra=[damaged])) == {"/radar": "relative"}


@pytest.mark.parametrize(
    ("said", "written"),
    [
        ((), None), (("relative",), "velocities: relative "), (("undecided", "over_ground"), "velocities: over_ground "),
        (("relative", "relative"), "velocities: relative "), (("relative", "over_ground"), "velocities:\n"),
        (("undecided",), "velocities:\n"),
    ],
)  # fmt: skip
def test_recordings_of_a_rig_are_taken_together(said, written):
    odometry = TopicSummary("/odom", "nav_msgs/msg/Odometry", 9, child_frames=("base_link",))
    for order in (said, said[::-1]):
        summaries = {
            "none.bag": RecordingSummary({"/radar": TopicSummary("/radar", CLOUD, 9), "/odom": odometry})
        }
        for number, what in enumerate(order):
            radar = TopicSummary("/radar", CLOUD, 9, velocities=frozenset({what}))
            summaries[f"{number}.bag"] = RecordingSummary({"/radar": radar, "/odom": odometry})
        text = propose_recipe(summaries, name="yard", root="/bags").text
        assert (written in text) if written else ("velocities" not in text)


def test_a_rig_without_poses_is_asked_for_them_first():
    radar = TopicSummary("/radar", CLOUD, 9, velocities=frozenset({"undecided"}))
    proposal = propose_recipe({"a.bag": RecordingSummary({"/radar": radar})}, name="yard", root="/bags")
    assert "velocities" not in proposal.text
