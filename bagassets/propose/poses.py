"""Where the poses of a rig come from, guessed from topics and frames."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

from bagassets.decode.registry import types_of
from bagassets.decode.robots import robot_of
from bagassets.propose.frames import connected, global_frame_of, is_optical
from bagassets.propose.naming import tokens, word_set
from bagassets.propose.summary import RecordingSummary, TopicSummary

_ODOMETRY = {
    "nav_msgs/msg/Odometry",
    "foxglove_msgs/msg/Odometry",
}  # names the frame whose pose it gives, and so is a source of its own
_COMMANDS = word_set("clicked cmd command desired goal initialpose plan set setpoint target waypoint")
_FUSED = word_set(
    "ekf filtered fused global ground groundtruth gt kinematic kinematics localization slam truth ukf"
)
_FEWEST_POSES = 2
# Of mavros: fixes of the receiver as odometry; beside it is what the filter makes of them.
_UNFILTERED = "/global_position/local"

SourceKey = tuple[str, str, str]
"""Kind of source, its topic or global frame, and the frame whose pose it gives: equal for what is one source."""


@dataclass(frozen=True)
class PoseProposal:
    """A proposed pose source.

    Attributes:
        fields: fields of `ego_pose`, `source` first; empty if no source was found.
        reasons: field -> why.
        notes: what else to know.
        gap: why the build cannot get from these poses to those of the ego frame; "" if it can.
        tracked: frame whose pose a topic says it gives; "" if it does not say.
    """

    fields: dict[str, str] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    gap: str = ""
    tracked: str = ""

    @property
    def key(self) -> SourceKey:
        """What makes it the same source in another recording."""
        place = self.fields.get("topic") or self.fields.get("global_frame", "")
        return self.fields.get("source", ""), place, self.tracked


def propose_pose(
    summary: RecordingSummary, ego_frame: str, allowed: Collection[SourceKey] | None = None
) -> PoseProposal:
    """Return the best pose source, empty if there is none.

    Args:
        summary: the recordings.
        ego_frame: frame whose poses are needed.
        allowed: sources that all of the recordings have, if there are several recordings; where these have none in
            common, any source will do.
    """
    candidates = pose_candidates(summary, ego_frame)
    shared = [one for one in candidates if allowed is None or one.key in allowed]
    return next(iter(shared or candidates), PoseProposal())


def pose_candidates(summary: RecordingSummary, ego_frame: str) -> list[PoseProposal]:
    """Return all pose sources, the best first: odometry, pose topics, NCOM packets, TF, GNSS."""
    odometry = _usable(summary, _ODOMETRY)
    found = [_from_odometry(topic, odometry, summary, ego_frame) for topic in odometry]
    poses = [
        topic
        for topic in _usable(summary, set(types_of("pose")) - _ODOMETRY)
        if _COMMANDS.isdisjoint(tokens(topic.name))
    ]
    found += [_from_pose(topic, poses, summary, ego_frame) for topic in poses]
    found.sort(key=lambda one: one.fields["topic"].endswith(_UNFILTERED))
    systems = _ranked(summary, (topic for topic in summary.topics.values() if topic.ncom_sender is not None))
    found += [_from_ncom(topic, systems, ego_frame) for topic in systems]
    global_frame = global_frame_of(summary, ego_frame)
    if global_frame:
        reasons = {"global_frame": f"ancestor of {ego_frame} in TF"}
        still = ("nothing in TF moved in the first seconds of the recordings",)
        fields = {"source": "tf", "global_frame": global_frame}
        found.append(PoseProposal(fields, reasons, () if summary.moving else still))
    fixes = _usable(summary, types_of("fix"))
    imus = [topic for topic in _usable(summary, types_of("imu")) if topic.oriented]
    found += [_from_fixes(topic, fixes, imus) for topic in fixes]
    return found


def odometry_of(summary: RecordingSummary) -> TopicSummary | None:
    """Return the odometry topic to prefer; None if there is none."""
    return next(iter(_usable(summary, _ODOMETRY)), None)


def lonely_poses(summary: RecordingSummary) -> list[str]:
    """Return the topics of which there is one pose or fix, too few to follow a vehicle."""
    types = {*types_of("pose"), *types_of("fix")}
    return [t.name for t in summary.topics.values() if t.msgtype in types and 0 < t.count < _FEWEST_POSES]


def _usable(summary: RecordingSummary, types: Iterable[str]) -> list[TopicSummary]:
    """Return the topics of some types, best first; those whose messages decoders refused only if there are no others."""
    wanted = set(types)
    topics = [
        topic
        for topic in summary.topics.values()
        if topic.msgtype in wanted and topic.count >= _FEWEST_POSES and topic.problem is None
    ]
    return _ranked(summary, [topic for topic in topics if topic.refusal is None] or topics)


def _ranked(summary: RecordingSummary, topics: Iterable[TopicSummary]) -> list[TopicSummary]:
    return sorted(
        topics,
        # Of equal ones, that of a namespace may be another robot's, and that of no robot another's without sensors.
        key=lambda topic: (
            robot_of(topic.name, summary.robots) is not None,
            not topic.name.endswith(_UNFILTERED),
            not _FUSED.isdisjoint(tokens(topic.name)),
            topic.count,
            -topic.name.count("/"),
            topic.name,
        ),
        reverse=True,
    )


def _choice(topic: TopicSummary, among: list[TopicSummary], what: str) -> str:
    others = [other.name for other in among if other is not topic]
    return f"the only {what}" if not others else f"also there: {', '.join(others)}"


def _from_odometry(
    topic: TopicSummary, among: list[TopicSummary], summary: RecordingSummary, ego_frame: str
) -> PoseProposal:
    reasons = {"topic": _choice(topic, among, "odometry topic")}
    child = topic.child_frames[0] if topic.child_frames else ""
    notes: tuple[str, ...] = ()
    gap = ""
    if not child:
        notes = (f"{topic.name} does not name its child frame; it is taken to be {ego_frame}",)
    elif not connected(summary.edges, child, ego_frame):
        gap = f"no transform leads from {child}, which {topic.name} tracks, to {ego_frame}"
    elif child == ego_frame and is_optical(summary, child):
        notes = (f"{child} is an optical frame, with z ahead; datasets expect an ego frame with z up",)
    return PoseProposal({"source": "odometry", "topic": topic.name}, reasons, notes, gap, child)


def _from_pose(
    topic: TopicSummary, among: list[TopicSummary], summary: RecordingSummary, ego_frame: str
) -> PoseProposal:
    fields, reasons = {"source": "pose", "topic": topic.name}, {"topic": _choice(topic, among, "pose topic")}
    if topic.child_frames and connected(summary.edges, topic.child_frames[0], ego_frame):
        return PoseProposal(fields, reasons, (), "", topic.child_frames[0])
    if topic.child_frames:
        fields["frame"] = ego_frame
        reasons["frame"] = (
            f"no transform leads from {topic.child_frames[0]}, whose pose it is, to the ego frame"
        )
    note = f"{topic.name} is taken to be the pose of {ego_frame}; `frame` names another one"
    return PoseProposal(fields, reasons, (note,))


def _from_ncom(topic: TopicSummary, among: list[TopicSummary], ego_frame: str) -> PoseProposal:
    fields = {"source": "ncom", "topic": topic.name}
    reasons = {"topic": _choice(topic, among, "topic with OxTS NCOM packets")}
    if topic.ncom_sender:
        fields["sender"] = topic.ncom_sender
        reasons["sender"] = "the first packets came from there"
    note = f"the navigation system is taken to give the pose of {ego_frame}; `frame` names another one"
    return PoseProposal(fields, reasons, (note,))


def _from_fixes(topic: TopicSummary, among: list[TopicSummary], imus: list[TopicSummary]) -> PoseProposal:
    fields = {"source": "navsat", "topic": topic.name}
    reasons = {"topic": _choice(topic, among, "NavSatFix topic")}
    if not imus:
        return PoseProposal(fields, reasons, ("no Imu gives orientation; the course over ground is used",))
    fields["imu"] = imus[0].name
    reasons["imu"] = _choice(imus[0], imus, "Imu with orientation")
    return PoseProposal(fields, reasons, ("the Imu's orientation must be east-north-up (REP 103)",))
