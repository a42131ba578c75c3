"""Messages for every line of the table of decoders, in each way in which recordings hold them.

ROS messages are read by the definitions of rosbags, by ours for recordings without any, and by those of drivers; Foxglove's
in CDR, protobuf and JSON as their writers define them.
"""

import dataclasses
import struct
import tempfile
import zlib
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from bagassets.decode.packets import PAYLOADS, VELODYNE_PACKET_SIZE
from bagassets.decode.registry import ANY, BUILT_IN, Decoder
from bagassets.recordings.merge_topics import topic_of
from bagassets.recordings.model import Definition
from bagassets.recordings.open import open_recording
from bagassets.recordings.topic import Topic, TopicSource
from bagassets_tests.foxglove_files import NS, WRITERS, examples
from bagassets_tests.ouster_data import packet
from bagassets_tests.small_drive import STORE1, STORE2, messages
from bagassets_tests.sweep_data import vlp16_packets

# What the lines for any type read, as far as we know their definitions.
_OF_DRIVERS = {
    "packets": ("nebula_msgs/msg/NebulaPackets",),
    "radar": (
        "radar_msgs/msg/RadarScan", "radar_msgs/msg/RadarTracks", "delphi_esr_msgs/msg/EsrTrack",
        "delphi_mrr_msgs/msg/MrrDetection", "delphi_srr_msgs/msg/SrrTrack", "sick_scan_xd/msg/RadarScan",
        "continental_msgs/msg/ContinentalArs548DetectionList", "continental_msgs/msg/ContinentalSrr520DetectionList",
    ),
}  # fmt: skip
# Of drivers whose definitions are always recorded.
RECORDED_TEXTS = {
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\n"
    "uint64 pts\nuint8 flags\nbool is_bigendian\nuint8[] data\n",
    "point_cloud_interfaces/msg/CompressedPointCloud2": "std_msgs/Header header\nuint32 height\nuint32 width\n"
    "sensor_msgs/PointField[] fields\nbool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] compressed_data\n"
    "bool is_dense\nstring format\n",
    **{
        f"{package}/msg/CustomMsg": "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
        f"CustomPoint[] points\n{'=' * 80}\nMSG: {package}/CustomPoint\nuint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\n"
        "uint8 reflectivity\nuint8 tag\nuint8 line\n"
        for package in ("livox_ros_driver", "livox_ros_driver2")
    },
}
# What decoders look at, so that a message gets beyond that.
_VIDEO = {"h264": "00000001658884", "hevc": "0000000126018884", "av1": "12000a01ff320210ff", "vp9": "8249"}
_WORDS = {"child_frame_id": "b", "distortion_model": "plumb_bob"}
_LENGTHS = {"d": 5, "D": 5, "dimensions": 3}  # of distortion, of a box


@dataclasses.dataclass(frozen=True)
class Case:
    """A decoder, and a topic whose messages it reads.

    Attributes:
        line: of the table.
        source: the topic.
        seeds: valid messages.
    """

    line: Decoder
    source: TopicSource
    seeds: tuple[bytes, ...]

    def topic(self, limits):
        """Return the topic as a recording opens it."""
        return topic_of(self.source, (), limits)


@cache
def cases():
    """Return a case for each decoder and each way in which recordings hold its messages."""
    return (*_of_rosbags(), *_of_ours(), *_of_foxglove())


def _source(msgtype, definition, how):
    return TopicSource("/topic", msgtype, 1, definition, how)


def _of_rosbags():
    """Types of which rosbags has definitions, with messages of the drive, and one that is made up."""
    for store, how in ((STORE2, "cdr"), (STORE1, "ros1")):
        pack = store.serialize_cdr if how == "cdr" else store.serialize_ros1
        driven = {}
        for _, msgtype, _, message in messages(store, 0.3, ros1=how == "ros1"):
            driven[msgtype] = bytes(pack(message, msgtype))
        for line in BUILT_IN:
            kind = line.msgtype
            if kind in store.types and kind in store.fielddefs and not kind.startswith("foxglove_msgs"):
                text, _ = store.generate_msgdef(kind, ros_version=2 if how == "cdr" else 1)
                seeds = [driven[kind]] if kind in driven else []
                whole = _filled(store, kind)
                if line.family == "video":
                    seeds += [bytes(pack(packet, kind)) for packet in _packets(whole, "format")]
                elif kind.endswith("CompressedImage"):
                    seeds += [bytes(pack(_compressed(whole, name), kind)) for name in (".jpg", ".png")]
                    seeds.append(bytes(pack(_depth_in_rvl(whole), kind)))
                elif kind.endswith("/Image"):
                    seeds.append(bytes(pack(_nv12(whole), kind)))
                seeds.append(bytes(pack(whole, kind)))
                yield Case(line, _source(kind, Definition("msg", text), how), tuple(seeds))


def _nv12(message):
    planes = np.arange(36 * 32, dtype=np.uint8)
    return dataclasses.replace(message, encoding="nv12", height=24, width=32, step=32, data=planes)


def _compressed(message, suffix):
    pixels = np.arange(24 * 32 * 3, dtype=np.uint8).reshape(24, 32, 3)
    return dataclasses.replace(message, format=suffix[1:], data=cv2.imencode(suffix, pixels)[1].reshape(-1))


def _depth_in_rvl(message):
    # A row of 0, 0, 0, 1, 2, 3, 9, 0 behind parameters and size.
    data = struct.pack("<iffII", 0, 0.0, 0.0, 8, 1) + bytes.fromhex("112c223400000000")
    return dataclasses.replace(
        message, format="16UC1; compressedDepth rvl", data=np.frombuffer(data, np.uint8)
    )


def _of_ours():
    """Types that rosbags lacks: without a definition, as in older SQLite bags, in each layout that we know of them."""
    for line in BUILT_IN:
        for kind in _OF_DRIVERS[line.family] if line.msgtype == ANY else (line.msgtype,):
            if kind in STORE2.types or kind.startswith("foxglove_msgs"):
                continue
            for how in ("cdr", "ros1"):
                definition = (
                    Definition("msg", RECORDED_TEXTS[kind])
                    if kind in RECORDED_TEXTS
                    else Definition("none", "")
                )
                topic = Topic(_source(kind, definition, how))
                if topic.problem is None:  # some refer to types that ROS 1 lacks
                    seeds = [
                        seed
                        for layout in topic._layouts.layouts
                        for seed in _serialized(layout.types, kind, how)
                    ]
                    yield Case(line, topic.source, tuple(dict.fromkeys(seeds)))


def _serialized(types, msgtype, how):
    store = get_typestore(Stores.EMPTY)
    store.register(dict(types))
    pack = store.serialize_cdr if how == "cdr" else store.serialize_ros1
    message = _filled(store, msgtype)
    if not hasattr(message, "pts"):
        return [bytes(pack(message, msgtype))]
    return [bytes(pack(packet, msgtype)) for packet in _packets(message, "encoding")]


def _packets(message, field):
    """Return a message for each codec, whose name is in a field."""
    return [
        dataclasses.replace(message, **{field: name}, data=np.frombuffer(bytes.fromhex(data), np.uint8))
        for name, data in _VIDEO.items()
    ]


def _of_foxglove():
    for write in WRITERS.values():
        with tempfile.TemporaryDirectory() as folder:
            items = [(f"/{message.kind}", NS, message) for message in examples()]
            with open_recording(write(Path(folder) / "a.mcap", items)) as recording:
                seeds = {raw.topic: bytes(raw.data) for raw in recording.messages(list(recording.topics))}
                for name, topic in recording.topics.items():
                    for line in BUILT_IN:
                        if line.msgtype == topic.msgtype:
                            yield Case(line, topic.source, (seeds[name],))


def _filled(store, msgtype):
    """Return a message with something in every field: ones, letters, some elements in each list, a Velodyne packet."""
    _, fields = store.fielddefs[msgtype]
    made = {name: _value(store, name, kind) for name, kind in fields}
    if msgtype == "geometry_msgs/msg/Quaternion":
        made |= {"x": 0.0, "y": 0.0, "z": 0.0}
    if "points" in made and "point_num" in made:
        made["point_num"] = len(made["points"])
    if msgtype.endswith("PointCloud2"):
        field = store.types["sensor_msgs/msg/PointField"]
        made["fields"] = [
            field(name=name, offset=4 * n, datatype=7, count=1) for n, name in enumerate(("x", "y", "z"))
        ]
        made |= {"is_bigendian": False, "point_step": 12, "row_step": 12}
        if "data" in made:
            made["data"] = np.ones(12, np.uint8)
        else:
            made |= {"format": "zlib", "compressed_data": np.frombuffer(zlib.compress(bytes(12)), np.uint8)}
    return store.types[msgtype](**made)


def _value(store, name, description):
    kind, detail = description
    if kind == Nodetype.NAME:
        return _filled(store, detail)
    if kind == Nodetype.BASE:
        one = 1.0 if detail[0].startswith("float") else 1
        return {"string": _WORDS.get(name, "a"), "bool": True}.get(detail[0], one)
    (inner, what), length = detail
    number = length if kind == Nodetype.ARRAY else _LENGTHS.get(name, 2)
    if inner != Nodetype.BASE or what[0] == "string":
        return [_value(store, name, (inner, what)) for _ in range(number)]
    one_byte = what[0] in {"uint8", "byte", "octet", "char"}
    if one_byte and name in PAYLOADS and (kind == Nodetype.SEQUENCE or number == VELODYNE_PACKET_SIZE):
        return np.frombuffer(vlp16_packets(0.01)[0].tobytes(), np.uint8)
    if one_byte and name == "buf":
        return np.frombuffer(packet(0), np.uint8)
    return np.ones(number, "uint8" if one_byte else what[0])
