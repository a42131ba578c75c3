"""The recipe of sample drives, as a person would write it for the sample car."""

from bagassets.base.escaping import yaml_scalar
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
