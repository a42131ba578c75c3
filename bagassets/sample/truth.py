"""Ground truth of a sample drive, for tests of geometry."""

from dataclasses import dataclass

import numpy as np

from bagassets.geometry.se3 import SE3
from bagassets.sample.rig import EGO_SE3_LIDAR, EGO_SE3_RADAR, Camera
from bagassets.sample.world import World


@dataclass(frozen=True)
class TruthBox:
    """An annotated object at a time: pose in `odom`, size as width, length, height."""

    track_id: int
    category: str
    odom_SE3_box: SE3
    size_m: tuple[float, float, float]


@dataclass(frozen=True)
class Truth:
    """The ground truth of one drive.

    Attributes:
        world: its world.
        start_ns: stamp of its start.
        cameras: channel -> camera.
    """

    world: World
    start_ns: int
    cameras: dict[str, Camera]

    def seconds(self, stamp_ns: int) -> float:
        """Return seconds since the start."""
        return (stamp_ns - self.start_ns) / 1e9

    def odom_SE3_ego(self, stamp_ns: int) -> SE3:
        """Return the pose of the car."""
        return self.world.ego.at(self.seconds(stamp_ns))

    def ego_SE3_sensor(self, channel: str) -> SE3:
        """Return the extrinsics of a sensor."""
        fixed = {"LIDAR_TOP": EGO_SE3_LIDAR, "RADAR_FRONT": EGO_SE3_RADAR}
        return fixed[channel] if channel in fixed else self.cameras[channel].ego_SE3_cam

    def boxes(self, stamp_ns: int) -> list[TruthBox]:
        """Return all annotated objects."""
        boxes = []
        for thing in self.world.things:
            if thing.category:
                centres, yaw = thing.pose(np.array([self.seconds(stamp_ns)]))
                half = float(yaw[0]) / 2
                pose = SE3.create((np.cos(half), 0.0, 0.0, np.sin(half)), centres[0])
                boxes.append(TruthBox(thing.track_id, thing.category, pose, thing.size_m))
        return boxes
