"""The result of every source of ego poses, and helpers that several sources share."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bagassets.assets.asset import inlined, omitted
from bagassets.assets.channel import Counts
from bagassets.assets.transform_logs import RigFrames
from bagassets.base.errors import CalibrationError
from bagassets.base.json_types import JsonObject
from bagassets.geometry.se3 import SE3, Floats
from bagassets.geometry.tf_tree import Edge
from bagassets.geometry.wgs84 import LocalFrame, utm_track
from bagassets.recipe.model_base import Clock, Quaternion, Vector3
from bagassets.recipe.model_poses import MovingPoseSource, TfSource
from bagassets.recordings.model import RawMessage


class Joint(NamedTuple):
    """A fixed joint of a URDF file, `parent_SE3_child`."""

    parent: str
    child: str
    translation: Vector3
    rotation: Quaternion


@dataclass(frozen=True)
class MovingRig:
    """Everything besides the messages that shapes the poses of a moving rig.

    Attributes:
        clock: which time of a message counts.
        ego_frame: the frame whose poses are wanted.
        lost_messages: share of messages that may fail to give a pose.
        urdf: fixed joints of the URDF file; other changes of the file make nothing stale.
        tf_static: topics with static transforms that the recording has.
        tf: topics with transforms that it has.
        source: the source of the poses.
        decoder: the plug-in that decodes the source, if one does.
    """

    clock: Clock
    ego_frame: str
    lost_messages: float
    urdf: tuple[Joint, ...]
    tf_static: tuple[str, ...]
    tf: tuple[str, ...]
    source: MovingPoseSource = inlined()
    decoder: Mapping[str, str] | None = omitted()

    @property
    def source_name(self) -> str:
        """The topic that poses come from, or TF."""
        return "TF" if isinstance(self.source, TfSource) else self.source.topic

    @property
    def joints(self) -> list[Edge]:
        """The fixed joints as edges between frames."""
        return [
            Edge.fixed(joint.parent, joint.child, "urdf", SE3.create(joint.rotation, joint.translation))
            for joint in self.urdf
        ]


@dataclass
class PoseSamples:
    """Samples of `global_SE3_ego` in the order read.

    Attributes:
        stamps_ns: time of each pose.
        poses: the poses.
        global_frame: name of their frame.
        origin: position of that frame on Earth, if known.
        counts: counts of the source's messages.
        failed: those of the lost messages that should have given a pose: damaged or nonsense.
        helpers: counts of other topics that were read, such as an Imu's.
        notes: sentences about assumptions.
        holes_ns: spans of time without poses, however short: between first and last, exclusive.
    """

    stamps_ns: list[int] = field(default_factory=list)
    poses: list[SE3] = field(default_factory=list)
    global_frame: str = ""
    origin: JsonObject | None = None
    counts: Counts = field(default_factory=Counts)
    failed: int = 0
    helpers: dict[str, Counts] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    holes_ns: list[tuple[int, int]] = field(default_factory=list)

    def fail(self, reason: str) -> None:
        """Count a lost message that should have given a pose."""
        self.counts.lose(reason)
        self.failed += 1

    def lose_strays(self, kept: NDArray[np.bool_]) -> None:
        """Count those of (N,) poses, in order of time, as lost that are not kept; at least one is.

        Many sources begin (or end) with positions that they do not know: that is not damage.
        """
        if not kept.all():
            self.counts.lose(
                "its position is out of reach from those before and after it", int((~kept).sum())
            )
            first, last = np.flatnonzero(kept)[[0, -1]]
            self.failed += int((~kept[first:last]).sum())

    def add_mounted(
        self, stamps_ns: list[int], positions_m: Floats, rotations: Floats, sensor_SE3_ego: SE3
    ) -> None:
        """Add poses of the ego frame, given (N, 3) and (N, 4) poses of a sensor in the global frame."""
        self.stamps_ns += stamps_ns
        places = zip(rotations, positions_m, strict=True)
        self.poses += [SE3.create(rotation, position) @ sensor_SE3_ego for rotation, position in places]


def counted_in_poses(source: str) -> str:
    """Return what a `source` of ego poses is counted by: `message`, `packet` or `transform`."""
    return {"ncom": "packet", "tf": "transform"}.get(source, "message")


def stamp_of(clock: Clock, message: RawMessage, header_ns: int | None) -> int:
    """Return the time of a message on the clock of the recipe; log time if it has no header."""
    return header_ns if clock == "header" and header_ns is not None else message.log_time_ns


def mounted(frames: RigFrames, frame: str, ego_frame: str, what: str, samples: PoseSamples) -> SE3:
    """Return `frame_SE3_ego`; identity, with a note, if the mount of the sensor is unknown."""
    if frame == ego_frame:
        return SE3()
    try:
        return frames.fixed(frame, ego_frame)[0]
    except CalibrationError:
        named = f"frame {frame}" if frame else "messages that name no frame"
        samples.notes.append(
            f"No fixed transform relates {ego_frame} to the {what} ({named}); it is taken to sit at the origin of "
            f"{ego_frame}, in line with it."
        )
        return SE3()


def wgs84_origin(frame: LocalFrame) -> JsonObject:
    """Return the position of a local frame on Earth, in the form of `ego_poses.json`."""
    origin = {"kind": "wgs84", "lat": frame.lat_deg, "lon": frame.lon_deg, "alt": frame.alt_m}
    grid = utm_track(np.array([frame.lat_deg]), np.array([frame.lon_deg]))
    if grid.zones == [None]:
        return origin | {"utm_zone": None, "easting": None, "northing": None, "convergence_deg": None}
    return origin | {
        "utm_zone": grid.zones[0],
        "easting": round(float(grid.easting_m[0]), 4),
        "northing": round(float(grid.northing_m[0]), 4),
        "convergence_deg": round(float(grid.convergence_deg[0]), 9),
    }
