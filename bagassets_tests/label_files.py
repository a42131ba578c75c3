"""Label files of every format for the small drive: the same true boxes, each in the format's own frame."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bagassets.geometry.se3 import SE3
from bagassets_tests.small_drive import OPTICAL_XYZW, SPEED_MPS, START_NS

S = 1_000_000_000
EGO_SE3_LIDAR = SE3((1.0, 0.0, 0.0, 0.0), (0.5, 0.0, 1.8))
EGO_SE3_CAM = SE3.create((OPTICAL_XYZW[3], *OPTICAL_XYZW[:3]), (1.5, 0.0, 1.2))
FRAMES = 20  # labelled clouds
SIZES = {"7": (1.9, 4.4, 1.5), "8": (0.6, 0.7, 1.8)}
CLASSES = {"7": "Car", "8": "Pedestrian"}


def stamp_of(frame):
    """Stamp of cloud number `frame`."""
    return START_NS + 5_000_000 + frame * 100_000_000


def odom_SE3_ego(stamp_ns):
    return SE3((1.0, 0, 0, 0), (SPEED_MPS * (stamp_ns - START_NS) / 1e9, 0.0, 0.0))


def yaw_rotation(yaw):
    return (np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2))


def odom_SE3_box(track, stamp_ns):
    """A car that drives ahead of us and turns, and a pedestrian who crosses; both upright."""
    t = (stamp_ns - START_NS) / 1e9
    if track == "7":
        return SE3.create(yaw_rotation(0.3 + 0.2 * t), (20.0 + 6.0 * t, 3.0 + 0.5 * t, 0.75))
    return SE3.create(yaw_rotation(-1.2), (15.0, 4.0 - 1.2 * t, 0.9))


def truth():
    """Yield frame number, stamp, track and pose of every box."""
    for frame in range(FRAMES):
        for track in SIZES:
            yield frame, stamp_of(frame), track, odom_SE3_box(track, stamp_of(frame))


def in_sensor(pose, stamp_ns, ego_SE3_sensor):
    return (odom_SE3_ego(stamp_ns) @ ego_SE3_sensor).inverse() @ pose


def yaw_of(rotation):
    w, x, y, z = rotation
    return float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def box_entries(frame="odom"):
    entries = []
    for _, stamp, track, odom_pose in truth():
        pose = odom_pose if frame == "odom" else in_sensor(odom_pose, stamp, EGO_SE3_LIDAR)
        entries.append(
            {
                "stamp_ns": stamp, "track_id": track, "category": CLASSES[track], "center": list(pose.translation),
                "size": list(SIZES[track]), "rotation": list(pose.rotation),
            }
        )  # fmt: skip
    return entries


def box_json(entries=None, **header):
    """The JSON form, one box per line; the first box is on line 3."""
    head = {"format": "bagassets-boxes", "version": 1, "frame": "odom", **header}
    lines = ",\n".join(json.dumps(entry) for entry in (box_entries() if entries is None else entries))
    return json.dumps(head)[:-1] + ',\n "boxes": [\n' + lines + "\n]}\n"


def write_boxes_json(folder):
    (folder / "a.boxes.json").write_text(box_json())
    return {"format": "boxes", "path": "{stem}.boxes.json"}


def write_boxes_parquet(folder):
    rows = [
        {
            "stamp_ns": e["stamp_ns"], "track_id": e["track_id"], "category": e["category"],
            **dict(zip("xyz", e["center"], strict=True)),
            **dict(zip(("qw", "qx", "qy", "qz"), e["rotation"], strict=True)),
            **dict(zip(("width", "length", "height"), e["size"], strict=True)),
        }
        for e in box_entries("lidar")
    ]  # fmt: skip
    (folder / "labels").mkdir()
    pq.write_table(pa.Table.from_pylist(rows), folder / "labels" / "a.parquet")
    return {"format": "boxes", "path": "labels/{stem}.parquet", "frame": "lidar"}


def write_sustechpoints(folder):
    labels = folder / "a" / "label"
    labels.mkdir(parents=True)
    clouds = {}
    for frame, stamp, track, odom_pose in truth():
        pose = in_sensor(odom_pose, stamp, EGO_SE3_LIDAR)
        width, length, height = SIZES[track]
        x, y, z = pose.translation
        psr = {
            "position": {"x": x, "y": y, "z": z},
            "scale": {"x": length, "y": width, "z": height},
            "rotation": {"x": 0, "y": 0, "z": yaw_of(pose.rotation)},
        }
        clouds.setdefault(frame, []).append({"obj_id": track, "obj_type": CLASSES[track], "psr": psr})
    for frame, content in clouds.items():
        (labels / f"{frame:06d}.json").write_text(json.dumps(content, indent=1))
    return {
        "format": "sustechpoints", "path": "{stem}/label", "frame": "lidar", "times": {"by": "topic", "topic": "/points"},
    }  # fmt: skip


def write_kitti_tracklets(folder):
    items = []
    for track, (width, length, height) in SIZES.items():
        poses = []
        for frame in range(FRAMES):
            pose = in_sensor(odom_SE3_box(track, stamp_of(frame)), stamp_of(frame), EGO_SE3_LIDAR)
            x, y, z = pose.translation
            poses.append(
                f"<item><tx>{x!r}</tx><ty>{y!r}</ty><tz>{z - height / 2!r}</tz><rx>0</rx><ry>0</ry>"
                f"<rz>{yaw_of(pose.rotation)!r}</rz><state>2</state><occlusion>0</occlusion></item>"
            )
        items.append(
            f"<item><objectType>{CLASSES[track]}</objectType><h>{height}</h><w>{width}</w><l>{length}</l>"
            f"<first_frame>3</first_frame>\n<poses><count>{FRAMES}</count><item_version>2</item_version>\n"
            + "\n".join(poses)
            + "\n</poses><finished>1</finished></item>"
        )
    (folder / "tracklet_labels.xml").write_text(
        '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n<!DOCTYPE boost_serialization>\n'
        '<boost_serialization signature="serialization::archive" version="9">\n<tracklets class_id="0">\n'
        f"<count>{len(items)}</count><item_version>1</item_version>\n"
        + "\n".join(items)
        + "\n</tracklets>\n</boost_serialization>\n"
    )
    return {
        "format": "kitti_tracklets", "path": "tracklet_labels.xml", "frame": "lidar",
        "times": {"by": "topic", "topic": "/points", "first": 3},
    }  # fmt: skip


def kitti_line(track, stamp):
    """The columns after frame and track of a KITTI label, in the optical frame of the camera."""
    pose = in_sensor(odom_SE3_box(track, stamp), stamp, EGO_SE3_CAM)
    width, length, height = SIZES[track]
    x, y, z = pose.translation
    forward = pose.transform_points(np.array([[1.0, 0, 0]]))[0] - np.array(pose.translation)
    rotation_y = float(np.arctan2(-forward[2], forward[0]))
    return (
        f"{CLASSES[track]} 0 0 0.0 0 0 10 10 {height!r} {width!r} {length!r} "
        f"{x!r} {y + height / 2!r} {z!r} {rotation_y!r}"
    )


def write_kitti_tracking(folder):
    lines = [f"{frame} {track} {kitti_line(track, stamp)}" for frame, stamp, track, _ in truth()]
    lines.insert(3, "1 -1 DontCare -1 -1 -10 0 0 9 9 -1000 -1000 -1000 -10 -1 -1 -1")
    (folder / "a.txt").write_text("\n".join(lines) + "\n")
    times = "".join(f"{np.datetime64(stamp_of(frame), 'ns')}\n".replace("T", " ") for frame in range(FRAMES))
    (folder / "timestamps.txt").write_text(times)
    return {
        "format": "kitti_labels", "path": "{stem}.txt", "frame": "cam",
        "times": {"by": "file", "path": "timestamps.txt"},
    }  # fmt: skip


def write_kitti_objects(folder):
    labels = folder / "label_2"
    labels.mkdir()
    for frame, stamp, track, _ in truth():
        with (labels / f"{stamp_of(frame)}.txt").open("a") as stream:
            stream.write(kitti_line(track, stamp) + "\n")
    return {
        "format": "kitti_labels",
        "path": "label_2",
        "frame": "cam",
        "times": {"by": "name", "unit": "ns"},
    }


def write_nuscenes(folder):
    version = folder / "v1.0-old"
    version.mkdir()
    samples = [
        {"token": f"s{frame}", "timestamp": stamp_of(frame) // 1000, "scene_token": "scene"}
        for frame in range(FRAMES)
    ]
    rows = [
        {
            "token": f"{track}-{frame}", "sample_token": f"s{frame}", "instance_token": track,
            "attribute_tokens": ["moving"] if track == "7" else [], "translation": list(pose.translation),
            "size": list(SIZES[track]), "rotation": list(pose.rotation),
        }
        for frame, _, track, pose in truth()
    ]  # fmt: skip
    rows.append({**rows[0], "token": "other", "sample_token": "elsewhere"})
    samples.append({"token": "elsewhere", "timestamp": samples[0]["timestamp"], "scene_token": "other"})
    tables = {
        "sample_annotation": rows,
        "sample": samples,
        "instance": [{"token": track, "category_token": name} for track, name in CLASSES.items()],
        "category": [{"token": name, "name": name} for name in CLASSES.values()],
        "attribute": [{"token": "moving", "name": "vehicle.moving"}],
        "scene": [{"token": "scene", "log_token": "log"}, {"token": "other", "log_token": "another"}],
        "log": [{"token": "log", "logfile": "a.mcap"}, {"token": "another", "logfile": "b.mcap"}],
    }
    for name, content in tables.items():
        (version / f"{name}.json").write_text(json.dumps(content, indent=0))
    return {"format": "nuscenes", "path": "v1.0-old", "logfile": "{key}"}


WRITERS = {
    "boxes.json": write_boxes_json,
    "boxes.parquet": write_boxes_parquet,
    "sustechpoints": write_sustechpoints,
    "kitti_tracklets": write_kitti_tracklets,
    "kitti_tracking": write_kitti_tracking,
    "kitti_objects": write_kitti_objects,
    "nuscenes": write_nuscenes,
}
