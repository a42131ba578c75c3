"""A small drive whose every number is an integer or a binary fraction, and the digests of its artifacts.

No sine, no random number, no image of a library goes into it: what a step makes of it depends on the
step alone, and on the libraries that the step names. `python -m bagassets_tests.golden_drive` writes
the digests anew (see `test_golden`).
"""

import json
import sys
import tempfile
from importlib.metadata import version
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bagassets.formats.catalogue import OUR_ASSETS
from bagassets.geometry.camera import CameraModel
from bagassets.geometry.se3 import SE3
from bagassets.geometry.undistortion import Undistortion
from bagassets.recipe import load_recipe
from bagassets.recipe.format_settings import OUR_FORMATS
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.store.canonical import digest_bytes
from bagassets.store.store import Store
from bagassets_tests.ncom_data import ETHERNET, ethernet, ncom
from bagassets_tests.pose_data import IMU, NAVSAT, fix, imu
from bagassets_tests.posed import Posed
from bagassets_tests.recording_build import UPSTREAM, RecordingBuild

GOLDEN = Path(__file__).with_name("golden.json")
STEPS = {asset.name: asset.step for asset in OUR_ASSETS}
START_NS = 1_700_000_000_000_000_000
MS = 1_000_000
WIDTH, HEIGHT = 48, 32
OPTICAL = (0.5, -0.5, 0.5, -0.5)
# Lenses of which some pixels lie just between two places of the maps, where the last bit decides; the small images
# of the drive have no such pixel. Name: (width, height, focal length, coefficients, focal length of the image written).
LENSES = {
    "plumb_bob": (1600, 900, 1000.0, (-0.2, 0.0, 0.0, 0.0, 0.0), 1000.0),
    "plumb_bob at 640x480": (640, 480, 1000.0, (-0.2, 0.0, 0.0, 0.0, 0.0), 1000.0),
    "plumb_bob onto another": (1280, 720, 800.0, (-0.2, 0.0, 0.0, 0.0), 640.0),  # OpenCV's float maps differ, too
    "plumb_bob at 640x360": (640, 360, 320.0, (-0.25, 0.0625, 0.0, 0.0), 160.0),
    "rational_polynomial": (640, 480, 400.0, (0.5, 0.25, 0.0, 0.0, 0.0, 0.75, 0.125, 0.0), 320.0),
    "rational_polynomial, tilted": (
        640, 480, 400.0, (-0.2, 0.0, 0.001, -0.002, 0.0, 0.0, 0.0, 0.0, 0.003, -0.001, -0.002, 0.001, 0.03, -0.02), 400.0,
    ),
    "equidistant": (640, 480, 250.0, (0.03125, -0.0078125, 0.0, 0.0), 250.0),
    "equidistant onto another": (1280, 720, 400.0, (0.0, 0.0, 0.0, 0.0), 200.0),
}  # fmt: skip

RECIPE = """
name: golden
bags: {root: bags, settle_s: 0}
nuscenes: {}
vision: {frames: 4, trajectories: ["CAM_FRONT:global"]}
preview: {columns: 3, width: 640}
lerobot:
  fps: 10
  features:
    observation.state: {signals: [motion], at: linear}
    action: {next_of: observation.state}
    observation.images.front: {camera: CAM_FRONT, tolerance_s: 1.0}
scenes: {min_length_s: 0}
rigs:
  - name: car
    ego_pose: {source: odometry, topic: /odom}
    annotations: [{topic: /boxes}]
    channels:
      CAM_FRONT: {modality: camera, topic: /front/image_raw}
      CAM_BACK: {modality: camera, topic: /back/image_raw, output: png, target: {fx: 30, fy: 30, cx: 24, cy: 16}}
      LIDAR_TOP: {modality: lidar, topic: /points, deskew: true}
      RADAR_FRONT: {modality: radar, topic: /radar}
    signals:
      motion: {topic: /odom, field: [pose.pose.position, twist.twist.linear.x], names: [x, y, z, v], unit: m}
"""
RECIPE += "".join(f"{name}: {{}}\n" for name in OUR_FORMATS if f"\n{name}:" not in RECIPE)


def unit(*numbers):
    length = sqrt(sum(n * n for n in numbers))
    return tuple(n / length for n in numbers)


def global_SE3_ego(i):
    """The pose after i twentieths of a second."""
    return SE3(unit(64.0, 0.0, 0.0, float(i)), (i * 0.375, i * i / 256, 0.0))


class Bag:
    """Makes the messages of the drive and writes them as ROS 1."""

    def __init__(self):
        self.store = get_typestore(Stores.ROS1_NOETIC)
        text = "geometry_msgs/TransformStamped[] transforms\n"
        self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))

    def make(self, name, *values):
        package, kind = name.split("/")
        return self.store.types[f"{package}/msg/{kind}"](*values)

    def header(self, stamp_ns, frame):
        time = self.make("builtin_interfaces/Time", stamp_ns // 10**9, stamp_ns % 10**9)
        return self.make("std_msgs/Header", 0, time, frame)

    def quaternion(self, value):
        w, x, y, z = value.rotation
        return self.make("geometry_msgs/Quaternion", x, y, z, w)

    def pose(self, value):
        point = self.make("geometry_msgs/Point", *value.translation)
        return self.make("geometry_msgs/Pose", point, self.quaternion(value))

    def static(self, stamp_ns):
        mounts = {
            "front": SE3(OPTICAL, (1.5, 0.0, 1.25)),
            "back": SE3((0.5, -0.5, -0.5, 0.5), (-1.0, 0.0, 1.25)),
            "lidar": SE3(unit(8.0, 0.0, 0.0, 1.0), (0.5, 0.0, 1.75)),
            "radar": SE3((1.0, 0.0, 0.0, 0.0), (3.5, 0.0, 0.5)),
        }
        edges = []
        for child, mount in mounts.items():
            translation = self.make("geometry_msgs/Vector3", *mount.translation)
            moved = self.make("geometry_msgs/Transform", translation, self.quaternion(mount))
            header = self.header(stamp_ns, "base_link")
            edges.append(self.make("geometry_msgs/TransformStamped", header, child, moved))
        return self.make("tf2_msgs/TFMessage", edges)

    def odometry(self, stamp_ns, i):
        vector = self.make("geometry_msgs/Vector3", 0.0, 0.0, 0.0)
        twist = self.make("geometry_msgs/Twist", vector, vector)
        zeros = np.zeros(36)
        return self.make(
            "nav_msgs/Odometry", self.header(stamp_ns, "odom"), "base_link",
            self.make("geometry_msgs/PoseWithCovariance", self.pose(global_SE3_ego(i)), zeros),
            self.make("geometry_msgs/TwistWithCovariance", twist, zeros),
        )  # fmt: skip

    def image(self, stamp_ns, frame, encoding, i):
        rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
        grey = (rows * 5 + columns * 3 + i * 7) % 256
        pixels = grey.astype(np.uint8) if encoding != "mono16" else (grey * 257).astype("<u2")
        data = pixels.reshape(-1).view(np.uint8)
        header = self.header(stamp_ns, frame)
        return self.make("sensor_msgs/Image", header, HEIGHT, WIDTH, encoding, 0, len(data) // HEIGHT, data)

    def camera_info(self, stamp_ns, frame, model, d):
        k = np.array([40.0, 0, 24.5, 0, 40, 15.5, 0, 0, 1])
        roi = self.make("sensor_msgs/RegionOfInterest", 0, 0, 0, 0, False)
        return self.make(
            "sensor_msgs/CameraInfo", self.header(stamp_ns, frame), HEIGHT, WIDTH, model, np.array(d), k,
            np.eye(3).reshape(-1), np.zeros(12), 0, 0, roi,
        )  # fmt: skip

    def cloud(self, stamp_ns, frame, columns):
        fields = [self.make("sensor_msgs/PointField", name, 4 * n, 7, 1) for n, name in enumerate(columns)]
        points = np.stack(list(columns.values()), axis=1).astype("<f4")
        step = 4 * len(columns)
        return self.make(
            "sensor_msgs/PointCloud2", self.header(stamp_ns, frame), 1, len(points), fields, False, step,
            step * len(points), points.reshape(-1).view(np.uint8), True,
        )  # fmt: skip

    def points(self, stamp_ns):
        n = np.arange(240)
        xyz = {"x": (n % 16 - 8) * 1.5, "y": (n // 16 - 7) * 1.25, "z": (n % 8) / 8 - 1.5}
        more = {"intensity": n % 101, "ring": n % 8, "time": n / 4096}
        return self.cloud(stamp_ns, "lidar", xyz | more)

    def targets(self, stamp_ns):
        n = np.arange(6)
        return self.cloud(
            stamp_ns,
            "radar",
            {"x": 4.0 + n, "y": n * 0.5 - 1, "z": n * 0, "vx": n * 0.25, "vy": n * -0.5, "rcs": n},
        )

    def boxes(self, stamp_ns, i):
        header = self.header(stamp_ns, "odom")
        nothing = self.make("std_msgs/ColorRGBA", 0.0, 0.0, 0.0, 1.0)
        scale = self.make("geometry_msgs/Vector3", 4.5, 1.75, 1.5)
        lifetime = self.make("builtin_interfaces/Duration", 0, 0)
        markers = []
        for number, pose in enumerate(
            (SE3(unit(3.0, 0, 0, 1.0), (9.0, 4.0, 0.75)), SE3((1.0, 0, 0, 0), (8.0 + i / 8, -3.0, 0.75)))
        ):
            markers.append(
                self.make(
                    "visualization_msgs/Marker", header, "car", number, 1, 0, self.pose(pose), scale, nothing,
                    lifetime, False, [], [], "", "", False,
                )
            )  # fmt: skip
        return self.make("visualization_msgs/MarkerArray", markers)

    def entries(self):
        """Yield (stamp, topic, type, message) of two seconds."""
        yield START_NS, "/tf_static", "tf2_msgs/TFMessage", self.static(START_NS)
        info = "sensor_msgs/CameraInfo"
        front, back = (-0.25, 0.0625, 0.001953125, -0.0009765625, 0.0), (0.03125, -0.0078125, 0.0, 0.0)
        yield START_NS, "/front/camera_info", info, self.camera_info(START_NS, "front", "plumb_bob", front)
        yield START_NS, "/back/camera_info", info, self.camera_info(START_NS, "back", "equidistant", back)
        for i in range(41):
            stamp = START_NS + i * 50 * MS
            yield stamp, "/odom", "nav_msgs/Odometry", self.odometry(stamp, i)
        for i in range(18):
            stamp = START_NS + 70 * MS + i * 100 * MS
            image, cloud = "sensor_msgs/Image", "sensor_msgs/PointCloud2"
            yield stamp, "/front/image_raw", image, self.image(stamp, "front", "bayer_rggb8", i)
            yield stamp + 5 * MS, "/back/image_raw", image, self.image(stamp + 5 * MS, "back", "mono16", i)
            yield stamp + 11 * MS, "/points", cloud, self.points(stamp + 11 * MS)
            yield stamp + 13 * MS, "/radar", cloud, self.targets(stamp + 13 * MS)
            stamp += 2 * MS
            yield stamp, "/boxes", "visualization_msgs/MarkerArray", self.boxes(stamp, i)

    def write(self, path):
        with Writer(path) as writer:
            connections = {}
            for stamp_ns, topic, kind, message in sorted(self.entries(), key=lambda entry: entry[0]):
                msgtype = kind.replace("/", "/msg/")
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, msgtype, typestore=self.store)
                data = self.store.serialize_ros1(message, msgtype)
                writer.write(connections[topic], stamp_ns + 3 * MS, data)


def made_digests(folder: Path) -> dict[str, str]:
    """Build the drive in `folder`; return what was made -> digest. Names begin with that of the step."""
    (folder / "bags").mkdir(parents=True)
    Bag().write(folder / "bags" / "drive.bag")
    (folder / "recipe.yaml").write_text(RECIPE)
    recipe = load_recipe(folder / "recipe.yaml")
    (recording,) = discover(recipe.bags).recordings.values()
    store = Store(recipe.store_path)
    build = RecordingBuild(
        recipe, store, recording, recording_digest(recording).digest, recording_stat(recording)
    )
    digests = {}
    for result in build.build():
        if result.asset not in ("frames", "sweeps"):
            digests[result.asset] = result.artifact.digest
            continue
        for channel, entry in result.artifact.read_json("channels.json").items():
            digests[f"{result.asset} of {channel}"] = entry["artifact"]
    return digests | other_poses(folder) | other_lenses()


def other_lenses() -> dict[str, str]:
    """Images of larger cameras, undistorted; neighbouring pixels differ by far more than one."""
    digests = {}
    for name, (width, height, focal, coefficients, onto) in LENSES.items():
        camera = CameraModel(
            name.split()[0].rstrip(","), width, height, focal, focal, width / 2, height / 2, coefficients
        )
        written = camera.undistorted((onto, onto, width / 2, height / 2))
        rows, columns = np.mgrid[0:height, 0:width]
        pixels = (rows * 101 + columns * 67 + rows * columns * 29) % 256
        image = pixels[..., np.newaxis] + [0, 80, 160]
        digests[f"frames of {name}"] = digest_bytes(
            Undistortion(camera, written)(image.astype(np.uint8)).tobytes()
        )
    return digests


def other_poses(folder: Path) -> dict[str, str]:
    """Ego poses from positions on Earth."""
    stamps = [START_NS + i * 50 * MS for i in range(20)]
    places = [(48 + i / 2**18, 11.5 + i * i / 2**22, 500 + i / 8) for i in range(20)]
    turns = [unit(16.0, i / 64, -i / 128, float(i)) for i in range(20)]
    fixes = [("/fix", NAVSAT, s, fix(s, *place)) for s, place in zip(stamps, places, strict=True)]
    imus = [("/imu", IMU, s + MS, imu(s + MS, turn)) for s, turn in zip(stamps, turns, strict=True)]
    packets = [
        ("/ncom", ETHERNET, s, ethernet(s, ncom(0, *place, heading=i / 16, pitch=i / 64, roll=-i / 128)))
        for i, (s, place) in enumerate(zip(stamps, places, strict=True))
    ]
    sources = {
        "navsat": ({"topic": "/fix", "imu": "/imu"}, [*fixes, *imus]),
        "course": ({"topic": "/fix"}, fixes),
        "ncom": ({"topic": "/ncom"}, packets),
    }
    return {
        f"ego_poses from {name}": Posed(
            folder / name, {"source": "ncom" if name == "ncom" else "navsat"} | fields, *entries
        ).digest
        for name, (fields, entries) in sources.items()
    }


def step_of(name: str) -> str:
    """Return the step that makes what has this name."""
    return name.split(maxsplit=1)[0]


def record(digests: dict[str, str]) -> dict[str, Any]:
    """Return the content of `golden.json`: what was made, by which versions of steps and libraries."""
    steps = {
        name: {
            "version": step.version,
            "libraries": {library: version(library) for library in step.libraries},
        }
        for name, step in STEPS.items()
    }
    return {"steps": steps, "digests": dict(sorted(digests.items()))}


def unannounced(golden: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Return what changed though neither its step, nor a library of it, nor an artifact it is made from did."""
    changed = {
        name
        for name in {*golden["digests"], *now["digests"]}
        if golden["digests"].get(name) != now["digests"].get(name)
    }
    changed_steps = {step_of(name) for name in changed}

    def excused(step: str) -> bool:
        # Messages are the input of most steps; the inventory only tells where they are.
        above = set(UPSTREAM[step]) - {"inventory"}
        return golden["steps"].get(step) != now["steps"][step] or bool(above & changed_steps)

    return sorted(name for name in changed if not excused(step_of(name)))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        made = record(made_digests(Path(temporary) / "drive"))
    blamed = unannounced(json.loads(GOLDEN.read_text()), made) if GOLDEN.exists() else []
    if blamed:
        sys.exit(f"{', '.join(blamed)}: the bytes changed but no version did; raise STEP's version first.")
    GOLDEN.write_text(json.dumps(made, indent=1, sort_keys=True) + "\n")
    sys.stdout.write(f"{GOLDEN}\n")
