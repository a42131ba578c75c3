"""Artifacts made by hand, as the steps before `nuscenes_tables` leave them: a small drive with known truth.

The ego frame drives along a curve; two cars (one parked, one moving) and a pedestrian are around.
Lidar points lie on the objects and on the ground.
"""

from dataclasses import dataclass, field
from functools import partial

import cv2
import numpy as np
import pyarrow as pa

from bagassets.assets.boxes.table import BoxTable
from bagassets.assets.lidar_file import lidar_bytes
from bagassets.assets.radar_file import radar_bytes
from bagassets.engine.run_action import run_action
from bagassets.formats.nuscenes.settings import AttributesByMotion
from bagassets.formats.nuscenes.tables import NUSCENES_TABLES
from bagassets.geometry.se3 import SE3
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import Recipe, Rig, Scenes
from bagassets.store.action import Step
from bagassets.store.canonical import digest_bytes
from bagassets.store.store import Store
from bagassets_tests.facts import MadeUpInputs, calibrated

S = 1_000_000_000
T0 = 1_700_000_000 * S + 123_456_789
IMAGE = (64, 48)
K = [[40.0, 0.0, 32.0], [0.0, 40.0, 24.0], [0.0, 0.0, 1.0]]

# ego <- camera: x right, y down, z forward, looking along ego x, and along ego -x.
FORWARD = (0.5, -0.5, 0.5, -0.5)
BACKWARD = (0.5, -0.5, -0.5, 0.5)
EXTRINSICS = {
    "CAM_FRONT": {"translation": [1.5, 0.0, 1.5], "rotation": list(FORWARD)},
    "CAM_BACK": {"translation": [-1.0, 0.0, 1.5], "rotation": list(BACKWARD)},
    "LIDAR_TOP": {"translation": [0.9, 0.0, 1.8], "rotation": [0.5**0.5, 0.0, 0.0, 0.5**0.5]},
    "RADAR_FRONT": {"translation": [3.4, 0.0, 0.5], "rotation": [1.0, 0.0, 0.0, 0.0]},
}
MODALITY = {"CAM_FRONT": "camera", "CAM_BACK": "camera", "LIDAR_TOP": "lidar", "RADAR_FRONT": "radar"}
SIZES = {"parked": (1.9, 4.5, 1.6), "moving": (2.0, 4.8, 1.7), "walker": (0.7, 0.6, 1.8)}
CATEGORY = {"parked": "vehicle.car", "moving": "vehicle.car", "walker": "human.pedestrian.adult"}
ATTRIBUTES = {"parked": ["vehicle.parked"], "moving": ["vehicle.moving"], "walker": []}


def ego_pose(t):
    """`global_SE3_ego` at t seconds: a circle of radius 50 m at 5 m/s."""
    angle = 5.0 * t / 50.0
    return SE3.create(
        (np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)), (50 * np.sin(angle), 50 * (1 - np.cos(angle)), 0.0)
    )


def object_pose(name, t):
    """`global_SE3_object` at t seconds."""
    if name == "parked":
        return SE3.create((np.cos(0.2), 0, 0, np.sin(0.2)), (14.0, 6.0, 0.8))
    if name == "moving":
        return SE3.create((1.0, 0, 0, 0), (10.0 + 4.0 * t, -4.0, 0.85))
    return SE3.create((np.cos(0.1 * t), 0, 0, np.sin(0.1 * t)), (8.0, 3.0 - 1.0 * t, 0.9))


@dataclass
class Drive:
    """A drive; `stamps` may be replaced channel by channel, in nanoseconds."""

    seconds: float = 4.0
    box_hz: float = 10.0
    channels: tuple[str, ...] = tuple(MODALITY)
    seed: int = 0
    stamps: dict = field(default_factory=dict)
    box_phase_s: float = 0.0
    boxes: bool = True
    origin: dict | None = None
    pose_seconds: tuple[float, float] = (-1.0, 1.0)

    def __post_init__(self):
        rates = {
            "CAM_FRONT": (12, 0.013),
            "CAM_BACK": (12, 0.021),
            "LIDAR_TOP": (10, 0.0),
            "RADAR_FRONT": (13, 0.004),
        }
        for channel in self.channels:
            hz, phase = rates[channel]
            if channel not in self.stamps:
                self.stamps[channel] = regular(hz, self.seconds, phase)


def regular(hz, seconds, phase_s=0.0):
    return T0 + np.round((phase_s + np.arange(round(hz * seconds)) / hz) * S).astype(np.int64)


def seconds_of(stamp_ns):
    return (int(stamp_ns) - T0) / S


def rig(channels=tuple(MODALITY), name="test_rig"):
    return Rig.model_validate(
        {
            "name": name,
            "vehicle": "van",
            "location": "yard",
            "channels": {c: {"modality": MODALITY[c], "topic": f"/{c.lower()}"} for c in channels},
            "ego_pose": {"source": "odometry", "topic": "/odom"},
        }
    )


def trajectory(drive):
    times = np.arange(drive.pose_seconds[0], drive.seconds + drive.pose_seconds[1], 0.05)
    poses = [ego_pose(t) for t in times]
    return Trajectory(
        T0 + np.round(times * S).astype(np.int64),
        np.array([pose.translation for pose in poses]),
        np.array([pose.rotation for pose in poses]),
        S // 2,
        S // 20,
    )


def surface_points(name, t, rng, number=60, shrink=1.0):
    """Points just inside the faces of an object, or of one that is smaller, in the global frame."""
    width, length, height = SIZES[name]
    unit = rng.uniform(-0.49, 0.49, (number, 3))
    unit[np.arange(number), rng.integers(0, 3, number)] = 0.49 * rng.choice([-1, 1], number)
    return object_pose(name, t).transform_points(unit * [length, width, height] * shrink)


def _artifact(store, action, write):
    def make(out):
        write(out)
        return {}

    return run_action(store, Step("handmade", 1).action(action, {}), make).artifact


def channel_artifact(store, drive, channel):
    modality = MODALITY[channel]
    stamps = drive.stamps[channel]

    def content(stamp):
        t = seconds_of(stamp)
        rng = np.random.default_rng([drive.seed, int(stamp)])
        if modality == "camera":
            width, height = IMAGE
            image = rng.integers(0, 255, (height // 8, width // 8, 3), dtype=np.uint8)
            return ".jpg", cv2.imencode(".jpg", cv2.resize(image, IMAGE))[1].tobytes()
        global_SE3_sensor = ego_pose(t) @ SE3.create(
            EXTRINSICS[channel]["rotation"], EXTRINSICS[channel]["translation"]
        )
        # Radar does not fire when the lidar does: its targets lie well inside the moving objects.
        number, shrink = (60, 1.0) if modality == "lidar" else (4, 0.5)
        hits = np.concatenate([surface_points(name, t, rng, number, shrink) for name in SIZES])
        points = global_SE3_sensor.inverse().transform_points(hits)
        if modality == "radar":
            return ".pcd", radar_bytes({axis: points[:, i] for i, axis in enumerate("xyz")})
        ground = np.column_stack([rng.uniform(-30, 30, (200, 2)), np.full(200, -1.85)])
        cloud = np.concatenate([points, ground])
        extra = np.column_stack([rng.uniform(0, 255, len(cloud)), np.arange(len(cloud)) % 16])
        return ".pcd.bin", bytes(lidar_bytes(np.column_stack([cloud, extra]).astype(np.float32)))

    def write(out):
        rows = []
        for stamp in stamps.tolist():
            extension, data = content(stamp)
            name = f"{stamp}{extension}"
            out.write(name, data)
            rows.append((stamp, stamp + 5_000_000, name, len(data), digest_bytes(data)))
        columns = (
            dict(
                zip(
                    ("stamp_ns", "log_time_ns", "file", "size", "digest"),
                    map(list, zip(*rows, strict=True)),
                    strict=True,
                )
            )
            if rows
            else {}
        )
        schema = [
            ("stamp_ns", pa.int64()),
            ("log_time_ns", pa.int64()),
            ("file", pa.string()),
            ("size", pa.int64()),
            ("digest", pa.string()),
        ]
        if modality == "camera":
            schema += [("width", pa.int32()), ("height", pa.int32())]
            columns |= {"width": [IMAGE[0]] * len(rows), "height": [IMAGE[1]] * len(rows)}
        out.write_table(
            "index.parquet", pa.table({name: pa.array(columns.get(name, []), kind) for name, kind in schema})
        )
        out.write_json(
            "channel.json",
            {
                "channel": channel,
                "modality": modality,
                "topic": f"/{channel.lower()}",
                "frame_id": channel.lower(),
                "fileformat": "jpg" if modality == "camera" else "pcd",
                "camera_intrinsic": K if modality == "camera" else [],
                "counts": {"read": len(rows), "written": len(rows), "merged": 0, "lost": {}},
            },
        )

    action = {"channel": channel, "stamps": stamps.tolist(), "seed": drive.seed}
    return _artifact(store, action, write)


def box_artifact(store, table):
    def write(out):
        out.write_table("annotations.parquet", table.to_arrow())

    key = [table.stamps_ns.tolist(), list(table.tracks), table.centers_m.tolist(), list(table.categories)]
    key.append([list(names) for names in table.attributes])
    return _artifact(store, {"boxes": key}, write)


def true_boxes(drive, hz=None, phase_s=None):
    hz, phase_s = hz or drive.box_hz, drive.box_phase_s if phase_s is None else phase_s
    times = np.arange(-0.5 + phase_s, drive.seconds + 0.5, 1 / hz) if drive.boxes else []
    rows = [(t, name) for t in times for name in sorted(SIZES)]
    poses = [object_pose(name, t) for t, name in rows]
    return BoxTable(
        stamps_ns=np.array([T0 + round(t * S) for t, _ in rows], dtype=np.int64),
        tracks=[name for _, name in rows],
        categories=[CATEGORY[name] for _, name in rows],
        attributes=[ATTRIBUTES[name] for _, name in rows],
        centers_m=np.array([pose.translation for pose in poses]).reshape(-1, 3),
        rotations=np.array([pose.rotation for pose in poses]).reshape(-1, 4),
        sizes_m=np.array([SIZES[name] for _, name in rows]).reshape(-1, 3),
        scores=np.ones(len(rows)),
        sources=["/boxes"] * len(rows),
    )


@dataclass
class Made:
    """The tables of a drive."""

    artifact: object
    use: object

    def table(self, name):
        return self.artifact.read_json(f"{name}.json")

    @property
    def facts(self):
        return self.artifact.read_json("facts.json")


def make_tables(
    store: Store,
    drive: Drive | None = None,
    *,
    key="drive_1",
    table=None,
    the_rig=None,
    poses=None,
    attributes=None,
    **scenes,
) -> Made:
    """Run the step on a drive."""
    drive = drive or Drive()
    channels = {channel: channel_artifact(store, drive, channel) for channel in drive.channels}
    boxes = box_artifact(store, true_boxes(drive) if table is None else table)
    ego_poses = _artifact(
        store,
        {"poses": drive.seconds, "origin": drive.origin},
        lambda out: out.write_json("ego_poses.json", {"origin": drive.origin, "global_frame": "odom"}),
    )
    inputs = MadeUpInputs(
        key=key,
        calibration=calibrated(**{name: {"ego_SE3_sensor": EXTRINSICS[name]} for name in drive.channels}),
        artifacts={"ego_poses": ego_poses, "annotations": boxes},
        parts={"frames": channels},
        trajectory=poses or trajectory(drive),
    )
    the_rig = the_rig or rig(drive.channels)
    recipe = Recipe(
        name="test",
        bags={"root": "bags"},
        rigs=[the_rig],
        scenes=Scenes(**scenes),
        nuscenes={"attributes_by_motion": attributes or AttributesByMotion()},
    )
    use = NUSCENES_TABLES.use(NUSCENES_TABLES.params(recipe, the_rig), inputs)[""]
    outcome = run_action(store, NUSCENES_TABLES.action(use, None), partial(NUSCENES_TABLES.make, use, inputs))
    return Made(outcome.artifact, use)
