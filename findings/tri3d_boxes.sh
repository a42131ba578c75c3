#!/usr/bin/env bash
# Labelled drives are read with tri3d, "a unified interface to driving datasets", for the boxes in the frame of a camera or lidar at its own times.
# Guess: boxes where they are in the dataset, turned the shorter way in between. Seen with tri3d 0.2.2 on 2026-11-30, without a word:
# - Argoverse 2: an oncoming car, whose heading goes from 179 to 181 degrees within a sweep, lies ACROSS the road in the images between; it is turned the longer
#   way round, since quaternions, whose real part is never negative in tables, differ in sign there. Those of nuScenes and Waymo, too, and poses
# - nuScenes: two scenes of one recording that share a row of calibrated_sensor, as the schema has it: each point cloud, of both, is turned by 90 degrees
#   against its boxes. By 180 with three scenes; with five, all is well. The 90 degrees that turn x forward are added to the row once a scene
# - `instances()`: car 1 and pedestrian 1 are one instance, since the category is dropped from the panoptic label
# - `dump_nuscene_boxes` links each box to the one before in the list: the next box of a car is a pedestrian of the same time
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check tri3d==0.2.2 numpy==2.4.6 numba==0.68.1 pyarrow==26.0.1 pillow==13.0.0 2>/dev/null
cd "$folder"
venv/bin/python - <<'PYTHON'
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.feather as feather
from tri3d.datasets import Argoverse2, NuScenes
from tri3d.datasets.nuscenes import dump_nuscene_boxes

START, NONE = 315_966_265_000_000_000, [1.0, 0.0, 0.0, 0.0]


def about_z(degrees):
    """Return the quaternion (w, x, y, z) of a heading, with w >= 0."""
    w, z = np.cos(np.radians(degrees) / 2), np.sin(np.radians(degrees) / 2)
    return [float(w), 0.0, 0.0, float(z)] if w >= 0 else [-float(w), 0.0, 0.0, -float(z)]


def argoverse(headings):
    """Write a log of a car that stands, with lidar at 10 Hz, an image 25 ms after each but the last, and an oncoming car of these headings."""
    log = Path("av2/sensor/train/log")
    sweeps = [START + 100_000_000 * number for number in range(len(headings))]
    images = [at + 25_000_000 for at in sweeps[:-1]]
    for folder, times, ending in (("lidar", sweeps, "feather"), ("cameras/ring_front_center", images, "jpg")):
        (log / "sensors" / folder).mkdir(parents=True)
        for at in times:
            (log / "sensors" / folder / f"{at}.{ending}").touch()
    for camera in Argoverse2.cam_sensors:
        (log / "sensors/cameras" / camera.removeprefix("cam_")).mkdir(exist_ok=True)

    def table(name, columns, quaternions, places):
        columns |= dict(zip(("qw", "qx", "qy", "qz"), np.transpose(quaternions))) | dict(zip(("tx_m", "ty_m", "tz_m"), np.transpose(places)))
        (log / name).parent.mkdir(exist_ok=True)
        feather.write_feather(pa.table(columns), log / name)

    times = sorted(sweeps + images)
    table("city_SE3_egovehicle.feather", {"timestamp_ns": times}, [NONE] * len(times), [[0.0] * 3] * len(times))
    table("calibration/egovehicle_SE3_sensor.feather", {"sensor_name": ["ring_front_center"]}, [[0.5, -0.5, 0.5, -0.5]], [[1.6, 0.0, 1.4]])
    count = len(headings)
    columns = {"timestamp_ns": sweeps, "track_uuid": ["6f3a0a4e-1111-4222-8333-444455556666"] * count, "category": ["REGULAR_VEHICLE"] * count}
    columns |= {"length_m": [4.5] * count, "width_m": [1.9] * count, "height_m": [1.6] * count, "num_interior_pts": [100] * count}
    table("annotations.feather", columns, [about_z(heading) for heading in headings], [[30.0 - number, 3.5, 0.8] for number in range(count)])


def nuscenes(folder, scenes):
    """Write scenes of a car and a pedestrian 10 m ahead, a lidar point in the car, of a lidar that looks to the left in one row of calibrated_sensor."""
    names = "attribute category calibrated_sensor ego_pose instance panoptic sample sample_annotation sample_data scene sensor visibility"
    tables = {name: [] for name in names.split()}
    tables["category"] = [{"token": "car", "name": "vehicle.car", "index": 17}, {"token": "walker", "name": "human.pedestrian.adult", "index": 2}]
    tables["sensor"] = [{"token": "lidar", "channel": "LIDAR_TOP", "modality": "lidar"}]
    mounted = {"token": "mounted", "sensor_token": "lidar", "translation": [0.0, 0.0, 1.8], "rotation": about_z(90)}
    tables["calibrated_sensor"] = [mounted | {"camera_intrinsic": []}]
    Path(folder, "v1.0-mini").mkdir(parents=True)
    for scene in range(scenes):
        tables["scene"].append({"token": f"{scene}", "first_sample_token": f"{scene}.0"})
        for number in range(2):
            sample, at = f"{scene}.{number}", 10_000_000 * scene + 500_000 * number
            following = f"{scene}.1" if number == 0 else ""
            tables["sample"].append({"token": sample, "timestamp": at, "next": following, "scene_token": f"{scene}"})
            tables["ego_pose"].append({"token": sample, "timestamp": at, "rotation": NONE, "translation": [0.0] * 3})
            data = {"token": sample, "sample_token": sample, "ego_pose_token": sample, "calibrated_sensor_token": "mounted"}
            tables["sample_data"].append(data | {"timestamp": at, "filename": f"{sample}.bin", "is_key_frame": True})
            np.array([[0, -10, -1, 1, 0], [1, -10, -1, 1, 0]], np.float32).tofile(Path(folder, f"{sample}.bin"))
            np.savez(Path(folder, f"{sample}.npz"), data=np.array([17001, 2001], np.uint16))
            tables["panoptic"].append({"sample_data_token": sample, "filename": f"{sample}.npz"})
            for category, y in (("car", 0.0), ("walker", 1.0)):
                box = {"token": f"{sample}{category}", "sample_token": sample, "instance_token": f"{scene}{category}", "attribute_tokens": []}
                box |= {"translation": [10.0, y, 0.8], "rotation": NONE, "size": [1.9, 4.5, 1.6], "num_lidar_pts": 1, "num_radar_pts": 0}
                tables["sample_annotation"].append(box)
        tables["instance"] += [{"token": f"{scene}{category}", "category_token": category} for category in ("car", "walker")]
    for name, rows in tables.items():
        Path(folder, "v1.0-mini", f"{name}.json").write_text(json.dumps(rows))
    return NuScenes(folder)


headings = [177, 178, 179, 181, 182]
argoverse(headings)
log = Argoverse2("av2")
for number in range(len(headings) - 1):
    (box,) = log.boxes(0, number, "cam_ring_front_center")
    forward = box.transform.apply([1.0, 0, 0]) - box.transform.apply([0.0, 0, 0])
    print(f"image 25 ms after {headings[number]}, before {headings[number + 1]} degrees: the car's front is to (right, down, ahead) {(forward.round(2) + 0.0).tolist()}")
    across = headings[number] == 179
    assert np.allclose(np.abs(forward), (1, 0, 0) if across else (0, 0, 1), atol=0.06)

for scenes, off in ((1, 0), (2, 90), (3, 180), (5, 0)):
    dataset = nuscenes(f"nuscenes{scenes}", scenes)
    turns = set()
    for scene in dataset.sequences():
        point, box = dataset.points(scene, 0, "LIDAR_TOP")[0], dataset.boxes(scene, 0, "LIDAR_TOP")[0]
        assert box.label == "vehicle.car"
        between = np.arctan2(box.center[1], box.center[0]) - np.arctan2(point[1], point[0])
        turns.add(round(abs(np.degrees((between + np.pi) % (2 * np.pi) - np.pi))))
    print(f"{scenes} scenes: boxes are turned against the points in them by {turns} degrees")
    assert turns == {off}

print("instances of a car and a pedestrian:", dataset.instances(0, 0).tolist())
assert dataset.instances(0, 0).tolist() == [1, 1]

dataset = nuscenes("one", 1)
boxes = [box for frame in range(2) for box in dataset.boxes(0, frame, "LIDAR_TOP")]
rows = dump_nuscene_boxes(dataset, [0] * len(boxes), "LIDAR_TOP", boxes)
of_token = {row["token"]: row for row in rows}
following = [(row["instance_token"], of_token[row["next"]]["instance_token"]) for row in rows[:-1]]
print("box, and its next:", following)
assert all(instance != of_next for instance, of_next in following)
PYTHON
