"""Which topics of a robot without lidar are signals, and the LeRobot dataset that could be made of it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from math import ceil
from typing import TYPE_CHECKING, Literal

from bagassets.base.errors import DecodeError
from bagassets.base.escaping import yaml_scalar
from bagassets.decode.numeric_fields import numbers_at
from bagassets.propose.commented_yaml import Sheet
from bagassets.propose.naming import free_name, tokens, word_set
from bagassets.propose.summary import RecordingSummary, TopicSummary
from bagassets.recordings.model import Message

if TYPE_CHECKING:
    from bagassets.propose.rigs import RigProposal

_Role = Literal["state", "command", "episode"]

_JOINTS = "joints"
# Type -> its fields, and what they are: joints are commanded if the topic's name says so.
_KINDS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "sensor_msgs/msg/JointState": (("position",), _JOINTS),
    "foxglove_msgs/msg/JointStates": (("joints.position",), _JOINTS),
    "trajectory_msgs/msg/JointTrajectory": (("points[0].positions",), "command"),
    "std_msgs/msg/Float64MultiArray": (("data",), "array"),
    "std_msgs/msg/Float32MultiArray": (("data",), "array"),
    "geometry_msgs/msg/Twist": (("linear", "angular"), "command"),
    "geometry_msgs/msg/TwistStamped": (("twist",), "velocity"),
    "std_msgs/msg/Bool": (("data",), "episode"),
    "std_msgs/msg/Float64": (("data",), "number"),
    "std_msgs/msg/Float32": (("data",), "number"),
}
_TEXTS = {"std_msgs/msg/String": "data", "foxglove_msgs/msg/Log": "message"}
_COMMANDS = word_set(
    "action actions cmd cmds command commanded commands desired gello goal leader master reference setpoint target targets "
    "teleop traj trajectory"
)
# By their names they might be commands, or measured; but none of these has numbers that a robot follows.
_NO_COMMANDS = {
    *_TEXTS,
    *(f"{package}/msg/GoalStatusArray" for package in ("action_msgs", "actionlib_msgs")),
    *(f"visualization_msgs/msg/{kind}" for kind in ("Marker", "MarkerArray")),
    *(f"sensor_msgs/msg/{kind}" for kind in ("CameraInfo", "TimeReference")),
    "nav_msgs/msg/Path",
}
_EPISODES, _TASKS = (
    word_set("episode episodes"),
    word_set("instruction instructions language prompt task tasks"),
)
_STARTS = word_set("begin begins started start")
_ENDS = word_set(
    "abort aborted canceled cancelled discard done end ended ends fail failed failure finish finished stop stopped success"
)
_TOOLS = word_set("broadcaster ee eef effector flange gripper hand tcp tool wrist")
_OPENINGS = word_set("gripper opening position state width")
_LONGEST_TEXT, _MOST_FPS = 100, 50
_ALIKE = 0.2  # share by which rates may differ


@dataclass(frozen=True)
class SignalProposal:
    """A signal before it is written down.

    Attributes:
        name: its name in the recipe.
        topic: its topic.
        fields: paths of its fields.
        names: its elements, if the messages name them.
        by_log_time: the messages have no header, or a stamp of zero.
        role: what it is.
        rate_hz: how often it has values; None if too little was read.
    """

    name: str
    topic: TopicSummary
    fields: tuple[str, ...]
    names: tuple[str, ...]
    by_log_time: bool
    role: _Role
    rate_hz: float | None = None


def elements_of(message: Message, msgtype: str) -> tuple[str, ...]:
    """Return what the numbers of a message are called, if messages of its type may be a signal; none if they hold none."""
    fields, _ = _KINDS.get(msgtype, ((), ""))
    try:
        return tuple(label for path in fields for label in numbers_at(message, path).labels)
    except DecodeError:
        return ()


def text_in(message: Message, msgtype: str) -> str:
    """Return a short text that a message is; "" if it is none."""
    text = getattr(message, _TEXTS[msgtype]) if msgtype in _TEXTS else ""
    return text if isinstance(text, str) and len(text) <= _LONGEST_TEXT else ""


def says_episodes(topic: str, msgtype: str) -> bool:
    """Tell whether a topic's texts say where episodes are, by its type and name."""
    return msgtype in _TEXTS and not _EPISODES.isdisjoint(tokens(topic))


def find_signals(summary: RecordingSummary, *, cameras: bool = False) -> list[SignalProposal]:
    """Return the signals of recordings, states first, in order of topic; drivers that share a topic have one each.

    Args:
        summary: the recordings.
        cameras: they have cameras; what was commanded alone makes no dataset.
    """
    found: list[SignalProposal] = []
    shared = _shared_words(summary)
    for topic in summary.topics.values():
        fields, kind = _KINDS.get(topic.msgtype, ((), ""))
        role = _role(topic, kind)
        if role == "command" and kind == _JOINTS and not set(tokens(topic.name)) & _COMMANDS - shared:
            role = "state"
        if not topic.elements or role is None:
            continue
        named = kind == _JOINTS or topic.msgtype.endswith("/JointTrajectory")
        base = "_".join(tokens(topic.name)) or "signal"
        groups = _apart(topic.elements) if named else [()]
        for group in groups:
            # A state and a command of the same joints have them in one order.
            names = next((one.names for one in found if set(one.names) == set(group)), group)
            taken = [one.name for one in found]
            name = free_name(base if base[0].isalpha() else f"signal_{base}", taken, "_")
            share = [one.issuperset(group) for one in set(map(frozenset, topic.elements))]  # by turns
            rate_hz = topic.rate_hz and topic.rate_hz * sum(share) / len(share)
            found.append(SignalProposal(name, topic, fields, names, topic.offset_s is None, role, rate_hz))
    order: tuple[_Role, ...] = ("state", "command", "episode")
    found.sort(key=lambda one: (order.index(one.role), one.topic.name))
    roles = {one.role for one in found}
    return found if "state" in roles or (cameras and "command" in roles) else []


def _shared_words(summary: RecordingSummary) -> set[str]:
    """Return the words that all topics of joints share, such as a namespace `teleop`, if others tell which are commands."""
    topics = [one for one in summary.topics.values() if _KINDS.get(one.msgtype, ((), ""))[1] == _JOINTS]
    names = [set(tokens(topic.name)) for topic in topics if topic.elements]
    shared = set[str]().union(*names).intersection(*names)
    return shared if any(words & _COMMANDS - shared for words in names) else set()


def _role(topic: TopicSummary, kind: str) -> _Role | None:
    words = tokens(topic.name)
    is_gripper = kind == "number" and "gripper" in words
    if sounds_commanded(topic) and (is_gripper or kind in {_JOINTS, "array", "velocity"}):
        return "command"
    if kind == _JOINTS or (is_gripper and words[-1] in _OPENINGS):
        return "state"
    if kind == "episode":  # whether one succeeded is said behind it
        return "episode" if set(words) & _EPISODES and not set(words) & _ENDS else None
    return "command" if kind == "command" else None


def sounds_commanded(topic: TopicSummary) -> bool:
    """Tell whether a topic is one of commands by its name."""
    return bool(set(tokens(topic.name)) & _COMMANDS)


def is_of_tool(topic: TopicSummary) -> bool:
    """Tell whether a pose or the like is that of an arm's tool by its name."""
    return topic.msgtype.startswith("geometry_msgs/") and not _TOOLS.isdisjoint(tokens(topic.name))


def word_on(topic: TopicSummary, *, beside_signals: bool) -> str:
    """Return what to say of a topic that is no signal but might be one; "" if it might not."""
    _, kind = _KINDS.get(topic.msgtype, ((), ""))
    if not beside_signals:
        joints = "joints, beside a lidar or radar; `signals` and `lerobot` in the recipe make a dataset of them, too"
        return joints if kind == _JOINTS and topic.elements else ""
    if topic.msgtype in _NO_COMMANDS:
        return ""
    if sounds_commanded(topic):
        return "commands, by its name; if the robot follows them, describe them in `signals`, and add them to `action`"
    if kind == "velocity" or is_of_tool(topic) or "gripper" in tokens(topic.name):
        return "measured, by type and name; if it is part of the state, describe it in `signals`, and add it to `observation.state`"
    return ""


def _apart(elements: Collection[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return lists of names that messages have together or not at all, so that none lacks an element of a signal."""
    groups: dict[tuple[bool, ...], list[str]] = {}
    for name in dict.fromkeys(chain.from_iterable(elements)):
        groups.setdefault(tuple(name in names for names in elements), []).append(name)
    return [tuple(group) for group in groups.values()]


def said_in(summary: RecordingSummary) -> dict[str, str]:
    """Return topic -> what its texts say: where episodes are, or the task."""
    topics = ((_named(summary, _EPISODES), "episodes"), (_named(summary, _TASKS), "task"))
    return {topic.name: what for topic, what in topics if topic is not None}


def write_signals(sheet: Sheet, signals: Sequence[SignalProposal]) -> None:
    """Write the signals of a rig, below it."""
    if not signals:
        return
    sheet.field(2, "signals:")
    for one in signals:
        field = one.fields[0] if len(one.fields) == 1 else f"[{', '.join(one.fields)}]"
        parts = [f"topic: {yaml_scalar(one.topic.name)}", f"field: {_path(field)}"]
        if one.names:
            parts.append(f"names: [{', '.join(map(yaml_scalar, one.names))}]")
        if one.by_log_time:
            parts.append("clock: log")
        what = {
            "state": "what the robot does",
            "command": "what it is told to do",
            "episode": "when episodes are",
        }
        sheet.guess(
            3, f"{one.name}: {{{', '.join(parts)}}}", f"{what[one.role]}, by type and name of its topic"
        )


def _path(field: str) -> str:
    return f'"{field}"' if "[" in field and not field.startswith("[") else field


def write_lerobot(sheet: Sheet, rigs: "Sequence[RigProposal]") -> None:
    """Write the section of a LeRobot dataset, whose features are those of the first rig that has signals."""
    rig = next(rig for rig in rigs if rig.signals)
    cameras = {name: one.topic for name, one in rig.channels.items() if one.modality == "camera"}
    signals = {
        role: [one.name for one in rig.signals if one.role == role]
        for role in ("state", "command", "episode")
    }
    sheet.field(0, "lerobot:")
    fps, why = _fps(
        {topic.name: topic.rate_hz for topic in cameras.values()},
        {one.name: one.rate_hz for one in rig.signals if one.role != "episode"},
    )
    sheet.guess(1, f"fps: {fps}", why)
    sheet.field(1, "features:")
    for feature, role in (("observation.state", "state"), ("action", "command")):
        # By default, a value may be 1.5 frames old: of a gripper slower than that, frames would have none.
        rates = {one.rate_hz or fps: one.name for one in rig.signals if one.role == role}
        if (rate_hz := min(rates, default=fps)) < fps / 1.5:
            line = f"{feature}: {{signals: [{', '.join(signals[role])}], tolerance_s: {ceil(150 / rate_hz) / 100:g}}}"
            reason = f"{rates[rate_hz]} has {rate_hz:.3g} Hz, so its values may be older than 1.5 frames"
            sheet.guess(2, line, reason)
        elif signals[role]:
            sheet.field(2, f"{feature}: {{signals: [{', '.join(signals[role])}]}}")
    if signals["state"] and not signals["command"]:
        sheet.guess(
            2,
            "action: {next_of: observation.state}",
            "no commands were found that can be used as they are, so the next state is the action",
        )
    for name, topic in cameras.items():
        # Of a camera at about this rate, the latest image would now and then be one twice and none of the next.
        at = ", at: nearest" if topic.rate_hz and abs(topic.rate_hz / fps - 1) < _ALIKE else ""
        sheet.field(2, f"observation.images.{name.removeprefix('CAM_').lower()}: {{camera: {name}{at}}}")
    _write_episodes(sheet, rig, signals["episode"], rigs)
    _write_task(sheet, rig, rigs)


def _fps(cameras: Mapping[str, float | None], signals: Mapping[str, float | None]) -> tuple[int, str]:
    """Return the rate of the dataset, and why; topic or signal -> its rate."""
    for rates, what in ((cameras, "the slowest camera"), (signals, "the slowest signal")):
        known = {rate: name for name, rate in rates.items() if rate}
        if known:
            name, rate = known[min(known)], max(1, round(min(known)))
            if rate > _MOST_FPS:
                return _MOST_FPS, f"at most {_MOST_FPS}; {what}, {name}, has {rate} Hz"
            return rate, f"the rate of {what}, {name}"
    return 30, "the recordings are too short to show a rate"


def _write_episodes(
    sheet: Sheet, rig: "RigProposal", signals: Sequence[str], rigs: "Sequence[RigProposal]"
) -> None:
    if signals:
        sheet.guess(1, f"episodes: {{signal: {signals[0]}}}", "by the name of its topic")
        return
    topic = _named(rig.summary, _EPISODES)
    if topic is None:
        sheet.guess_note(
            1, "each recording is one episode; `episodes` cuts them by a topic, a signal or a file of times"
        )
        return
    texts = {text: None for one in _of_all(topic, rigs) for text in one.texts}
    starts = [text for text in texts if _STARTS & set(tokens(text))]
    ends = [text for text in texts if _ENDS & set(tokens(text)) and text not in starts]
    parts = [f"topic: {yaml_scalar(topic.name)}", f"field: {_field(topic, rigs)}"]
    for field, words in (("start", starts), ("end", ends if starts else [])):
        if words:
            parts.append(f"{field}: [{', '.join(map(yaml_scalar, words))}]")
    sheet.guess(1, f"episodes: {{{', '.join(parts)}}}", "by the name of the topic and what it says")


def _write_task(sheet: Sheet, rig: "RigProposal", rigs: "Sequence[RigProposal]") -> None:
    topic = _named(rig.summary, _TASKS)
    if topic is None:
        sheet.note(1, "uncomment to say what the robot does, as a sentence:")
        sheet.off(1, "task: Put the cube into the bowl.")
        return
    line = f"task: {{topic: {yaml_scalar(topic.name)}, field: {_field(topic, rigs)}}}"
    sheet.guess(1, line, "by the name of the topic")


def _of_all(topic: TopicSummary, rigs: "Sequence[RigProposal]") -> list[TopicSummary]:
    """Return a topic as the recordings of each rig have it, if they have texts in it."""
    found = (rig.summary.topics.get(topic.name) for rig in rigs)
    return [topic, *(one for one in found if one is not None and one.msgtype in _TEXTS)]


def _field(topic: TopicSummary, rigs: "Sequence[RigProposal]") -> str:
    """Return the path of the texts, or a list of those of all rigs."""
    fields = list(dict.fromkeys(_TEXTS[one.msgtype] for one in _of_all(topic, rigs)))
    return fields[0] if len(fields) == 1 else f"[{', '.join(fields)}]"


def _named(summary: RecordingSummary, words: frozenset[str]) -> TopicSummary | None:
    """Return the topic with texts that is named by one of some words and said most."""
    topics = (topic for topic in summary.topics.values() if topic.texts and words & set(tokens(topic.name)))
    return max(topics, key=lambda topic: topic.count, default=None)
