"""The ego frame of a rig and where its poses come from, guessed from frames and topics."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from bagassets.decode.registry import types_of
from bagassets.propose.glance import Edge, Glance, TopicGlance
from bagassets.propose.naming import tokens, word_set

__all__ = ["EgoFrame", "PoseProposal", "connected", "propose_ego_frame", "propose_pose"]

_EGO_FRAMES = (
    "base_link",
    "base_footprint",
    "ego_vehicle",
    "ego",
    "vehicle",
    "vehicle_link",
    "base",
    "base_frame",
    "base_stabilized",
    "chassis",
    "chassis_link",
    "body",
    "body_link",
    "car",
)
_GLOBAL_FRAMES = ("map", "world", "odom", "earth", "local", "global", "enu", "utm")
_ODOMETRY = "nav_msgs/msg/Odometry"  # names the frame whose pose it gives, and so is a source of its own
_COMMANDS = word_set("clicked cmd command desired goal initialpose plan set setpoint target waypoint")
_FUSED = word_set("ekf filtered fused global ground kinematic kinematics localization slam truth ukf")
_FEWEST_POSES = 2


@dataclass(frozen=True)
class EgoFrame:
    """The proposed ego frame; `reason` is empty if nothing spoke for it."""

    name: str
    reason: str


@dataclass(frozen=True)
class PoseProposal:
    """The proposed pose source.

    Attributes:
        fields: fields of `ego_pose`, `source` first; empty if no source was found.
        reasons: field -> why.
        notes: what else to know.
    """

    fields: dict[str, str] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def propose_ego_frame(glance: Glance, sensor_frames: Iterable[str]) -> EgoFrame:
    """Return the frame that poses and extrinsics should refer to."""
    odometry = _odometry(glance)
    child = odometry.child_frames[0] if odometry and odometry.child_frames else ""
    known = {frame for edge in glance.edges for frame in edge} | {child}
    if odometry is not None and child in _EGO_FRAMES:
        return EgoFrame(child, f"child frame of {odometry.name}")
    for name in _EGO_FRAMES:
        if name in known:
            return EgoFrame(name, "a frame of that name is in TF")
    if odometry is not None and child:
        return EgoFrame(child, f"child frame of {odometry.name}")
    sensors = list(dict.fromkeys(sensor_frames))
    root = _common_root(glance.edges, sensors)
    if root and (len(sensors) > 1 or root not in sensors):
        return EgoFrame(root, "root of the sensors' TF tree")
    if len(sensors) == 1:
        return EgoFrame(
            sensors[0], "the only sensor frame; without other frames the sensor itself is the ego"
        )
    return EgoFrame("base_link", "")


def propose_pose(glance: Glance, ego_frame: str) -> PoseProposal:
    """Return the best pose source: odometry, else a pose topic, else NCOM packets, else TF, else GNSS."""
    odometry = _odometry(glance)
    if odometry is not None:
        return _from_odometry(odometry, glance, ego_frame)
    types = set(types_of("pose")) - {_ODOMETRY}
    poses = [t for t in _usable(glance, types) if _COMMANDS.isdisjoint(tokens(t.name))]
    if poses:
        best = max(poses, key=_pose_rank)
        reasons = {"topic": _choice(best, poses, "pose topic")}
        note = f"{best.name} is taken to be the pose of {ego_frame}; `frame` names another one"
        return PoseProposal({"source": "pose", "topic": best.name}, reasons, (note,))
    systems = [topic for topic in glance.topics.values() if topic.ncom_sender is not None]
    if systems:
        return _from_ncom(systems, ego_frame)
    chain = _global_frame(glance, ego_frame)
    if chain:
        reasons = {"global_frame": f"ancestor of {ego_frame} in TF"}
        still = ("nothing in TF moved in the first seconds of the recordings",)
        notes = () if glance.moving else still
        return PoseProposal({"source": "tf", "global_frame": chain}, reasons, notes)
    fixes = _usable(glance, types_of("fix"))
    if fixes:
        best = max(fixes, key=_pose_rank)
        fields = {"source": "navsat", "topic": best.name}
        reasons = {"topic": _choice(best, fixes, "NavSatFix topic")}
        imus = [t for t in _usable(glance, types_of("imu")) if t.oriented]
        if imus:
            imu = max(imus, key=_pose_rank)
            fields["imu"] = imu.name
            reasons["imu"] = _choice(imu, imus, "Imu with orientation")
            return PoseProposal(fields, reasons, ("the Imu's orientation must be east-north-up (REP 103)",))
        return PoseProposal(fields, reasons, ("no Imu gives orientation; the course over ground is used",))
    return PoseProposal()


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


def _usable(glance: Glance, types: Iterable[str]) -> list[TopicGlance]:
    """Return the topics of some types; those whose messages decoders refused only if there are no others."""
    topics = [
        topic
        for topic in glance.topics.values()
        if topic.msgtype in set(types) and topic.count >= _FEWEST_POSES and topic.problem is None
    ]
    return [topic for topic in topics if topic.refusal is None] or topics


def _odometry(glance: Glance) -> TopicGlance | None:
    topics = _usable(glance, {_ODOMETRY})
    return max(topics, key=_pose_rank) if topics else None


def _pose_rank(topic: TopicGlance) -> tuple[bool, int, str]:
    return not _FUSED.isdisjoint(tokens(topic.name)), topic.count, topic.name


def _choice(best: TopicGlance, among: list[TopicGlance], what: str) -> str:
    others = [topic.name for topic in among if topic is not best]
    return f"the only {what}" if not others else f"also there: {', '.join(others)}"


def _from_odometry(topic: TopicGlance, glance: Glance, ego_frame: str) -> PoseProposal:
    reasons = {"topic": _choice(topic, _usable(glance, {_ODOMETRY}), "odometry topic")}
    child = topic.child_frames[0] if topic.child_frames else ""
    notes: tuple[str, ...] = ()
    if not child:
        notes = (f"{topic.name} does not name its child frame; it is taken to be {ego_frame}",)
    elif not connected(glance.edges, child, ego_frame):
        notes = (f"not guessed: no transform leads from {child}, which {topic.name} tracks, to {ego_frame}",)
    return PoseProposal({"source": "odometry", "topic": topic.name}, reasons, notes)


def _from_ncom(topics: list[TopicGlance], ego_frame: str) -> PoseProposal:
    best = max(topics, key=_pose_rank)
    fields = {"source": "ncom", "topic": best.name}
    reasons = {"topic": _choice(best, topics, "topic with OxTS NCOM packets")}
    if best.ncom_sender:
        fields["sender"] = best.ncom_sender
        reasons["sender"] = "the first packets came from there"
    note = f"the navigation system is taken to give the pose of {ego_frame}; `frame` names another one"
    return PoseProposal(fields, reasons, (note,))


def _global_frame(glance: Glance, ego_frame: str) -> str:
    """Return the frame in which TF tracks the ego frame; "" if there is none."""
    parents = {child: parent for parent, child in sorted(glance.edges)}
    chain = [ego_frame]
    while chain[-1] in parents and parents[chain[-1]] not in chain:
        chain.append(parents[chain[-1]])
    links = set(zip(chain[1:], chain, strict=False))
    ancestors = chain[1:]
    # A frame called world is often the floor of a laboratory: only believe what moves, or what a mobile robot has.
    if not ancestors or not (links & glance.moving or {"odom", "map"} & set(ancestors)):
        return ""
    return next((name for name in _GLOBAL_FRAMES if name in ancestors), ancestors[-1])


def _common_root(edges: Iterable[Edge], sensors: list[str]) -> str:
    """Return the topmost frame above all sensors, below any global frame; "" if they share none."""
    parents = {child: parent for parent, child in sorted(edges)}
    lines = []
    for sensor in sensors:
        line = [sensor]
        while line[-1] in parents and parents[line[-1]] not in line:
            line.append(parents[line[-1]])
        lines.append([frame for frame in line if frame not in _GLOBAL_FRAMES])
    if not lines or len(parents) == 0:
        return ""
    shared = [frame for frame in lines[0] if all(frame in line for line in lines)]
    return shared[-1] if shared else ""
