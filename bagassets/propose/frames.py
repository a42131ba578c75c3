"""The ego frame of a rig, and which frames are those of camera lenses, guessed from names, TF, odometry and gravity."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from math import cos, hypot, radians, sin

from bagassets.base.errors import CalibrationError
from bagassets.decode.registry import types_of
from bagassets.geometry.se3 import SE3
from bagassets.geometry.tf_tree import Edge as TfEdge
from bagassets.geometry.tf_tree import TfTree
from bagassets.propose.naming import tokens, word_list
from bagassets.propose.sensors import Sensor
from bagassets.propose.summary import Edge, RecordingSummary, TopicSummary

_GLOBAL_FRAMES = ("map", "world", "odom", "earth", "local", "global", "enu", "utm")
_EGO_FRAMES = word_list(
    "base_link base_footprint ego_vehicle ego vehicle vehicle_link base base_frame base_stabilized chassis "
    "chassis_link body body_link car"
)
_USUAL = _EGO_FRAMES[0]
MOUNT = " (a mount that pans, nods or spins? builds do not follow it: leave the channel out)"
# How much of the measured acceleration must point along one axis to call that axis vertical: tilts up to 45 degrees.
_VERTICAL = 0.7
_OPTICAL = SE3.create((0.5, -0.5, 0.5, -0.5), (0.0, 0.0, 0.0))
"""x ahead, y left, z up <- x right, y down, z ahead (REP 103)."""
_YAW_DEG = {
    "FRONT": 0.0,
    "FRONT_LEFT": 45.0,
    "LEFT": 90.0,
    "BACK_LEFT": 135.0,
    "BACK": 180.0,
    "BACK_RIGHT": -135.0,
    "RIGHT": -90.0,
    "FRONT_RIGHT": -45.0,
}


@dataclass(frozen=True)
class EgoFrame:
    """The proposed ego frame.

    Attributes:
        name: the frame.
        reason: why; empty if nothing spoke for it.
        is_sensor: it is put where the only sensor is, which so has no extrinsics to measure.
    """

    name: str
    reason: str
    is_sensor: bool = False


def propose_ego_frame(
    summary: RecordingSummary, sensors: Sequence[Sensor], odometry: TopicSummary | None
) -> EgoFrame:
    """Return the frame that poses and extrinsics should refer to.

    Args:
        summary: the recordings.
        sensors: those that become channels.
        odometry: the odometry topic to prefer, if there is one.
    """
    child = odometry.child_frames[0] if odometry and odometry.child_frames else ""
    known = {frame for edge in summary.transforms for frame in edge} | {child}
    if odometry is not None and _last_part(child) in _EGO_FRAMES:
        return EgoFrame(child, f"child frame of {odometry.name}")
    for name in _EGO_FRAMES:
        if name in known:
            return EgoFrame(name, "a frame of that name is in TF")
        of_robots = [frame for frame in sorted(known) if _last_part(frame) == name]
        if len(of_robots) == 1:
            return EgoFrame(of_robots[0], "a frame of that name is in TF")
    if odometry is not None and child:
        return EgoFrame(child, f"child frame of {odometry.name}")
    frames = list(dict.fromkeys(frame for sensor in sensors for frame in sensor.topic.frames))
    root = _common_root(summary.edges, frames)
    if root and not is_optical(summary, root) and (len(frames) > 1 or root not in frames):
        return EgoFrame(root, "root of the sensors' TF tree")
    if len(frames) != 1:
        return EgoFrame(_USUAL, "")
    (frame,) = frames
    has_cameras = any(sensor.modality == "camera" for sensor in sensors)
    optical = is_optical(summary, frame)
    if optical or (optical is None and has_cameras):
        why = "is an optical frame (z ahead)" if optical else "is taken to be optical (z ahead)"
        return EgoFrame(
            _USUAL, f"the usual name; {frame}, the only sensor frame, {why}", is_sensor=len(sensors) == 1
        )
    return EgoFrame(
        frame, "the only sensor frame; without other frames the sensor itself is the ego", is_sensor=True
    )


def global_frame_of(summary: RecordingSummary, ego_frame: str) -> str:
    """Return the frame in which TF tracks the ego frame; "" if there is none."""
    chain = _line_up(summary.edges, ego_frame)
    links = set(zip(chain[1:], chain, strict=False))
    ancestors = {_last_part(frame): frame for frame in reversed(chain[1:])}
    # A frame called world is often the floor of a laboratory: only believe what moves, or what a mobile robot has.
    if not ancestors or not (links & summary.moving or {"odom", "map"} & ancestors.keys()):
        return ""
    return next((ancestors[name] for name in _GLOBAL_FRAMES if name in ancestors), chain[-1])


def is_optical(summary: RecordingSummary, frame: str) -> bool | None:
    """Tell whether a frame has its z axis ahead and its y axis down; None if neither its name nor gravity tells."""
    if "optical" in tokens(frame):
        return True
    tree = TfTree([TfEdge.fixed(*edge, "tf", value) for edge, value in summary.transforms.items()])
    for imu in summary.topics.values():
        if imu.msgtype not in types_of("imu") or imu.acceleration is None or not imu.frames:
            continue
        try:
            frame_SE3_imu = SE3() if imu.frames[0] == frame else tree.fixed(frame, imu.frames[0])[0]
        except CalibrationError:
            continue
        # What stands still on the Earth is accelerated upwards, as an Imu sees it.
        up = frame_SE3_imu.rotation_matrix @ imu.acceleration
        length = hypot(*up)
        if length > 0 and -up[1] / length > _VERTICAL:
            return True
        if length > 0 and up[2] / length > _VERTICAL:
            return False
    return None


def mounting(modality: str, side: str) -> tuple[float, float, float, float]:
    """Return the rotation (w, x, y, z) ego <- sensor of a level sensor that looks to a side, as in FRONT_LEFT."""
    half = radians(_YAW_DEG.get(side, 0.0)) / 2
    turn = SE3.create((cos(half), 0.0, 0.0, sin(half)), (0.0, 0.0, 0.0))
    rotation = (turn @ _OPTICAL if modality == "camera" else turn).rotation
    # Zero, not -0.0; the sign that reads best.
    sign = -1.0 if rotation[0] < -1e-9 else 1.0
    w, x, y, z = (round(sign * value, 6) + 0.0 for value in rotation)
    return w, x, y, z


def connected(edges: Iterable[Edge], one: str, other: str) -> bool:
    """Tell whether TF leads from one frame to another, in either direction."""
    reached, grown = {one}, True
    edges = list(edges)
    while grown and other not in reached:
        grown = False
        for parent, child in edges:
            if (parent in reached) != (child in reached):
                reached |= {parent, child}
                grown = True
    return other in reached


def contradiction(summary: RecordingSummary, dst: str, src: str) -> str:
    """Return why builds refuse the way from one frame to another, which TF does connect; "" if they do not.

    Transforms may go round in a circle, a frame may have two parents, and a fixed edge several values.
    """
    static, other = (
        [
            TfEdge.fixed(*edge, source, value)
            for edge, value in summary.transforms.items()
            if (edge in summary.static) == is_static
        ]
        for source, is_static in (("tf_static", True), ("tf", False))
    )
    try:
        ways = TfTree(static, other).chain(dst, src) if dst != src else ()
    except CalibrationError as err:
        return str(err)
    moving = [edge for way in ways for edge in way if (edge.parent, edge.child) in summary.moving]
    for one in moving:
        mount = MOUNT if one.source == "tf" else ""
        return f"the transform {one.parent} -> {one.child} ({one.source}) changes{mount}"
    return ""


def _last_part(frame: str) -> str:
    """Return a frame without the name of the robot before it, as in robot1/base_link."""
    return frame.rpartition("/")[2]


def _line_up(edges: Collection[Edge], frame: str) -> list[str]:
    """Return a frame, its parent, and so on up to the root, or around a loop once."""
    parents = {child: parent for parent, child in sorted(edges)}
    line = [frame]
    while line[-1] in parents and parents[line[-1]] not in line:
        line.append(parents[line[-1]])
    return line


def _common_root(edges: Collection[Edge], sensors: list[str]) -> str:
    """Return the topmost frame above all sensors, below any global frame; "" if they share none."""
    if not sensors or not edges:
        return ""
    lines = [
        [frame for frame in _line_up(edges, sensor) if _last_part(frame) not in _GLOBAL_FRAMES]
        for sensor in sensors
    ]
    shared = [frame for frame in lines[0] if all(frame in line for line in lines)]
    return shared[-1] if shared else ""
