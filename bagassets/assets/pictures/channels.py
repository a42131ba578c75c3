"""Images and clouds of a recording for pictures: by time, with the pose of the sensor, and the pixels of points in images."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bagassets.assets.lidar_file import read_lidar_file
from bagassets.assets.pictures.canvas import Image, read_image, read_reduced, within
from bagassets.base.columns import numbers
from bagassets.base.json_types import JsonMapping
from bagassets.geometry.calibration import CameraLens
from bagassets.geometry.camera import CameraModel
from bagassets.geometry.se3 import SE3, Floats
from bagassets.geometry.trajectory import Trajectory
from bagassets.store.artifact import Artifact

NEAREST_M = 0.5
_DARK_PERCENT, _WHITE_PERCENT = 1, 99


@dataclass(frozen=True)
class View:
    """A camera at one moment.

    Attributes:
        camera: model of the image as written.
        global_SE3_cam: where it was; z points forward, y down.
    """

    camera: CameraModel
    global_SE3_cam: SE3

    def project(self, points_global: Floats, scale: float = 1.0) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Project (N, 3) points in the global frame.

        Args:
            points_global: metres.
            scale: pixels of the picture per pixel of the image.

        Returns:
            (N, 2) pixels u, v of the picture; (N,) distance along the optical axis in metres; and a mask (N,)
            of the points that are in front of the camera and inside the picture.
        """
        points_cam = self.global_SE3_cam.inverse().transform_points(points_global)
        pixels, in_front = self.camera.project(points_cam)
        depth = points_cam[:, 2]
        inside = (pixels >= -0.5).all(axis=1)
        inside &= (pixels[:, 0] < self.camera.width - 0.5) & (pixels[:, 1] < self.camera.height - 0.5)
        # Far outside its image a lens model may fold back into it, so only points in the cone of visible rays count.
        limit = 2.0 * max(self.camera.width / self.camera.fx, self.camera.height / self.camera.fy)
        inside &= np.abs(points_cam[:, :2]).max(axis=1) <= limit * np.maximum(depth, 0.0)
        # Pixel centres are at integers, before and after scaling.
        return (pixels + 0.5) * scale - 0.5, depth, in_front & inside & (depth > NEAREST_M)


@dataclass(frozen=True, eq=False)
class _Readings:
    """The readings of one channel.

    Attributes:
        channel: its name.
        artifact: artifact with the files.
        stamps_ns: (N,) increasing.
        files: names in the artifact.
        ego_SE3_sensor: extrinsics.
    """

    channel: str
    artifact: Artifact
    stamps_ns: NDArray[np.int64]
    files: Sequence[str]
    ego_SE3_sensor: SE3

    def path(self, reading: int) -> Path:
        """Return the file of a reading."""
        return self.artifact.path(self.files[reading])

    def global_SE3_sensor(self, reading: int, trajectory: Trajectory) -> SE3 | None:
        """Return where the sensor was at the time of a reading; None without an ego pose at that time."""
        global_SE3_ego = trajectory.pose_at(int(self.stamps_ns[reading]))
        return None if global_SE3_ego is None else global_SE3_ego @ self.ego_SE3_sensor


@dataclass(frozen=True, eq=False)
class CameraImages(_Readings):
    """The images of one camera.

    Attributes:
        widths: (N,) of the images, in pixels.
        camera: model of the images as written; None if unknown.
        facts: of the channel, as `channel.json` has them.
    """

    widths: NDArray[np.int32]
    camera: CameraModel | None
    facts: JsonMapping

    @classmethod
    def of(
        cls, channel: str, artifact: Artifact, ego_SE3_cam: SE3, lens: CameraLens | None
    ) -> "CameraImages":
        """Return the images in an artifact.

        Args:
            channel: its name.
            artifact: artifact of the channel.
            ego_SE3_cam: extrinsics as calibrated.
            lens: that of the images, if they were written with their distortion, else None.
        """
        index = artifact.read_table("index.parquet", ["stamp_ns", "file", "width", "height"])
        facts = artifact.read_json("channel.json")
        intrinsic = facts["camera_intrinsic"]
        camera = None
        if lens is not None:
            camera = CameraModel.from_calibration(lens)
        elif intrinsic and index.num_rows:
            (fx, _, cx), (_, fy, cy) = intrinsic[:2]
            size = index.column("width")[0].as_py(), index.column("height")[0].as_py()
            camera = CameraModel("none", *size, fx, fy, cx, cy)
        return cls(
            channel,
            artifact,
            numbers(index.column("stamp_ns")),
            index.column("file").to_pylist(),
            ego_SE3_cam.normalised(),
            numbers(index.column("width")),
            camera,
            facts,
        )

    def read(self, image: int) -> Image:
        """Return an image, of 16 bits in the range of `levels`."""
        return self._shown(read_image(self.path(image)))

    def read_reduced(self, image: int, least_width: int) -> Image:
        """Return an image, smaller if it is much wider than `least_width`; see `read_reduced`."""
        return self._shown(read_reduced(self.path(image), int(self.widths[image]), least_width))

    def _shown(self, image: NDArray[Any]) -> Image:
        return image if image.dtype == np.uint8 else within(*(self.levels or (0, 65_535)), image)

    @cached_property
    def levels(self) -> tuple[int, int] | None:
        """The range in which images of 16 bits are shown, such as depth: percentiles of first, middle and last; None for 8 bits."""
        if self.facts["fileformat"] != "png":
            return None
        last = len(self.files) - 1
        images = [read_image(self.path(image)) for image in sorted({0, last // 2, last})]
        known = [image[image > 0] for image in images if image.dtype == np.uint16]
        if not any(map(len, known)):
            return None
        low, high = np.percentile(np.concatenate(known), (_DARK_PERCENT, _WHITE_PERCENT), method="nearest")
        return int(low), int(high)

    @property
    def title(self) -> str:
        """The name, and the range of levels if it is not all that there are."""
        if self.levels is None:
            return self.channel
        if "depth" not in self.facts:
            return "{}, grey {} to {}".format(self.channel, *self.levels)
        low_m, high_m = (level * self.facts["depth"]["unit_m"] for level in self.levels)
        return f"{self.channel}, {low_m:.2f} to {high_m:.2f} m"

    def view(self, image: int, trajectory: Trajectory) -> View | None:
        """Return the camera at the time of an image; None without intrinsics, or without an ego pose at that time."""
        global_SE3_cam = self.global_SE3_sensor(image, trajectory)
        return None if self.camera is None or global_SE3_cam is None else View(self.camera, global_SE3_cam)


@dataclass(frozen=True, eq=False)
class Clouds(_Readings):
    """The revolutions of one lidar."""

    @classmethod
    def of(cls, channel: str, artifact: Artifact, ego_SE3_lidar: SE3) -> "Clouds":
        """Return the revolutions in an artifact, of a lidar with these extrinsics."""
        index = artifact.read_table("index.parquet", ["stamp_ns", "file"])
        return cls(
            channel,
            artifact,
            numbers(index.column("stamp_ns")),
            index.column("file").to_pylist(),
            ego_SE3_lidar.normalised(),
        )

    def points_global(self, revolution: int, trajectory: Trajectory) -> Floats | None:
        """Return the (N, 3) points of a revolution in the global frame, metres; None without an ego pose at its time."""
        global_SE3_lidar = self.global_SE3_sensor(revolution, trajectory)
        if global_SE3_lidar is None:
            return None
        points_lidar = read_lidar_file(self.path(revolution))[:, :3]
        return global_SE3_lidar.transform_points(points_lidar.astype(np.float64))
