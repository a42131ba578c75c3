"""Draw the pictures of the documentation that come from a dataset.

    python scripts/pictures.py build/demo/nuscenes v1.0-demo

writes `docs/pictures/lidar_over_camera.jpg`: a sweep of LIDAR_TOP in the image of CAM_FRONT, both read
from the finished nuScenes dataset by nothing but its tables.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from bagassets.assets.lidar_file import read_lidar_file
from bagassets.assets.pictures.canvas import jpeg, read_image
from bagassets.assets.pictures.channels import View
from bagassets.assets.pictures.over_camera import lidar_over_camera
from bagassets.formats.nuscenes.table_file import read_table
from bagassets.geometry.camera import CameraModel
from bagassets.geometry.se3 import SE3

PICTURES = Path(__file__).parents[1] / "docs" / "pictures"


class Dataset:
    """The tables of a dataset by token, as far as pictures need them."""

    def __init__(self, dataroot: Path, version: str) -> None:
        self.dataroot = dataroot
        tables = ("scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "sensor")
        self.rows = {name: read_table(dataroot / version, name) for name in tables}
        self.by_token = {row["token"]: row for rows in self.rows.values() for row in rows}

    def keyframes(self, channel: str) -> dict[str, dict[str, Any]]:
        """Return sample token -> the channel's reading of that sample."""
        found = {}
        for row in self.rows["sample_data"]:
            sensor = self.by_token[self.by_token[row["calibrated_sensor_token"]]["sensor_token"]]
            if row["is_key_frame"] and sensor["channel"] == channel:
                found[row["sample_token"]] = row
        return found

    def global_SE3_sensor(self, reading: dict[str, Any]) -> SE3:
        """Return where the sensor was at a reading."""
        pose, calibrated = (
            self.by_token[reading[f"{name}_token"]] for name in ("ego_pose", "calibrated_sensor")
        )
        ego, sensor = (SE3.create(row["rotation"], row["translation"]) for row in (pose, calibrated))
        return ego @ sensor


def draw_lidar_over_camera(dataset: Dataset, camera: str, lidar: str, width: int) -> bytes:
    """Return the picture of the sample in the middle of the first scene that has both, as JPEG."""
    images, clouds = dataset.keyframes(camera), dataset.keyframes(lidar)
    samples = [
        row["token"]
        for row in dataset.rows["sample"]
        if row["scene_token"] == dataset.rows["scene"][0]["token"]
    ]
    both = [token for token in samples if token in images and token in clouds]
    if not both:
        sys.exit(f"the first scene of {dataset.dataroot} has no sample with {camera} and {lidar}")
    image, cloud = images[both[len(both) // 2]], clouds[both[len(both) // 2]]
    (fx, _, cx), (_, fy, cy) = dataset.by_token[image["calibrated_sensor_token"]]["camera_intrinsic"][:2]
    model = CameraModel("none", image["width"], image["height"], fx, fy, cx, cy)
    points = np.asarray(read_lidar_file(dataset.dataroot / cloud["filename"])[:, :3], dtype=np.float64)
    picture = lidar_over_camera(
        read_image(dataset.dataroot / image["filename"]),
        dataset.global_SE3_sensor(cloud).transform_points(points),
        View(model, dataset.global_SE3_sensor(image)),
        width=width,
    )
    return jpeg(picture)


def main() -> None:
    """Read the arguments and write the pictures."""
    parser = argparse.ArgumentParser(
        description="Draw the pictures of the documentation that come from a dataset."
    )
    parser.add_argument("dataroot", type=Path)
    parser.add_argument("version")
    parser.add_argument("--camera", default="CAM_FRONT")
    parser.add_argument("--lidar", default="LIDAR_TOP")
    parser.add_argument("--width", type=int, default=1280)
    parser.add_argument("--output", type=Path, default=PICTURES)
    arguments = parser.parse_args()
    dataset = Dataset(arguments.dataroot, arguments.version)
    arguments.output.mkdir(parents=True, exist_ok=True)
    path = arguments.output / "lidar_over_camera.jpg"
    path.write_bytes(draw_lidar_over_camera(dataset, arguments.camera, arguments.lidar, arguments.width))
    print(path)


if __name__ == "__main__":
    main()
