"""The step `inventory`: what is in a recording, topic by topic, in one pass over it.

Files: `inventory.json`, and `messages.parquet` with the small messages that later steps read.
"""

from typing import Any

import pyarrow as pa

from bagassets.bags.inventory import Definition
from bagassets.bags.model import RawMessage
from bagassets.bags.pack import PACK_SCHEMA
from bagassets.bags.reader import BaseRecording
from bagassets.decode.navsat import FixReading, decode_navsat
from bagassets.errors import DecodeError
from bagassets.geometry.sun import daylight
from bagassets.steps.topic_log import TopicLog
from bagassets.store.action import Step
from bagassets.store.artifact import ArtifactWriter

__all__ = ["STEP", "make_inventory"]

STEP = Step("inventory", 1, ("pyarrow",))

# Types of sensor data in bulk: never packed, whatever their size.
BULK = frozenset(
    {
        "sensor_msgs/msg/Image",
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/PointCloud2",
        "sensor_msgs/msg/PointCloud",
        "sensor_msgs/msg/LaserScan",
        "velodyne_msgs/msg/VelodyneScan",
        "ethernet_msgs/msg/Packet",
        "udp_msgs/msg/UdpPacket",
    }
)
MOST_MEAN_BYTES = 64 * 1024
MOST_TOPIC_BYTES = 64 * 1024 * 1024
NAVSAT = "sensor_msgs/msg/NavSatFix"


def make_inventory(recording: BaseRecording, out: ArtifactWriter, *, size: int) -> dict[str, Any]:
    """Read the whole recording once, write its inventory and pack, and return the summary.

    Args:
        recording: the recording.
        out: the artifact.
        size: bytes of its files.
    """
    logs = {name: TopicLog(info.msgtype) for name, info in recording.topics.items()}
    packed: dict[str, list[RawMessage] | None] = {
        name: None if info.msgtype in BULK else [] for name, info in recording.topics.items()
    }
    fixes: list[FixReading] = []
    for message in recording.messages(list(recording.topics)):
        log = logs[message.topic]
        log.add(message, recording.header(message))
        kept = packed[message.topic]
        if kept is not None:
            kept.append(message)
            if log.bytes > MOST_TOPIC_BYTES or log.bytes > MOST_MEAN_BYTES * max(len(kept), 8):
                packed[message.topic] = None
        if message.msgtype == NAVSAT:
            _take_fix(recording, message, fixes)
    small = [message for kept in packed.values() if kept for message in kept]
    small.sort(key=lambda message: message.log_time_ns)  # stable: file order within one time
    columns = [[m.topic for m in small], [m.log_time_ns for m in small], [bytes(m.data) for m in small]]
    arrays = [pa.array(column, field.type) for column, field in zip(columns, PACK_SCHEMA, strict=True)]
    out.write_table("messages.parquet", pa.Table.from_arrays(arrays, schema=PACK_SCHEMA))
    value = _inventory_json(
        recording, logs, {name for name, kept in packed.items() if kept is not None}, fixes
    )
    out.write_json("inventory.json", value | {"size": size})
    problems = [topic["name"] for topic in value["topics"] if topic["problem"] is not None]
    return {
        "messages": sum(topic["count"] for topic in value["topics"]),
        "topics": len(value["topics"]),
        "duration_s": value["duration_s"],
        "unreadable_topics": ", ".join(problems) or "none",
    }


def _take_fix(recording: BaseRecording, message: RawMessage, fixes: list[FixReading]) -> None:
    """Keep the first and the last valid fix."""
    try:
        fix = decode_navsat(recording.decode(message))
    except DecodeError:
        return  # a receiver without a fix says nothing about the place
    fixes[1:] = [fix]


def _inventory_json(
    recording: BaseRecording, logs: dict[str, TopicLog], packed: set[str], fixes: list[FixReading]
) -> dict[str, Any]:
    topics = []
    for name, info in sorted(recording.topics.items()):
        definition = recording.definitions.get(info.msgtype, Definition("none", ""))
        topics.append(
            {
                "name": name,
                "type": info.msgtype,
                **logs[name].as_json(),
                "packed": name in packed,
                "problem": info.problem,
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
        "daylight": daylight(fixes[0].lat_deg, fixes[0].lon_deg, fixes[0].stamp_ns) if fixes else None,
        "notes": _notes(topics),
    }


def _fix_json(fix: FixReading) -> dict[str, Any]:
    alt = None if fix.alt_m != fix.alt_m else fix.alt_m
    return {"lat": fix.lat_deg, "lon": fix.lon_deg, "alt": alt, "stamp_ns": fix.stamp_ns}


def _notes(topics: list[dict[str, Any]]) -> list[str]:
    notes = []
    for topic in topics:
        if topic["problem"] is not None:
            notes.append(f"{topic['name']} cannot be decoded: {topic['problem']}.")
        offset = topic["header_offset_s"]
        if offset is not None and abs(offset["median"]) > 1.0:
            notes.append(
                f"{topic['name']}: header stamps are {offset['median']:.1f} s behind the log time; choose the clock "
                "in the recipe with care."
            )
        if topic["unordered_stamps"]:
            notes.append(f"{topic['name']}: {topic['unordered_stamps']} header stamps go back in time.")
    return notes
