"""Recipes and recordings, none of them written to disk, that between them have whatever an asset may depend on."""

from dataclasses import dataclass
from pathlib import Path

from bagassets.assets.boxes.files.find import LabelSet
from bagassets.assets.boxes.files.label import LabelFile
from bagassets.geometry.camera import CameraModel
from bagassets.recipe.format_settings import OUR_FORMATS
from bagassets.recipe.model import Recipe
from bagassets.recordings.inventory import Inventory
from bagassets.store.canonical import digest_json
from bagassets_tests.calibration_texts import camchain, kalibr_camera
from bagassets_tests.facts import MadeUpArtifact, MadeUpFacts, calibrated
from bagassets_tests.recipe_changes import OTHER

# --- recipes ------------------------------------------------------------------------------

CAMERA = {"modality": "camera", "topic": "/cam/image"}
BACK = {"modality": "camera", "topic": "/back/image"}
LIDAR = {"modality": "lidar", "topic": "/points"}
PACKETS = {"modality": "lidar", "topic": "/packets"}
RADAR = {"modality": "radar", "topic": "/radar"}
LENS = {"width": 640, "height": 480, "fx": 300, "fy": 301, "cx": 320, "cy": 240}
MOUNT = {"translation": [1, 2, 3], "rotation": [0, 0, 0, 1]}
ODOMETRY = {"source": "odometry", "topic": "/odom"}
SIGNALS = {
    "arm": {
        "topic": "/joint_states",
        "field": "position",
        "names": ["elbow", "wrist"],
        "unit": "rad",
        "recorded_unit": "deg",
    },
    "speed": {"topic": "/odom", "field": ["twist.twist.linear.x", "twist.twist.angular.z"], "clock": "log"},
}
BOX_RULES = {
    "categories": {"a": "car", "b": "van"},
    "attributes": {"car": ["parked"], "van": ["moving"]},
    "attribute_names": {"p": "parked", "m": "moving"},
}
POSES = (
    {"source": "odometry", "topic": "/odom", "frame": "imu"},
    {"source": "pose", "topic": "/pose", "frame": "imu"},
    {"source": "tf"},
    {"source": "navsat", "topic": "/fix", "imu": "/imu"},
    {"source": "ncom", "topic": "/ncom", "sender": "10.1.1.20", "frame": "imu"},
    {"source": "fixed", "pose": MOUNT},
)
LABEL_FILES = (
    {"format": "boxes", "path": "{stem}.json"},
    {"format": "sustechpoints", "path": "sustech", "times": {"by": "topic", "topic": "/points"}},
    {"format": "kitti_tracklets", "path": "tracklets.xml", "times": {"by": "file", "path": "times.txt"}},
    {"format": "kitti_labels", "path": "kitti", "times": {"by": "name"}, "frame": "cam_front"},
    {"format": "nuscenes", "path": "tables", "logfile": "{stem}"},
)


CAMERA_FEATURE = {"camera": "CAM_FRONT", "at": "nearest", "tolerance_s": 0.25, "gap": "hold"}
EPISODES = {
    "file": {"ranges": "ranges.csv", "trim_s": 2.0, "min_length_s": 1.0, "max_length_s": 60.0},
    "topic": {"topic": "/pose", "field": "header.frame_id", "start": ["go", True, 1], "end": ["stop"]},
    "signal": {"signal": "speed"},
}


def _lerobot(folder, ways):
    """Return a section for episodes that are cut in one of these ways; files are in `folder`."""
    episodes = dict(EPISODES[ways])
    if "ranges" in episodes:
        episodes["ranges"] = str(folder / episodes["ranges"])
    return {
        "fps": 10,
        "robot": "arm",
        "features": {
            "observation.state": {"signals": ["arm", "speed"], "at": "linear", "gap": "end"},
            "action": {"next_of": "observation.state"},
            "observation.images.front": CAMERA_FEATURE,
        },
        "episodes": episodes,
        "task": {"topic": "/tf_static", "field": "frame"} if ways == "topic" else "Lift.",
        "video": {"codec": "av1", "crf": 40, "preset": "8", "keyframes": 4, "odd_size": "pad"},
    }


def _rig(name, channels, pose=ODOMETRY, **fields):
    return {"name": name, "channels": channels, "ego_pose": pose, **fields}


def _recipe(*rigs, **sections):
    return {
        "name": "test",
        "bags": {"root": "/bags"},
        "rigs": rigs,
        **{kind: {} for kind in OUR_FORMATS if kind != "lerobot"},
        **sections,
    }


def recipes(folder):
    """Return name -> recipe; files that they name are in `folder`."""
    urdf = {"urdf": str(folder / "car.urdf")}
    car = _rig("car", {"CAM_FRONT": CAMERA, "LIDAR_TOP": LIDAR, "CAM_BACK": BACK, "RADAR_FRONT": RADAR},
               annotations=[{"topic": "/boxes", **BOX_RULES}], vehicle="van", location="yard", required=["CAM_FRONT"],
               match=["car/**", "van/**"], signals=SIGNALS, **urdf)  # fmt: skip
    bus = _rig("bus", {"CAM_BACK": {**BACK, "undistort": False}, "LIDAR_TOP": PACKETS}, {"source": "fixed"})
    full = _recipe(
        car,
        bus,
        scenes={"reference": "LIDAR_TOP"},
        preview={"camera": "CAM_BACK", "lidar": "LIDAR_TOP", "range_m": 20},
        vision={"cameras": ["CAM_FRONT", "CAM_BACK"], "trajectories": ["ego:global", "lane:CAM_FRONT"]},
        bags={"root": "/bags", "message_definitions": [str(folder / "msgs"), str(folder / "more")]},
        splits={"pinned": {"a*": "train", "b*": "val"}},
        nuscenes={"categories": [{"name": "car"}, {"name": "van"}], "attributes": [{"name": "p"}]},
        formats={"kitti": {"output": "kitti"}},
        lerobot=_lerobot(folder, "file"),
        datasets=[{"name": "some", "rigs": ["car", "bus"], "place": [[48, 11], [48, 12], [49, 12]]}],
        checks={
            "topic_rates": {"limits": {"/odom": {"min_hz": 1, "max_hz": 200}}},
            "signal_values": {"limits": {"arm": {"min": -4, "max": 4}}},
        },
    )
    lenses = {
        "CAM_FRONT": {**CAMERA, "target": dict(list(LENS.items())[2:]), "to_8bit": {"range": [0, 900]}},
        "CAM_BACK": {**BACK, "intrinsics": {**LENS, "distortion": [0.1, 0.2, 0, 0]}, "extrinsics": MOUNT,
                     "output": "png", "to_8bit": {"percentiles": [1, 99]}},
        "CAM_LEFT": {**CAMERA, "undistort": False, "output": "as_recorded", "frame": "cam_left", "depth_unit_m": 0.01},
    }  # fmt: skip
    chain, front = str(folder / "chain.yaml"), str(folder / "front.yaml")
    files = {
        "CAM_FRONT": {**CAMERA, "intrinsics": {"file": front}, "extrinsics": MOUNT},
        "CAM_BACK": {**BACK, "intrinsics": {"file": chain, "camera": "cam1", "model": "equidistant"},
                     "extrinsics": {"file": chain, "camera": "cam0", "relative_to": "imu"}},
        "CAM_LEFT": {**CAMERA, "undistort": False, "extrinsics": {"file": chain}},
    }  # fmt: skip
    clouds = {
        "LIDAR_BACK": {
            **LIDAR,
            "header_stamp_is": "start",
            "max_range_m": 50,
            "point_times": {"unit": "us", "since": "clock"},
        },
        "LIDAR_TOP": {**LIDAR, "deskew": True, "extrinsics": MOUNT},
        "LIDAR_SIDE": {**PACKETS, "model": "VLP-16", "cut_angle_deg": 10, "clock": "log"},
        "RADAR_FRONT": {**RADAR, "azimuth_positive": "left", "extrinsics": MOUNT},
    }
    plain = {"CAM_FRONT": CAMERA, "LIDAR_TOP": LIDAR}
    chosen = {
        "full": full,
        # Which rig is whose makes no difference but by name.
        "alike": _recipe(_rig("a", plain, match=["car/**"]), _rig("b", plain)),
        "lenses": _recipe(_rig("car", lenses), vision={"trajectories": ["base_link:CAM_FRONT"]}),
        "files": _recipe(_rig("car", files, **urdf)),
        "clouds": _recipe(_rig("car", clouds), clock="log"),
        **{
            f"episodes by {ways}": _recipe(
                _rig("car", {"CAM_FRONT": CAMERA}, signals=SIGNALS), lerobot=_lerobot(folder, ways)
            )
            for ways in ("topic", "signal")
        },
        "labels": _recipe(
            _rig("car", plain, annotation_files=[{**entry, **BOX_RULES} for entry in LABEL_FILES])
        ),
        "numbered": _recipe(
            _rig(
                "car",
                plain,
                annotation_files=[
                    {**LABEL_FILES[1], "times": {"by": "file", "path": "times.txt"}},
                    {**LABEL_FILES[3], "times": {"by": "topic", "topic": "/points"}, "frame": "lane"},
                ],
            )
        ),
        **{
            f"poses from {pose['source']}": _recipe(
                _rig("car", {"CAM_FRONT": CAMERA}, pose, **urdf), vision={"trajectories": ["lane:global"]}
            )
            for pose in POSES
        },
    }
    return {name: Recipe.model_validate(data) for name, data in chosen.items()}


def write_files(folder):
    """Write the files that the recipes name, and those that changed recipes name."""
    (folder / "other").mkdir()
    for number, name in enumerate(("ranges.csv", f"ranges{OTHER}.csv", "other/ranges.csv")):
        rows = [f"{key},{number},{number + 5}" for key in ("car/full", "van/plain", "car/sparse")]
        (folder / name).write_text("\n".join(["recording,start_s,end_s", *rows]))
    for number, name in enumerate(("car.urdf", f"car{OTHER}.urdf", "other/car.urdf")):
        (folder / name).write_text(
            '<robot name="r"><link name="base_link"/><link name="imu"/><joint name="j" type="fixed">'
            f'<parent link="base_link"/><child link="imu"/><origin xyz="{number} 0 0"/></joint></robot>'
        )
    for stem in ("chain", "front"):
        for number, name in enumerate((f"{stem}.yaml", f"{stem}{OTHER}.yaml", f"other/{stem}.yaml")):
            model = CameraModel(
                "plumb_bob", 640, 480, 300.0 + number, 301.0, 320.0, 240.0, (0.1, 0.2, 0.0, 0.0)
            )
            cameras = [kalibr_camera(model, topic) for topic in ("/cam/image", "/back/image")]
            (folder / name).write_text(camchain(*cameras))


# --- recordings ---------------------------------------------------------------------------

START_NS = 1_700_000_000_000_000_000
TOPICS = {
    "/cam/image": ("sensor_msgs/msg/Image", ["cam_front"]),
    "/cam/camera_info": ("sensor_msgs/msg/CameraInfo", ["cam_front"]),
    "/back/image": ("sensor_msgs/msg/CompressedImage", ["cam_front"]),
    "/back/camera_info": ("sensor_msgs/msg/CameraInfo", ["cam_front"]),
    "/points": ("sensor_msgs/msg/PointCloud2", ["lidar_top"]),
    "/packets": ("velodyne_msgs/msg/VelodyneScan", ["lidar_top"]),
    "/radar": ("radar_msgs/msg/RadarScan", ["radar_front"]),
    "/joint_states": ("sensor_msgs/msg/JointState", []),
    "/odom": ("nav_msgs/msg/Odometry", ["odom"]),
    "/pose": ("geometry_msgs/msg/PoseStamped", ["odom"]),
    "/fix": ("sensor_msgs/msg/NavSatFix", ["gps"]),
    "/imu": ("sensor_msgs/msg/Imu", ["imu"]),
    "/ncom": ("ethernet_msgs/msg/Packet", []),
    "/tf": ("tf2_msgs/msg/TFMessage", []),
    "/tf_static": ("tf2_msgs/msg/TFMessage", []),
    "/boxes": ("vision_msgs/msg/Detection3DArray", ["base_link"]),
}  # fmt: skip
CHANNELS = ("CAM_FRONT", "CAM_BACK", "CAM_LEFT", "LIDAR_TOP", "LIDAR_BACK", "LIDAR_SIDE", "RADAR_FRONT")


@dataclass(frozen=True)
class MadeUpRecording:
    """A recording, and what is known of it upstream, whatever the recipe.

    Attributes:
        path: below the bag root.
        facts: of it.
    """

    path: str
    facts: MadeUpFacts


class _Facts(MadeUpFacts):
    """Label files lie wherever a recipe looks for them, or nowhere."""

    labelled = True

    def labels(self, sources):
        return {entry.path: self._label_set(entry) for entry in sources}

    def _label_set(self, entry):
        place = Path("/bags") / entry.path
        names = ["0.json", "1.json"] if self.labelled else []
        files = tuple(LabelFile(name, place / name, digest_json([entry.path, name])) for name in names)
        times = getattr(getattr(entry, "times", None), "path", None)
        logfile = getattr(entry, "logfile", None)
        return LabelSet(entry.path, place, files, is_folder=True,
                        times=times and LabelFile("times", Path("/bags") / times, digest_json(times)),
                        logfile=logfile and logfile.replace("{stem}", "a"))  # fmt: skip

    def definitions(self, folders):
        return {f"msg:{folder.name}.msg": digest_json(str(folder)) for folder in folders}


def recordings():
    """Return recordings of several rigs: with and without some topics, labels, boxes in known frames, a place."""
    both = [*TOPICS, *(name + OTHER for name in TOPICS)]
    without = [name for name in TOPICS if name not in {"/back/image", "/tf", "/tf_static", "/boxes"}]
    wgs84 = {"kind": "wgs84", "lat": 48.0, "lon": 11.0, "alt": 500.0}
    return [
        _recording("car/full", both),
        _recording("van/plain", TOPICS, origin=wgs84, swept=False),
        _recording(
            "car/sparse", without, origin={"kind": "local", "x": 1.0, "y": 2.0, "z": 3.0}, labelled=False
        ),
        _recording("bus/full", both, boxes_in="lane", undistorted=True),
        _recording("bus/sparse", without, labelled=False),
    ]


def _recording(path, topics, *, origin=None, labelled=True, boxes_in=None, undistorted=False, swept=True):
    inventory = {
        "format": "mcap",
        "size": 1000,
        "start_ns": START_NS,
        "end_ns": START_NS + 10_000_000_000,
        "topics": [_topic(path, number, name, boxes_in) for number, name in enumerate(topics)],
        "gnss": None,
        "daylight": None,
        "notes": [],
    }
    facts = _Facts(Inventory.from_json(inventory), key=path, digest=digest_json(path))
    facts.labelled = labelled
    names = [*CHANNELS, *(f"{name}{OTHER.upper()}" for name in CHANNELS)]
    channels = {name: _calibrated(number, name, undistorted) for number, name in enumerate(names)}
    facts.calibration = calibrated(**channels)
    poses = {"global_frame": "odom", "origin": origin, "fixed": False, "max_gap_s": 0.5, "extrapolate_s": 0.1}
    facts.artifacts = {
        name: MadeUpArtifact(digest_json([path, name]), {"ego_poses.json": poses})
        for name in ("inventory", "calibration", "ego_poses", "annotations", "frames", "sweeps")
    }
    facts.parts = {
        asset: {
            name: MadeUpArtifact(digest_json([path, name]))
            for name in names
            if name.startswith("CAM") == images
        }
        for asset, images in (("frames", True), ("sweeps", False))
    }
    series = [name + suffix for name in SIGNALS for suffix in ("", OTHER)]
    facts.parts["signals"] = {name: MadeUpArtifact(digest_json([path, name])) for name in series}
    if not swept:
        facts.parts["sweeps"] = {}
    return MadeUpRecording(path, facts)


def _topic(path, number, name, boxes_in):
    msgtype, frames = TOPICS[name.removesuffix(OTHER)]
    first_ns, last_ns = START_NS + number, START_NS + 9_000_000_000 + number
    return {
        "name": name,
        "type": msgtype,
        "count": 100,
        "bytes": 1000,
        "digest": digest_json([path, name]),
        "first_ns": first_ns,
        "last_ns": last_ns,
        "first_stamp_ns": first_ns - 500,
        "last_stamp_ns": last_ns - 500,
        "rate_hz": 10.0,
        "max_gap_s": 0.1,
        "gaps": [],
        "gap_count": 0,
        "header_offset_s": None,
        "unordered_stamps": 0,
        "frame_ids": [boxes_in] if boxes_in and name.startswith("/boxes") else frames,
        "serialization": "cdr",
        "packed": True,
        "problem": None,
        "definition": {"format": "ros2msg", "text": ""},
        "first_unordered_ns": None,
        "period_ns": 100_000_000 + number,
    }


def _calibrated(number, name, undistorted):
    camera = {
        "source": "camera_info",
        "model": "plumb_bob",
        "width": 640,
        "height": 480,
        "k": [300.0 + number, 0.0, 320.0, 0.0, 300.0, 240.0, 0.0, 0.0, 1.0],
        "d": [] if undistorted else [0.1, 0.2, 0.0, 0.0, 0.0],
        "binning": [1, 1],
        "roi": {"x_offset": 0, "y_offset": 0, "width": 640, "height": 480, "do_rectify": False},
        "r": [],
        "p": [],
    }
    return {
        "frame": name.lower(),
        "ego_SE3_sensor": {"translation": [float(number), 0.0, 0.0], "rotation": [1.0, 0.0, 0.0, 0.0]},
        "source": "tf_static",
        "camera": camera if name.startswith("CAM") else None,
    }
