"""The readings of one channel with their ego poses, from which rows are made."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bagassets.assets.timeline.keyframes import Stamps
from bagassets.base.columns import numbers
from bagassets.base.json_types import JsonObject
from bagassets.formats.json_files import rounded
from bagassets.formats.nuscenes.table_file import quaternion
from bagassets.geometry.se3 import SE3
from bagassets.geometry.trajectory import Trajectory
from bagassets.store.artifact import Artifact


@dataclass(frozen=True, eq=False)
class ChannelReadings:
    """The readings of a channel that have an ego pose at their time, in order of time.

    Poses are rounded as in the tables, so that all values derived from them agree with the tables.

    Attributes:
        channel: canonical name.
        modality: camera, lidar or radar.
        fileformat: jpg, png or pcd.
        intrinsic: K of the images as written, 3 rows of 3; empty if unknown.
        ego_SE3_sensor: extrinsics.
        stamps_ns: (N,) strictly increasing.
        files: names in the artifact.
        digests: content digest of each file.
        sizes_px: width and height of each image; 0, 0 for point files.
        translations: x, y, z of `global_SE3_ego` at each stamp.
        rotations: w, x, y, z of `global_SE3_ego` at each stamp.
        artifact: the artifact with the files.
        without_pose: number of readings left out for want of an ego pose at their time.
    """

    channel: str
    modality: str
    fileformat: str
    intrinsic: list[list[float]]
    ego_SE3_sensor: SE3
    stamps_ns: Stamps
    files: Sequence[str]
    digests: Sequence[str]
    sizes_px: Sequence[tuple[int, int]]
    translations: Sequence[list[float]]
    rotations: Sequence[list[float]]
    artifact: Artifact
    without_pose: int

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def global_SE3_sensor(self, reading: int) -> SE3:
        """Return the pose of the sensor at one reading."""
        return SE3.create(self.rotations[reading], self.translations[reading]) @ self.ego_SE3_sensor

    def path(self, reading: int) -> Path:
        """Return the path of one reading's file."""
        return self.artifact.path(self.files[reading])


def load_readings(
    channel: str, artifact: Artifact, ego_SE3_sensor: SE3, trajectory: Trajectory
) -> ChannelReadings:
    """Read the index of a channel's artifact and interpolate the ego pose at each reading's own time."""
    facts: JsonObject = artifact.read_json("channel.json")
    index = artifact.read_table("index.parquet")
    stamps = numbers(index.column("stamp_ns"))
    positions, rotations, valid = trajectory.at(stamps)
    kept = np.flatnonzero(valid).tolist()
    files, digests = index.column("file").to_pylist(), index.column("digest").to_pylist()
    if facts["modality"] == "camera":
        sizes = list(zip(index.column("width").to_pylist(), index.column("height").to_pylist(), strict=True))
    else:
        sizes = [(0, 0)] * len(stamps)
    return ChannelReadings(
        channel=channel,
        modality=facts["modality"],
        fileformat=facts["fileformat"],
        intrinsic=[rounded(row) for row in facts["camera_intrinsic"]],
        ego_SE3_sensor=SE3.create(quaternion(ego_SE3_sensor.rotation), rounded(ego_SE3_sensor.translation)),
        stamps_ns=stamps[valid],
        files=[files[i] for i in kept],
        digests=[digests[i] for i in kept],
        sizes_px=[sizes[i] for i in kept],
        translations=[rounded(position) for position in positions[valid]],
        rotations=[quaternion(rotation) for rotation in rotations[valid]],
        artifact=artifact,
        without_pose=len(stamps) - len(kept),
    )
