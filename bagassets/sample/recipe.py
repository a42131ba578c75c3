"""The recipe of sample drives, as a person would write it for the sample car."""

from bagassets.base.escaping import yaml_scalar
from bagassets.sample.arm import CAMERAS, COMMANDS, EPISODE, JOINTS, STATES, TASK
from bagassets.sample.rig import Camera, cameras
from bagassets.sample.throughput import throughput_cameras


def sample_recipe(
    *,
    name: str = "sample",
    root: str = "recordings",
    output: str = "nuscenes",
    version: str = "v1.0-sample",
    throughput: bool = False,
) -> str:
    """Return a recipe for drives that `write_drive` writes.

    Args:
        name: name of the project.
        root: folder of the recordings, relative to the recipe.
        output: dataroot, relative to the recipe.
        version: version folder of the dataset.
        throughput: for drives of the profile `tas`.
    """
    rig = (throughput_cameras if throughput else cameras)(1, 1)
    channels = [f"{camera.channel}: {{modality: camera, topic: {_topic(camera)}}}" for camera in rig]
    lidar = "velodyne_packets" if throughput else "points"
    channels += [
        "# each point moved to the stamp of its revolution",
        f"LIDAR_TOP: {{modality: lidar, topic: /lidar_top/{lidar}, deskew: true}}",
    ]
    boxes = ""
    if not throughput:
        channels.append("RADAR_FRONT: {modality: radar, topic: /radar_front/points}")
        boxes = "    annotations: [{topic: /annotations}]  # vision_msgs/Detection3DArray, in odom\n"
    return f"""\
name: {yaml_scalar(name)}
bags:
  root: {yaml_scalar(root)}
  settle_s: 2  # a copied recording counts once it has kept its size this long
nuscenes:
  output: {yaml_scalar(output)}
  version: {yaml_scalar(version)}
scenes:
  keyframe_hz: 2
  length_s: 20
rigs:
  - name: {"throughput" if throughput else "car"}
    ego_frame: base_link
    ego_pose: {{source: odometry, topic: /odom}}
{boxes}    channels:
""" + "".join(f"      {line}\n" for line in channels)


def _topic(camera: Camera) -> str:
    return f"/{camera.name}/image_raw" + ("/compressed" if camera.encoding == "jpeg" else "")


def arm_recipe(*, name: str = "arm", root: str = "recordings", foxglove: bool = False) -> str:
    """Return a recipe for recordings that `write_arm_recordings` writes: their LeRobot dataset.

    Args:
        name: name of the project.
        root: folder of the recordings, relative to the recipe.
        foxglove: for recordings without ROS.
    """
    field, text = ("joints.position", "message") if foxglove else ("position", "data")
    joints = ", ".join(JOINTS)
    return f"""\
name: {yaml_scalar(name)}
bags:
  root: {yaml_scalar(root)}
  settle_s: 2  # a copied recording counts once it has kept its size this long
rigs:
  - name: arm
    channels:
      CAM_WORKSPACE: {{modality: camera, topic: {CAMERAS["workspace"]}, undistort: false}}
      CAM_WRIST: {{modality: camera, topic: {CAMERAS["wrist"]}, undistort: false}}
    signals:
      arm: {{topic: {STATES}, field: {field}, names: [{joints}], unit: rad}}
      gripper: {{topic: {STATES}, field: {field}, names: [gripper], unit: m}}
      arm_command: {{topic: {COMMANDS}, field: {field}, names: [{joints}], unit: rad}}
      gripper_command: {{topic: {COMMANDS}, field: {field}, names: [gripper], unit: m}}
lerobot:
  output: lerobot
  fps: 30
  features:
    observation.state: {{signals: [arm, gripper], at: linear}}
    action: {{signals: [arm_command, gripper_command]}}
    observation.images.workspace: {{camera: CAM_WORKSPACE, at: nearest}}
    observation.images.wrist: {{camera: CAM_WRIST, at: nearest}}
  episodes: {{topic: {EPISODE}, field: {text}, start: [start], end: [end]}}
  task: {{topic: {TASK}, field: {text}}}
"""
