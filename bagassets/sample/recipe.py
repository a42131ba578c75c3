"""The recipe of sample drives, as a person would write it for the sample car."""

from bagassets.escaping import yaml_scalar
from bagassets.propose.commented_yaml import Sheet
from bagassets.sample.rig import Camera, cameras
from bagassets.sample.throughput import throughput_cameras

__all__ = ["sample_recipe"]


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
    sheet = Sheet()
    sheet.field(0, f"name: {yaml_scalar(name)}")
    sheet.field(0, "bags:")
    sheet.field(1, f"root: {yaml_scalar(root)}")
    sheet.field(1, "settle_s: 2", "a copied recording counts once it has kept its size this long")
    sheet.field(0, "nuscenes:")
    sheet.field(1, f"output: {yaml_scalar(output)}")
    sheet.field(1, f"version: {yaml_scalar(version)}")
    sheet.field(0, "scenes:")
    sheet.field(1, "keyframe_hz: 2")
    sheet.field(1, "length_s: 20")
    sheet.field(0, "rigs:")
    sheet.field(1, f"- name: {'throughput' if throughput else 'car'}")
    sheet.field(2, "ego_frame: base_link")
    sheet.field(2, "ego_pose: {source: odometry, topic: /odom}")
    if not throughput:
        sheet.field(2, "annotations: [{topic: /annotations}]", "vision_msgs/Detection3DArray, in odom")
    sheet.field(2, "channels:")
    for camera in (throughput_cameras if throughput else cameras)(1, 1):
        sheet.field(3, f"{camera.channel}: {{modality: camera, topic: {_topic(camera)}}}")
    lidar = "velodyne_packets" if throughput else "points"
    sheet.field(
        3,
        f"LIDAR_TOP: {{modality: lidar, topic: /lidar_top/{lidar}, deskew: true}}",
        "each point moved to the stamp of its revolution",
    )
    if not throughput:
        sheet.field(3, "RADAR_FRONT: {modality: radar, topic: /radar_front/points}")
    return sheet.text()


def _topic(camera: Camera) -> str:
    return f"/{camera.name}/image_raw" + ("/compressed" if camera.encoding == "jpeg" else "")
