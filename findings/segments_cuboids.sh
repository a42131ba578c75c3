#!/usr/bin/env bash
# A lorry is labelled as a cuboid in the web tool of Segments.ai; its own package brings labels and points together. Which of the lorry's points are in its cuboid
# (`cuboid_to_segmentation`), with the yaw alone, with the same rotation as a quaternion beside it, which labels of the newer kind have, or with the pose of the vehicle,
# as points are in its frame and labels are not? And how fast is the lorry, relative to a vehicle that brakes behind it (`add_kinematics_to_label`), if it comes into view
# after two seconds? Guess: all points, always; the difference of the two speeds.
# Seen with segments-ai 1.33.0 and open3d-cpu 0.20.0 on 2026-11-30, without a word: by the yaw, all points. With the quaternion, half of them for a yaw of 0.5, as it goes
# to Open3D as x, y, z, w, where w is first: the cuboid stands on its edge. With the pose of a vehicle that is turned, none at all: each cuboid is turned about
# itself and stays where it was. And the lorry's speed is set against what the vehicle had two seconds before, when the recording begins: the vehicle comes
# nearer by 9.5 m/s in place of 5.5, as positions of the vehicle are counted from the first frame, and those of the lorry from its own
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check segments-ai==1.33.0 open3d-cpu==0.20.0 pyquaternion==0.9.9 numpy==2.4.6 pydantic==2.14.4
cat >label.py <<'PYTHON'
import numpy as np
from segments.typing import (
    PCD,
    XYZ,
    XYZW,
    EgoPose,
    Label,
    PointcloudCuboidAnnotation,
    PointcloudCuboidLabelAttributes,
    PointcloudSampleAttributes,
    PointcloudSequenceCuboidAnnotation,
    PointcloudSequenceCuboidFrame,
    PointcloudSequenceCuboidLabelAttributes,
    PointcloudSequenceSampleAttributes,
    Sample,
)
from segments.utils import add_kinematics_to_label, cuboid_to_segmentation

SIZE = XYZ(x=10.0, y=2.5, z=3.0)


def turn(yaw):
    return XYZW(qx=0.0, qy=0.0, qz=float(np.sin(yaw / 2)), qw=float(np.cos(yaw / 2)))


def share(place, yaw, rotation=None, pose=None, heading=0.0):
    """Return the share of a lorry's points, in the frame of the vehicle, that are in the cuboid of the lorry."""
    points = np.random.default_rng(0).uniform(-0.49, 0.49, (2000, 3)) * [SIZE.x, SIZE.y, SIZE.z]
    cosine, sine = np.cos(yaw - heading), np.sin(yaw - heading)
    points = points @ np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]).T + [20.0, 0.0, 0.0]
    cuboid = PointcloudCuboidAnnotation(
        id=1, category_id=1, type="cuboid", position=XYZ(x=place[0], y=place[1], z=0.0), dimensions=SIZE, yaw=yaw, rotation=rotation
    )
    return (cuboid_to_segmentation(points, PointcloudCuboidLabelAttributes(annotations=[cuboid]), pose) == 1).mean()


by_yaw = share((20.0, 0.0), 0.5)
by_quaternion = share((20.0, 0.0), 0.5, turn(0.5))
ahead = np.array([100 + 20 * np.cos(0.5), 50 + 20 * np.sin(0.5)])
by_poses = [
    share(place, yaw, None, EgoPose(position=XYZ(x=100.0, y=50.0, z=0.0), heading=turn(yaw)), yaw)
    for place, yaw in (((120.0, 50.0), 0.0), (ahead, 0.5))
]
print(f"points in the cuboid: by yaw {by_yaw:.0%}, by quaternion {by_quaternion:.0%}; with a pose, straight on {by_poses[0]:.0%}, turned {by_poses[1]:.0%}")
assert by_yaw == 1 and 0.3 < by_quaternion < 0.7 and by_poses == [1.0, 0.0]

STEP_S, FRAMES, FIRST, LORRY = 0.5, 9, 4, 10.0
vehicle_m, speed = [0.0], []
for number in range(FRAMES):  # it brakes from 20 m/s by 2 m/s²
    speed.append(20.0 - 2.0 * STEP_S * (number + 0.5))
    vehicle_m.append(vehicle_m[-1] + speed[-1] * STEP_S)
cloud = PCD(url="cloud.pcd", type="pcd")
poses = [EgoPose(position=XYZ(x=place, y=0.0, z=0.0), heading=turn(0.0)) for place in vehicle_m[:FRAMES]]
sample = Sample(
    uuid="one", name="drive", metadata={}, created_at="2026-01-01", created_by="us", priority=0,
    attributes=PointcloudSequenceSampleAttributes(frames=[PointcloudSampleAttributes(pcd=cloud, ego_pose=pose) for pose in poses]),
)
frames = []
for number in range(FRAMES):
    lorry = PointcloudSequenceCuboidAnnotation(
        id=1, track_id=1, category_id=1, type="cuboid", dimensions=SIZE, yaw=0.0, position=XYZ(x=60.0 + LORRY * STEP_S * number, y=0.0, z=0.0)
    )
    stamp = str(1_700_000_000_000_000_000 + int(STEP_S * 1e9) * number)
    frames.append(PointcloudSequenceCuboidFrame(annotations=[lorry] if number >= FIRST else [], timestamp=stamp))
label = Label(
    sample_uuid="one", label_type="pointcloud-cuboid-sequence", label_status="LABELED", labelset="ground-truth", created_at="2026-01-01",
    created_by="us", updated_at="2026-01-01", attributes=PointcloudSequenceCuboidLabelAttributes(frames=frames),
)
found = [frame.annotations[0].velocity for frame in add_kinematics_to_label(sample, label).attributes.frames[FIRST + 1 :]]
true = [abs(LORRY - speed[number]) for number in range(FIRST, FRAMES - 1)]
print("approach at", [round(one.relative, 2) for one in found], "m/s; in truth", true, "- speed of the lorry:", [round(one.absolute, 2) for one in found])
assert np.allclose([one.relative - value for one, value in zip(found, true, strict=True)], 2.0 * STEP_S * FIRST, atol=1e-3)
assert np.allclose([one.absolute for one in found], LORRY, atol=1e-3)
PYTHON
venv/bin/python -W ignore label.py
