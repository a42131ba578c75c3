"""Runs the step `sweeps` on messages made by tests, and checks its counts each time."""

import json
from pathlib import Path
from types import MappingProxyType, SimpleNamespace

import numpy as np
import pyarrow.parquet as pq

from bagassets.assets.lidar_file import read_lidar_file
from bagassets.assets.sweeps import SWEEPS
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import LidarChannel, Rig
from bagassets.recordings.inventory import Inventory, TopicRecord
from bagassets.recordings.model import Definition
from bagassets.store.artifact import ArtifactWriter
from bagassets_tests.facts import MadeUpFacts, calibrated, use_of
from bagassets_tests.sweep_data import (
    VLP16_PACKET_NS,
    EthernetPacket,
    Messages,
    cloud,
    header,
    raw,
    velodyne_scan,
    vlp16_packets,
)

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 100_000_000
CLOUD = "sensor_msgs/msg/PointCloud2"
LASER = "sensor_msgs/msg/LaserScan"
SCAN = "velodyne_msgs/msg/VelodyneScan"
PACKET = "ethernet_msgs/msg/Packet"
MOUNT = {"translation": [1.0, 0.0, 2.0], "rotation": [1.0, 0.0, 0.0, 0.0]}


def inventory(msgtype, count=11, *, period_ns=PERIOD_NS, gaps=(), header_stamps=True):
    span = (count - 1) * period_ns + round(sum(gap.duration_s for gap in gaps) * 1e9)
    stamps = (START_NS, START_NS + span) if header_stamps else (None, None)
    fields = {
        "name": "/sensor", "msgtype": msgtype, "count": count, "bytes": 1, "digest": "d" * 64, "first_ns": START_NS + 5,
        "last_ns": START_NS + 5 + span, "first_stamp_ns": stamps[0], "last_stamp_ns": stamps[1], "rate_hz": 10.0,
        "max_gap_s": 0.1, "gaps": tuple(gaps), "gap_count": len(gaps), "header_offset_s": None, "unordered_stamps": 0,
        "frame_ids": ("lidar",), "packed": False, "problem": None, "definition": Definition("none", ""),
        "serialization": "cdr", "period_ns": period_ns if count > 1 else None,
    }  # fmt: skip
    names = TopicRecord.__dataclass_fields__
    record = TopicRecord(**{name: value for name, value in fields.items() if name in names})
    topics = MappingProxyType({"/sensor": record})
    return Inventory("mcap", 1, START_NS, START_NS + span, topics, None, None, ())


def request(channel, msgtype, clock="header", *, limit=0.01, mount=MOUNT, poses="p", **options):
    """What the sweeps of a channel read of a recording."""
    name = "LIDAR_TOP" if isinstance(channel, LidarChannel) else "RADAR_FRONT"
    rig = Rig(name="car", channels={name: channel}, ego_pose={"source": "fixed"})
    facts = MadeUpFacts(
        inventory(msgtype, **options),
        calibration=calibrated(**{name: {"ego_SE3_sensor": mount}}),
        artifacts={"ego_poses": SimpleNamespace(digest=poses)},
    )
    return use_of(SWEEPS, rig, facts, name, clock=clock, limits={"lost_messages": limit})


class Run:
    """The result of feeding messages to the step."""

    def __init__(self, folder, asked, messages, trajectory=None, recording=None):
        self.writer = ArtifactWriter(folder / "artifact")
        inputs = SimpleNamespace() if trajectory is None else SimpleNamespace(trajectory=trajectory)
        extractor = SWEEPS.extract(asked, inputs, recording or Messages(), self.writer, None)
        assert extractor.topics == asked.topics == ("/sensor",)
        for message in messages:
            extractor.add(message)
        self.summary = extractor.finish()
        self.files = folder / "artifact" / "files"
        self.digest = self.writer.finish(self.summary)
        self.channel = json.loads((self.files / "channel.json").read_text())
        self.index = pq.read_table(self.files / "index.parquet").to_pylist()
        counts, points = self.summary["counts"], self.summary["points"]
        assert counts["read"] == counts["written"] + counts["merged"] + sum(counts["lost"].values())
        assert points["read"] == points["written"] + sum(points["dropped"].values())
        assert counts["written"] == len(self.index)
        assert points["written"] == sum(row["points"] for row in self.index)
        assert self.channel["counts"] == counts
        assert self.summary["bytes"] == sum(row["size"] for row in self.index)

    @property
    def lost(self):
        return self.summary["counts"]["lost"]

    def points(self, row=0):
        return read_lidar_file(self.files / self.index[row]["file"])


class Runner:
    """Runs the step, each time in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.number = 0

    def __call__(self, asked, messages, trajectory=None, recording=None):
        self.number += 1
        folder = self.folder / str(self.number)
        folder.mkdir()
        return Run(folder, asked, messages, trajectory, recording)


def lidar(**fields):
    return LidarChannel(topic="/sensor", **fields)


def clouds(number, msgtype=CLOUD, *, log_delay_ns=7_000_000, **columns):
    for index in range(number):
        stamp = START_NS + index * PERIOD_NS
        xyz = {axis: np.arange(1, 5, dtype=np.float32) + index for axis in "xyz"}
        yield raw(cloud(stamp, xyz | columns), msgtype, stamp + log_delay_ns)


def scans(turns, *, per_message=50, packet_ns=VLP16_PACKET_NS, **options):
    packets = vlp16_packets(turns, **options)
    for first in range(0, len(packets), per_message):
        start = START_NS + first * packet_ns
        part = packets[first : first + per_message]
        log_time = start + len(part) * packet_ns
        yield raw(velodyne_scan(part, start, packet_ns), SCAN, log_time)


def singles(turns, **options):
    for number, packet in enumerate(vlp16_packets(turns, **options)):
        stamp = START_NS + number * VLP16_PACKET_NS
        payload = np.frombuffer(packet.tobytes(), np.uint8)
        yield raw(EthernetPacket(header(stamp), payload), PACKET, stamp + 3_000_000)


def driving(speed, *, start_ns=START_NS - PERIOD_NS, seconds=1.5):
    stamps = start_ns + np.arange(round(seconds * 50)) * 20_000_000
    positions = np.zeros((len(stamps), 3))
    positions[:, 0] = (stamps - START_NS) * 1e-9 * speed
    rotations = np.tile([1.0, 0, 0, 0], (len(stamps), 1))
    return Trajectory(stamps, positions, rotations, max_gap_ns=500_000_000, extrapolate_ns=0)
