"""Walk a dataset with the real nuscenes-devkit; runs in the devkit's own environment.

Usage: python devkit_walk.py DATAROOT VERSION > facts.json

It knows nothing of bagassets. Whatever the devkit raises ends it with a traceback.
"""

import json
import sys
from collections import Counter

import numpy as np
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.data_classes import LidarPointCloud, RadarPointCloud
from nuscenes.utils.geometry_utils import points_in_box
from nuscenes.utils.splits import get_scenes_of_split
from pyquaternion import Quaternion


def walk_chain(nusc, table, first):
    """Follow `next` from a row to the end, checking that `prev` leads back; return the rows."""
    rows, token, before = [], first, ""
    while token:
        row = nusc.get(table, token)
        assert row["prev"] == before, f"{table} {token}: prev is {row['prev']}, not {before}"
        rows.append(row)
        before, token = token, row["next"]
    return rows


def walk_scene(nusc, scene):
    samples = walk_chain(nusc, "sample", scene["first_sample_token"])
    assert samples[-1]["token"] == scene["last_sample_token"]
    assert len(samples) == scene["nbr_samples"]
    times = [sample["timestamp"] for sample in samples]
    assert times == sorted(set(times)), f"{scene['name']}: samples out of order"
    return samples


def walk_data(nusc):
    """Walk the chain of each channel of each scene; return readings per channel."""
    counts, visited = Counter(), 0
    for row in nusc.sample_data:
        if row["prev"] == "":
            chain = walk_chain(nusc, "sample_data", row["token"])
            stamps = [reading["timestamp"] for reading in chain]
            assert stamps == sorted(set(stamps))
            counts[row["channel"]] += len(chain)
            visited += len(chain)
    assert visited == len(nusc.sample_data), "some readings are in no chain"
    return dict(sorted(counts.items()))


def points_per_annotation(nusc, sample):
    """Count lidar points inside each box with the devkit's own geometry."""
    found = []
    token = sample["data"].get("LIDAR_TOP")
    if token is None:
        return found
    path, boxes, _ = nusc.get_sample_data(token)
    cloud = LidarPointCloud.from_file(path)
    for box in boxes:
        counted = int(points_in_box(box, cloud.points[:3].astype(np.float64)).sum())
        found.append([box.token, counted, nusc.get("sample_annotation", box.token)["num_lidar_pts"]])
    return found


def main(dataroot, version):
    nusc = NuScenes(version, dataroot, verbose=False)
    facts = {
        "tables": {name: len(getattr(nusc, name)) for name in nusc.table_names},
        "scenes": {}, "boxes_in_view": Counter(), "rendered": {}, "radar": {}, "sweeps": [], "points": [],
        "velocities": {}, "depths": [],
    }  # fmt: skip
    facts["readings"] = walk_data(nusc)
    for scene in nusc.scene:
        samples = walk_scene(nusc, scene)
        log = nusc.get("log", scene["log_token"])
        facts["scenes"][scene["name"]] = {
            "samples": len(samples), "location": log["location"], "map": nusc.get("map", log["map_token"])["filename"],
        }  # fmt: skip
        for sample in samples:
            for channel, token in sample["data"].items():
                _, boxes, _ = nusc.get_sample_data(token)
                facts["boxes_in_view"][channel] += len(boxes)
            facts["points"] += points_per_annotation(nusc, sample)
    for instance in nusc.instance:
        rows = walk_chain(nusc, "sample_annotation", instance["first_annotation_token"])
        assert len(rows) == instance["nbr_annotations"]
        assert rows[-1]["token"] == instance["last_annotation_token"]
        name = nusc.get("category", instance["category_token"])["name"]
        velocities = [nusc.box_velocity(row["token"]).tolist() for row in rows]
        facts["velocities"].setdefault(name, []).append(velocities)

    lidar = "LIDAR_TOP" if any(row["channel"] == "LIDAR_TOP" for row in nusc.sensor) else None
    sample = nusc.sample[len(nusc.sample) // 2] if nusc.sample else None
    if sample is not None and lidar:
        for camera in [channel for channel in sample["data"] if channel.startswith("CAM")]:
            points, depths, image = nusc.explorer.map_pointcloud_to_image(
                sample["data"][lidar], sample["data"][camera], min_dist=0.5
            )
            facts["rendered"][camera] = [int(points.shape[1]), list(image.size)]
            facts["depths"] += [float(depths.min()), float(depths.max())] if points.shape[1] else []
        cloud, lags = LidarPointCloud.from_file_multisweep(nusc, sample, lidar, lidar, nsweeps=5)
        facts["sweeps"] = [int(cloud.nbr_points()), float(lags.min()), float(lags.max())]
        facts["static_spread_m"] = static_spread(nusc, sample, lidar)
        nusc.render_sample_data(sample["data"][lidar], verbose=False)
        nusc.render_pointcloud_in_image(sample["token"], camera_channel=min(facts["rendered"]), verbose=False)
    for channel in sorted({row["channel"] for row in nusc.sensor if row["modality"] == "radar"}):
        clouds = [
            RadarPointCloud.from_file(nusc.get_sample_data_path(row["token"]))
            for row in nusc.sample_data
            if row["channel"] == channel
        ]
        facts["radar"][channel] = [len(clouds), int(sum(cloud.nbr_points() for cloud in clouds))]
    facts["splits"] = {name: get_scenes_of_split(name, nusc) for name in sys.argv[3:]}
    sys.stdout.write(json.dumps(facts) + "\n")


def static_spread(nusc, sample, lidar):
    """Distance between the parked car's centres as seen from the sensor at each keyframe, in the global frame."""
    centers = {}
    while True:
        _, boxes, _ = nusc.get_sample_data(sample["data"][lidar])
        data = nusc.get("sample_data", sample["data"][lidar])
        pose = nusc.get("ego_pose", data["ego_pose_token"])
        sensor = nusc.get("calibrated_sensor", data["calibrated_sensor_token"])
        for box in boxes:
            for transform in (sensor, pose):
                box.rotate(Quaternion(transform["rotation"]))
                box.translate(np.array(transform["translation"]))
            instance = nusc.get("sample_annotation", box.token)["instance_token"]
            centers.setdefault(instance, []).append(box.center)
        if not sample["next"]:
            break
        sample = nusc.get("sample", sample["next"])
    return min((float(np.ptp(np.array(c), axis=0).max()) for c in centers.values()), default=None)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
