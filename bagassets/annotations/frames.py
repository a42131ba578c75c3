"""Bringing boxes from the frame they were recorded in to the global frame."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.decode.model import BoxReading
from bagassets.geometry.se3 import SE3, Floats, quaternion_multiply, rotate
from bagassets.geometry.trajectory import Trajectory

__all__ = ["DATASET_FRAME", "BoxFrames"]

# The global frame as the dataset has it: local metres, after the origin was taken off.
DATASET_FRAME = "@dataset"


@dataclass(frozen=True)
class BoxFrames:
    """The frames that boxes may be given in.

    Attributes:
        global_frame: frame of the ego poses.
        ego_frame: frame that moves with the vehicle.
        ego_SE3_sensor: sensor frame -> extrinsics.
        trajectory: `global_SE3_ego`.
        origin_m: where the trajectory's origin lies in the global frame as recorded; boxes in that
            frame are moved by it like the poses were.
    """

    global_frame: str
    ego_frame: str
    ego_SE3_sensor: Mapping[str, SE3]
    trajectory: Trajectory
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def knows(self, frame: str) -> bool:
        """Tell whether boxes in a frame can be placed at all."""
        known = (self.global_frame, DATASET_FRAME, self.ego_frame)
        return frame in known or frame in self.ego_SE3_sensor

    def known(self) -> str:
        """Return the frames in words."""
        sensors = ", ".join(sorted(self.ego_SE3_sensor))
        words = f"the global frame '{self.global_frame}', the ego frame '{self.ego_frame}'"
        return f"{words} and the sensor frames {sensors}" if sensors else words

    def place(self, boxes: Sequence[BoxReading]) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return the boxes in the global frame, each moved with the ego pose at its own stamp.

        Args:
            boxes: N boxes in frames that are known.

        Returns:
            centres (N, 3) in metres, rotations (N, 4), and a mask (N,) that is False where there is
            no ego pose; there the numbers are NaN.
        """
        if not boxes:
            return np.zeros((0, 3)), np.zeros((0, 4)), np.ones(0, np.bool_)
        ego_SE3_frame = [self._ego_SE3_frame(box.frame_id) for box in boxes]
        centers = np.array([box.frame_SE3_box.translation for box in boxes])
        rotations = np.array([box.frame_SE3_box.rotation for box in boxes])
        moves = np.array([frame is not None for frame in ego_SE3_frame])
        as_recorded = np.array([box.frame_id == self.global_frame for box in boxes])
        centers = np.where(as_recorded[:, None], centers - np.array(self.origin_m), centers)
        if not moves.any():
            return centers, rotations, np.ones(len(boxes), np.bool_)

        sensor = [frame or SE3() for frame in ego_SE3_frame]
        sensor_rotations = np.array([frame.rotation for frame in sensor])
        ego_centers = rotate(sensor_rotations, centers) + np.array([frame.translation for frame in sensor])
        ego_rotations = quaternion_multiply(sensor_rotations, rotations)
        t, q, valid = self.trajectory.at(np.array([box.stamp_ns for box in boxes], dtype=np.int64))
        return (
            np.where(moves[:, None], rotate(q, ego_centers) + t, centers),
            np.where(moves[:, None], quaternion_multiply(q, ego_rotations), rotations),
            valid | ~moves,
        )

    def _ego_SE3_frame(self, frame: str) -> SE3 | None:
        """Return where a frame is on the vehicle; None for the global frame."""
        if frame in (self.global_frame, DATASET_FRAME):
            return None
        return SE3() if frame == self.ego_frame else self.ego_SE3_sensor[frame]
