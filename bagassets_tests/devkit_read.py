"""Read all of a dataset with the real nuscenes-devkit; runs in the devkit's own environment.

Usage: python devkit_read.py DATAROOT VERSION FILE

FILE, a pickle of plain objects and arrays, gets what the devkit says about each scene, sample, channel and box.
"""

import json
import pickle
import sys
from pathlib import Path

import numpy as np
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.data_classes import LidarPointCloud, RadarPointCloud
from nuscenes.utils.geometry_utils import BoxVisibility, transform_matrix
from PIL import Image
from pyquaternion import Quaternion


def box_values(nusc, box):
    row = nusc.get("sample_annotation", box.token)
    return {
        "token": box.token, "instance": row["instance_token"], "category": box.name,
        "attributes": [nusc.get("attribute", token)["name"] for token in row["attribute_tokens"]],
        "visibility": nusc.get("visibility", row["visibility_token"])["level"],
        "pose": transform_matrix(box.center, box.orientation), "size": box.wlh, "corners": box.corners().T,
        "num_lidar_pts": row["num_lidar_pts"], "num_radar_pts": row["num_radar_pts"],
    }  # fmt: skip


def place_values(nusc, data):
    pose = nusc.get("ego_pose", data["ego_pose_token"])
    mounted = nusc.get("calibrated_sensor", data["calibrated_sensor_token"])
    return {
        "path": nusc.get_sample_data_path(data["token"]), "stamp_us": data["timestamp"],
        "modality": data["sensor_modality"],
        "global_SE3_ego": transform_matrix(pose["translation"], Quaternion(pose["rotation"])),
        "ego_SE3_sensor": transform_matrix(mounted["translation"], Quaternion(mounted["rotation"])),
    }  # fmt: skip


def before(nusc, data):
    """What the links `prev` lead to."""
    while data["prev"]:
        data = nusc.get("sample_data", data["prev"])
        yield {**place_values(nusc, data), "is_key_frame": data["is_key_frame"]}


def reading_values(nusc, token):
    data = nusc.get("sample_data", token)
    pose = nusc.get("ego_pose", data["ego_pose_token"])
    mounted = nusc.get("calibrated_sensor", data["calibrated_sensor_token"])
    path, in_view, intrinsics = nusc.get_sample_data(token)
    values = {**place_values(nusc, data), "before": list(before(nusc, data))}
    if data["sensor_modality"] == "camera":
        _, boxes, _ = nusc.get_sample_data(token, box_vis_level=BoxVisibility.NONE)
        return {
            **values, "intrinsics": intrinsics, "image": np.array(Image.open(path)),
            "boxes": [box_values(nusc, box) for box in boxes], "in_view": [box.token for box in in_view],
        }  # fmt: skip
    kind = LidarPointCloud if data["sensor_modality"] == "lidar" else RadarPointCloud
    cloud = kind.from_file(path)
    values["points"] = cloud.points.T.copy()
    for name, row in (("in_ego", mounted), ("in_global", pose)):
        cloud.rotate(Quaternion(row["rotation"]).rotation_matrix)
        cloud.translate(np.array(row["translation"]))
        values[name] = cloud.points.T[:, :3].copy()
    return values


def scene_values(nusc, scene):
    samples, token = [], scene["first_sample_token"]
    while token:
        sample = nusc.get("sample", token)
        readings = {channel: reading_values(nusc, data) for channel, data in sample["data"].items()}
        # As of any camera: they are annotated in the global frame.
        boxes = [box_values(nusc, nusc.get_box(one)) for one in sample["anns"]]
        samples.append(
            {"token": token, "stamp_us": sample["timestamp"], "readings": readings, "boxes": boxes}
        )
        token = sample["next"]
    return {"name": scene["name"], "description": scene["description"], "samples": samples}


def main(dataroot, version, file):
    nusc = NuScenes(version, dataroot, verbose=False)
    RadarPointCloud.disable_filters()
    Path(file).write_bytes(pickle.dumps([scene_values(nusc, scene) for scene in nusc.scene], protocol=4))
    sys.stdout.write(json.dumps({"scenes": len(nusc.scene)}) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
