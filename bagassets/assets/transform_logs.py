"""The transforms of a recording: its TF topics as edges, with every sample accounted for, and the fixed frames of its rig.

Sources of the latter in order of trust: `/tf_static`, the URDF, the joints in `/tf` that never move. `/tf` also
carries the vehicle's motion and is by far the largest; it is read only when the others do not
connect two frames.
"""

from collections.abc import Collection, Sequence
from math import asin, degrees, sqrt
from pathlib import Path

from bagassets.assets.asset import Facts
from bagassets.assets.channel import Counts
from bagassets.base.errors import CalibrationError, DecodeError
from bagassets.decode.loading import own_decoder
from bagassets.decode.poses import decode_transform
from bagassets.geometry.se3 import SE3
from bagassets.geometry.tf_tree import Edge, TfTree, TransformLog
from bagassets.recipe.model_base import Clock
from bagassets.recordings.recording import Recording

# Sources that differ by more are noted.
SAME_M = 0.01
SAME_DEG = 0.5


def read_transforms(
    recording: Recording,
    topics: Collection[str],
    source: str,
    counts: Counts | None = None,
    *,
    clock: Clock = "header",
    troubles: dict[str, str] | None = None,
) -> list[Edge]:
    """Return the edges in `topics`.

    Args:
        recording: has the topics.
        topics: topics of transforms.
        source: name of the source, for edges.
        counts: gets the numbers of transforms read and lost.
        clock: which time of a transform counts: its header stamp, or the log time of its message.
        troubles: gets, for each topic with transforms that cannot be decoded, the first reason.
    """
    log = TransformLog(source)
    counts = counts if counts is not None else Counts()
    troubles = troubles if troubles is not None else {}
    for message in recording.messages(topics) if topics else ():
        try:
            stamped = own_decoder("transforms", message.msgtype)(recording.decode(message))
        except DecodeError as err:
            counts.read += 1
            counts.lose(str(err))
            troubles.setdefault(message.topic, str(err))
            continue
        for transform in stamped:
            counts.read += 1
            try:
                reading = decode_transform(transform)
            except DecodeError as err:
                counts.lose(str(err))
                troubles.setdefault(message.topic, str(err))
                continue
            stamp_ns = reading.stamp_ns if clock == "header" else message.log_time_ns
            log.add(reading.parent, reading.child, stamp_ns, reading.parent_SE3_child, message.topic)
            counts.written += 1
    return log.edges()


def read_urdf(path: Path, facts: Facts) -> bytes:
    """Return the content of the URDF file that a recipe names.

    Raises:
        CalibrationError: it cannot be read.
    """
    try:
        return facts.file(path)
    except OSError as err:
        raise CalibrationError(f"{path}: the URDF cannot be read ({err.strerror}).") from err


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
