"""Transforming boxes from the frames in which they were recorded to the global frame."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import CalibrationError
from bagassets.decode.model import BoxReading
from bagassets.geometry.se3 import SE3, Floats, quaternion_multiply, rotate
from bagassets.geometry.tf_tree import TfTree
from bagassets.geometry.trajectory import Trajectory

# The global frame of the dataset: local metres, after the origin was subtracted.
DATASET_FRAME = "@dataset"

# Limits for gaps between transforms, for stationary rigs, whose poses set none.
MAX_GAP_NS, EXTRAPOLATE_NS = 500_000_000, 50_000_000

_Poses = tuple[Floats, Floats, NDArray[np.bool_]]


@dataclass(frozen=True)
class BoxFrames:
    """The frames in which boxes may be given.

    Attributes:
        global_frame: frame of the ego poses.
        ego_frame: frame that moves with the vehicle.
        ego_SE3_sensor: sensor frame -> extrinsics.
        trajectory: `global_SE3_ego`.
        origin_m: the trajectory's origin in the recorded global frame; it is subtracted from boxes in that
            frame, as it was from the poses.
        tree: static and moving transforms of the recording, for further frames; empty if they are not read.
    """

    global_frame: str
    ego_frame: str
    ego_SE3_sensor: Mapping[str, SE3]
    trajectory: Trajectory
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tree: TfTree = field(default_factory=TfTree)

    def knows(self, frame: str) -> bool:
        """Return whether boxes in a frame can be transformed at all."""
        return frame in self._known or frame in self._roots

    def describe(self) -> str:
        """Return a text that names the known frames."""
        sensors = ", ".join(sorted(self.ego_SE3_sensor))
        text = f"the global frame '{self.global_frame}', the ego frame '{self.ego_frame}'"
        text = f"{text} and the sensor frames {sensors}" if sensors else text
        further = [frame for frame in sorted(self._roots) if frame not in self._known]
        return f"{text}; by TF {', '.join(further)}" if further else text

    def place(self, boxes: Sequence[BoxReading]) -> _Poses:
        """Return the boxes in the global frame, each by the transforms at its own stamp.

        Args:
            boxes: N boxes in known frames.

        Returns:
            centres (N, 3) in metres, rotations (N, 4), and a mask (N,) that is False where there is
            no ego pose or transform; there the numbers are NaN.
        """
        centers = np.array([box.frame_SE3_box.translation for box in boxes]).reshape(-1, 3)
        rotations = np.array([box.frame_SE3_box.rotation for box in boxes]).reshape(-1, 4)
        valid = np.ones(len(boxes), dtype=np.bool_)
        stamps_ns = np.array([box.stamp_ns for box in boxes], dtype=np.int64)
        rows: dict[str, list[int]] = {}
        for row, box in enumerate(boxes):
            rows.setdefault(box.frame_id, []).append(row)
        for frame, numbers in sorted(rows.items()):
            at = np.array(numbers, dtype=np.intp)
            moves_with_ego, t, q, known = self._parent_SE3_frame(frame, stamps_ns[at])
            center, rotation = rotate(q, centers[at]) + t, quaternion_multiply(q, rotations[at])
            if moves_with_ego:
                t, q, has_pose = self.trajectory.at(stamps_ns[at])
                center, rotation = rotate(q, center) + t, quaternion_multiply(q, rotation)
                known = known & has_pose
            centers[at], rotations[at], valid[at] = center, rotation, known
        return centers, rotations, valid

    def _parent_SE3_frame(
        self, frame: str, stamps_ns: NDArray[np.int64]
    ) -> tuple[bool, Floats, Floats, NDArray[np.bool_]]:
        """Return whether the parent is the ego frame (else the dataset's global one), and `parent_SE3_frame`."""
        if frame in self._known:
            (moves_with_ego, fixed), number = self._known[frame], len(stamps_ns)
            t, q = np.tile(fixed.translation, (number, 1)), np.tile(fixed.rotation, (number, 1))
            return moves_with_ego, t, q, np.ones(number, dtype=np.bool_)
        root = self._roots.get(frame)
        if root is None:
            raise CalibrationError(
                f"boxes in frame {frame} cannot be transformed; the known frames are {self.describe()}."
            )
        max_gap_ns, extrapolate_ns = MAX_GAP_NS, EXTRAPOLATE_NS
        if not self.trajectory.fixed:
            max_gap_ns, extrapolate_ns = self.trajectory.max_gap_ns, self.trajectory.extrapolate_ns
        t, q, known = self.tree.at(root, frame, stamps_ns, max_gap_ns, extrapolate_ns)
        if root == self.ego_frame:
            return True, t, q, known
        return False, t - np.array(self.origin_m), q, known

    @cached_property
    def _known(self) -> dict[str, tuple[bool, SE3]]:
        """Frame that needs no TF -> whether its parent is the ego frame, and `parent_SE3_frame`."""
        x, y, z = self.origin_m
        return {name: (True, ego_SE3_sensor) for name, ego_SE3_sensor in self.ego_SE3_sensor.items()} | {
            self.ego_frame: (True, SE3()),
            DATASET_FRAME: (False, SE3()),
            self.global_frame: (False, SE3(translation=(-x, -y, -z))),
        }

    @cached_property
    def _roots(self) -> dict[str, str]:
        """Further frame -> the frame, global or ego, that TF relates it to.

        The global one, if the way there does not lead over the vehicle: whose poses are known better.
        """
        roots: dict[str, str] = {}
        for frame in self.tree.frames:
            for root in (self.global_frame, self.ego_frame):
                try:
                    up, down = self.tree.chain(root, frame)
                except CalibrationError:
                    continue
                passed = {edge.parent for edge in (*up, *down)} | {edge.child for edge in (*up, *down)}
                if root == self.ego_frame or self.ego_frame not in passed:
                    roots[frame] = root
                    break
        return roots
