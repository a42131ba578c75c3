"""The fixed frames of a rig, and the transforms between them.

Sources in order of trust: `/tf_static`, the URDF, the joints in `/tf` that never move. `/tf` also
carries the vehicle's motion and is by far the largest; it is read only when the others do not
connect two frames.
"""

from collections.abc import Collection, Sequence
from math import asin, degrees, sqrt

from bagassets.assets.channel import Counts
from bagassets.assets.transform_logs import read_transforms
from bagassets.errors import CalibrationError
from bagassets.geometry.se3 import SE3
from bagassets.geometry.tf_tree import Edge, TfTree
from bagassets.recordings.recording import Recording

__all__ = ["RigFrames"]

# Sources that differ by more are noted.
SAME_M = 0.01
SAME_DEG = 0.5


class RigFrames:
    """Fixed transforms between the frames of a rig.

    Args:
        recording: has the topics.
        tf_static: topics with static transforms.
        tf: topics with transforms, some of which may be fixed joints.
        urdf: fixed joints of the URDF file, if there is one.

    Attributes:
        counts: counts of transforms read and lost, in the topics that were read.
        troubles: topic -> why a message in it could not be decoded, for topics that were read.
    """

    def __init__(
        self, recording: Recording, tf_static: Collection[str], tf: Collection[str], urdf: Sequence[Edge]
    ) -> None:
        self.counts = Counts()
        self.troubles: dict[str, str] = {}
        self._recording = recording
        self._tf = tf
        self._layers: list[list[Edge]] = [
            read_transforms(recording, tf_static, "tf_static", self.counts, troubles=self.troubles),
            list(urdf),
        ]
        self._tree = TfTree(*self._layers)
        self._tf_is_read = not tf

    def fixed(self, dst: str, src: str) -> tuple[SE3, tuple[str, ...]]:
        """Return `dst_SE3_src` and its sources.

        Raises:
            CalibrationError: there is no such transform, or it moves.
        """
        try:
            return self._tree.fixed(dst, src)
        except CalibrationError:
            if self._tf_is_read:
                raise
        self._tf_is_read = True
        moving = read_transforms(self._recording, self._tf, "tf", self.counts, troubles=self.troubles)
        self._layers.append(moving)
        self._tree = TfTree(*self._layers)
        return self._tree.fixed(dst, src)

    def disagreements(self, dst: str, src: str) -> list[str]:
        """Return a text for each source that was read and has another `dst_SE3_src`."""
        dst_SE3_src, used = self.fixed(dst, src)
        notes = []
        for layer in self._layers:
            try:
                other, sources = TfTree(layer).fixed(dst, src)
            except CalibrationError:
                continue  # this source alone does not relate them
            difference = dst_SE3_src.inverse() @ other
            x, y, z = difference.translation
            apart_m = sqrt(x * x + y * y + z * z)
            _, qx, qy, qz = difference.rotation
            apart_deg = degrees(2 * asin(min(1.0, sqrt(qx * qx + qy * qy + qz * qz))))
            if apart_m > SAME_M or apart_deg > SAME_DEG:
                notes.append(
                    f"{'+'.join(sources)} puts {src} {apart_m:.3f} m and {apart_deg:.1f} degrees away from where "
                    f"{'+'.join(used)}, which is used, has it in {dst}"
                )
        return notes
