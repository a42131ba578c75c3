"""The step `inventory`: what is in a recording, topic by topic, in one pass over it.

Files: `inventory.json`, and `messages.parquet` with the small messages that later steps read.
"""

from collections import Counter
from collections.abc import Mapping
from typing import Any

from bagassets.bags.damage import advice_for
from bagassets.bags.model import Format, RawMessage
from bagassets.bags.pack import write_pack
from bagassets.bags.reader import BaseRecording, RefusedBytes
from bagassets.decode.navsat import FixReading, decode_navsat
from bagassets.errors import DecodeError, RecordingError
from bagassets.geometry.sun import daylight
from bagassets.recipe.model import READING_LIMITS, Limits
from bagassets.steps.channel import Request
from bagassets.steps.kept_messages import KeptMessages
from bagassets.steps.topic_log import TopicLog
from bagassets.steps.topic_probe import TopicProbe
from bagassets.store.action import Step
from bagassets.store.artifact import ArtifactWriter

__all__ = ["STEP", "make_inventory", "request"]

# rosbags has the standard types, which recordings without definitions are decoded with.
STEP = Step("inventory", 6, ("pyarrow", "rosbags"))

# Types of sensor data in bulk: never packed, whatever their size.
BULK = frozenset(
    {
        "sensor_msgs/msg/Image",
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/PointCloud2",
        "sensor_msgs/msg/PointCloud",
        "sensor_msgs/msg/LaserScan",
        "velodyne_msgs/msg/VelodyneScan",
    }
)
# A fix stamped before GNSS was in use carries simulated or unset time: it tells no time of day.
FIRST_GNSS_NS = 631_152_000 * 1_000_000_000  # 1990-01-01
# Header stamps further from the log time than this are remarked upon.
MOST_OFFSET_S = 1.0
NAVSAT = "sensor_msgs/msg/NavSatFix"


def request(
    file_format: Format, bag_digest: str, definitions: Mapping[str, str], limits: Limits | None = None
) -> Request:
    """Return what the inventory depends on.

    Args:
        file_format: what the recording is read as: the same bytes under another suffix are read differently.
        bag_digest: digest of its content.
        definitions: `msg:<path>` -> digest, of definitions of message types that came without.
        limits: what the recording may ask of the memory; those of an empty recipe by default. What they cost
            shows in the digests of topics, and so in the actions of the steps that read them.
    """
    changed = (limits or Limits()).changed(*READING_LIMITS)
    return Request({"format": file_format, **changed}, (), {"bag": bag_digest, **definitions})


def make_inventory(recording: BaseRecording, out: ArtifactWriter, *, size: int) -> dict[str, Any]:
    """Read the whole recording once, write its inventory and pack, and return the summary.

    Args:
        recording: the recording.
        out: the artifact.
        size: bytes of its files.
    """
    logs = {name: TopicLog(info.msgtype) for name, info in recording.topics.items()}
    probes = {
        name: TopicProbe(recording, name) for name, info in recording.topics.items() if info.problem is None
    }
    kept = KeptMessages(name for name, info in recording.topics.items() if info.msgtype not in BULK)
    fixes: list[FixReading] = []
    refused: Counter[tuple[str, str]] = Counter()
    recording.check_content()
    for number, message in enumerate(recording.messages(list(recording.topics))):
        name, info = message.topic, recording.topics[message.topic]
        if isinstance(message.data, RefusedBytes):
            refused[name, message.data.reason] += 1
        logs[name].add(message, recording.header(message) if info.problem is None else None)
        if name in probes:
            probes[name].add(message)
        kept.add(number, message)
        if info.msgtype == NAVSAT and info.problem is None:
            _take_fix(recording, message, fixes)
    _refuse_shortfall(recording, logs)
    write_pack(out, kept.in_order())
    problems = {
        name: probes[name].problem if name in probes else info.problem
        for name, info in recording.topics.items()
    }
    value = _inventory_json(recording, logs, kept.topics, problems, fixes)
    for (name, reason), number in sorted(refused.items()):
        value["notes"].append(
            f"{name}: {number} of {logs[name].count} messages cannot be used, each because {reason}."
        )
    out.write_json("inventory.json", value | {"size": size})
    return {
        "messages": sum(topic["count"] for topic in value["topics"]),
        "topics": len(value["topics"]),
        "duration_s": value["duration_s"],
        "unreadable_topics": ", ".join(sorted(name for name in problems if problems[name])) or "none",
    }


def _refuse_shortfall(recording: BaseRecording, logs: dict[str, TopicLog]) -> None:
    """Raise if messages that the recording's own index announces were not found: nothing is lost silently."""
    for name, info in sorted(recording.topics.items()):
        if logs[name].count < info.count:
            raise RecordingError(
                f"{recording.path}: topic {name}: {logs[name].count} of {info.count} messages were found, which the "
                f"recording's own index announces; {advice_for(recording.path)}."
            )


def _take_fix(recording: BaseRecording, message: RawMessage, fixes: list[FixReading]) -> None:
    """Keep the first and the last valid fix."""
    try:
        fix = decode_navsat(recording.decode(message))
    except DecodeError:
        return  # a receiver without a fix says nothing about the place
    fixes[1:] = [fix]


def _inventory_json(
    recording: BaseRecording,
    logs: dict[str, TopicLog],
    packed: set[str],
    problems: dict[str, str | None],
    fixes: list[FixReading],
) -> dict[str, Any]:
    topics = []
    for name, info in sorted(recording.topics.items()):
        definition = recording.definition(name)
        topics.append(
            {
                "name": name,
                "type": info.msgtype,
                **logs[name].as_json(recording.layout_digest(name)),
                "packed": name in packed,
                "problem": problems[name],
                "serialization": recording.serialization(name),
                "definition": {"format": definition.format, "text": definition.text},
            }
        )
    starts = [topic["first_ns"] for topic in topics if topic["first_ns"] is not None]
    ends = [topic["last_ns"] for topic in topics if topic["last_ns"] is not None]
    start, end = (min(starts), max(ends)) if starts else (None, None)
    gnss = None
    if fixes:
        gnss = {"first": _fix_json(fixes[0]), "last": _fix_json(fixes[-1])}
    return {
        "format": recording.format,
        "start_ns": start,
        "end_ns": end,
        "duration_s": 0.0 if start is None or end is None else round((end - start) / 1e9, 6),
        "topics": topics,
        "gnss": gnss,
        "daylight": _daylight(fixes),
        "notes": _notes(recording, topics),
    }


def _daylight(fixes: list[FixReading]) -> str | None:
    if not fixes or fixes[0].stamp_ns < FIRST_GNSS_NS:
        return None
    return daylight(fixes[0].lat_deg, fixes[0].lon_deg, fixes[0].stamp_ns)


def _fix_json(fix: FixReading) -> dict[str, Any]:
    alt = None if fix.alt_m != fix.alt_m else fix.alt_m
    return {"lat": fix.lat_deg, "lon": fix.lon_deg, "alt": alt, "stamp_ns": fix.stamp_ns}


def _notes(recording: BaseRecording, topics: list[dict[str, Any]]) -> list[str]:
    """Return sentences about what is unusual; what several topics share is said once."""
    notes = []
    unset, apart = [], []
    for topic in topics:
        name, offset = topic["name"], topic["header_offset_s"]
        if topic["problem"] is not None:
            notes.append(f"{name} cannot be decoded: {topic['problem']}.")
        announced = recording.topics[name].count
        if announced != topic["count"]:
            notes.append(f"{name}: the recording announces {announced} messages and holds {topic['count']}.")
        if topic["unordered_stamps"]:
            notes.append(f"{name}: {topic['unordered_stamps']} header stamps go back in time.")
        if offset is None or topic["problem"] is not None:
            continue
        if topic["first_stamp_ns"] == topic["last_stamp_ns"] == 0:
            unset.append(name)
        elif abs(offset["median"]) > MOST_OFFSET_S:
            apart.append(f"{name} ({offset['median']:+.1f} s)")
    if unset:
        notes.append(f"Header stamps are all zero on {', '.join(unset)}: only the log time tells when.")
    if apart:
        notes.append(
            f"Log times are far from header stamps on {', '.join(apart)}: choose the clock in the recipe with care."
        )
    return notes
