"""Damaged recordings of every format, made from sound ones, and what other programs would save of them."""

import random
import shutil
import sqlite3
import struct
from collections import Counter
from functools import cache
from io import BytesIO

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from bagassets.recordings.decompress import decompress
from bagassets_tests.recorded_bags import NOON_NS, ROS1, ROS2, header, point, text
from bagassets_tests.recorded_bags import Message as Entry
from bagassets_tests.reindexed_bag import CHUNK, CHUNK_INFO, CONNECTION, INDEX, MESSAGE

PERIOD_NS = 20_000_000
KIB = 1024


def _picture(log_time_ns, size, seed):
    def make(store):
        data = np.frombuffer(random.Random(seed).randbytes(size // 2), np.uint8).repeat(2)
        return store.types["sensor_msgs/msg/CompressedImage"](header(store, log_time_ns, "cam"), "jpeg", data)

    return Entry("/camera", "sensor_msgs/msg/CompressedImage", log_time_ns, make)


@cache
def entries(number=240):
    """What every recording holds: small messages, and some of several kilobytes."""
    found = []
    for i in range(number):
        at = NOON_NS + i * PERIOD_NS
        found.append(point(at, x=float(i)))
        if i % 3 == 0:
            found.append(text(at + 1000, f"text {i} " * (i % 7)))
        if i % 8 == 0:
            found.append(_picture(at + 2000, 1000 + (i * 937) % 9000, i))
    return found


def serialized(store, entry):
    pack = store.serialize_ros1 if store is ROS1 else store.serialize_cdr
    return bytes(pack(entry.make(store), entry.msgtype))


@cache
def truth(kind):
    """Return the messages of a recording: how often each (topic, log time, payload) is in it."""
    store = ROS1 if kind.startswith("ros1") else ROS2
    return Counter((one.topic, one.log_time_ns, serialized(store, one)) for one in entries())


def write_bag(path, compression, some):
    writer = Rosbag1Writer(path)
    writer.chunk_threshold = 16 * KIB
    if compression is not None:
        writer.set_compression(Rosbag1Writer.CompressionFormat[compression])
    with writer:
        connections = {}
        for one in some:
            if one.topic not in connections:
                connections[one.topic] = writer.add_connection(one.topic, one.msgtype, typestore=ROS1)
            writer.write(connections[one.topic], one.log_time_ns, serialized(ROS1, one))
    return path


def write_mcap(path, compression, some, **options):
    with path.open("wb") as file:
        writer = McapWriter(file, 16 * KIB, compression, **options)
        writer.start(profile="ros2")
        channels = {}
        for number, one in enumerate(some):
            if one.topic not in channels:
                definition = ROS2.generate_msgdef(one.msgtype, ros_version=2)[0].encode()
                schema = writer.register_schema(one.msgtype, "ros2msg", definition)
                channels[one.topic] = writer.register_channel(one.topic, "cdr", schema)
            data = serialized(ROS2, one)
            writer.add_message(channels[one.topic], one.log_time_ns, data, one.log_time_ns + 7, number)
        writer.finish()
    return path


def write_folder(path, some, storage="SQLITE3", mode=None):
    writer = Rosbag2Writer(path, version=9, storage_plugin=StoragePlugin[storage])
    if mode is not None:
        writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for one in some:
            if one.topic not in connections:
                connections[one.topic] = writer.add_connection(one.topic, one.msgtype, typestore=ROS2)
            writer.write(connections[one.topic], one.log_time_ns, serialized(ROS2, one))
    return path


def write_split(path, some):
    """Write a folder of two databases, whose metadata count both."""
    parts = [write_folder(path.with_name(f"{path.name}_{i}"), half) for i, half in enumerate(halves(some))]
    path.mkdir()
    for i, part in enumerate(parts):
        shutil.move(next(part.glob("*.db3")), path / f"{path.name}_{i}.db3")
        shutil.rmtree(part)
    counts = Counter((one.topic, one.msgtype) for one in some)
    lines = "".join(
        f"    - {{topic_metadata: {{name: {topic}, type: {msgtype}, serialization_format: cdr}}, message_count: {count}}}\n"
        for (topic, msgtype), count in counts.items()
    )
    files = "".join(
        f"    - {{path: {path.name}_{i}.db3, message_count: {len(half)}}}\n"
        for i, half in enumerate(halves(some))
    )
    (path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n"
        f"  relative_file_paths: [{path.name}_0.db3, {path.name}_1.db3]\n"
        f"  topics_with_message_count:\n{lines}  files:\n{files}"
    )
    return path


def halves(some):
    return some[: len(some) // 2], some[len(some) // 2 :]


def bare(folder):
    """Keep the database of a folder alone."""
    (database,) = folder.glob("*.db3")
    target = folder.with_suffix(".db3")
    shutil.move(database, target)
    shutil.rmtree(folder)
    return target


SOUND = {
    "ros1": lambda to: write_bag(to / "a.bag", None, entries()),
    "ros1 bz2": lambda to: write_bag(to / "a.bag", "BZ2", entries()),
    "ros1 lz4": lambda to: write_bag(to / "a.bag", "LZ4", entries()),
    "mcap": lambda to: write_mcap(to / "a.mcap", CompressionType.NONE, entries()),
    "mcap lz4": lambda to: write_mcap(to / "a.mcap", CompressionType.LZ4, entries()),
    "mcap zstd": lambda to: write_mcap(to / "a.mcap", CompressionType.ZSTD, entries()),
    "mcap unchunked": lambda to: write_mcap(to / "a.mcap", CompressionType.NONE, entries(), use_chunking=False),
    "mcap without indexes": lambda to: write_mcap(
        to / "a.mcap", CompressionType.ZSTD, entries(), enable_crcs=False, use_summary_offsets=False
    ),
    "db3": lambda to: bare(write_folder(to / "a", entries())),
    "folder": lambda to: write_folder(to / "a", entries()),
    "folder split": lambda to: write_split(to / "a", entries()),
    "folder mcap": lambda to: write_folder(to / "a", entries(), "MCAP"),
    "folder zstd": lambda to: write_folder(to / "a", entries(), mode="FILE"),
    "folder zstd messages": lambda to: write_folder(to / "a", entries(), mode="MESSAGE"),
}  # fmt: skip
"""Kind -> writes a sound recording."""


def write_series(folder, suffix, write, compression):
    """Write a drive as three files in a folder of their own."""
    folder.mkdir()
    some = entries()
    for number in range(3):
        part = some[number * len(some) // 3 : (number + 1) * len(some) // 3]
        write(folder / f"drive_{number}{suffix}", compression, part)
    return folder


SERIES = {
    "ros1 series": lambda to: write_series(to / "a", ".bag", write_bag, "LZ4"),
    "mcap series": lambda to: write_series(to / "a", ".mcap", write_mcap, CompressionType.ZSTD),
}
"""Kind -> writes a sound drive in several files, of which the last one is damaged."""


def storage_of(path):
    """Return the file of a recording that is damaged: of a folder, the last one."""
    return max(one for one in path.iterdir() if one.name != "metadata.yaml") if path.is_dir() else path


def cut(share):
    return lambda data, _: data[: int(len(data) * share)]


def cut_bytes(number):
    return lambda data, _: data[:-number]


def zeros_from(share):
    return lambda data, _: data[: int(len(data) * share)] + bytes(len(data) - int(len(data) * share))


def hole(share, size, *, noise):
    def damage(data, dice):
        at = int(len(data) * share)
        size_ = min(size, len(data) - at)
        return data[:at] + (dice.randbytes(size_) if noise else bytes(size_)) + data[at + size_ :]

    return damage


def flip(share=None):
    def damage(data, dice):
        at = dice.randrange(len(data)) if share is None else int(len(data) * share)
        return data[:at] + bytes([data[at] ^ 1 << dice.randrange(8)]) + data[at + 1 :]

    return damage


def header_flip(data, dice):
    at = dice.randrange(12)
    return data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :]


def without_index(data, _):
    """End before the index of a bag, the summary of an MCAP; of other files nothing goes."""
    if data.startswith(b"#ROSBAG"):
        at = data.index(b"index_pos=") + 10
        (end,) = struct.unpack_from("<Q", data, at)
        return data[:at] + bytes(8) + data[at + 8 : end]
    if data.startswith(b"\x89MCAP"):
        (start,) = struct.unpack_from("<Q", data, len(data) - 8 - 20)
        return data[: start or len(data) - 37]
    return data


DAMAGES = {
    "without its index": without_index,
    "cut by 10 bytes": cut_bytes(10),
    "cut at 99 %": cut(0.99),
    "cut at 90 %": cut(0.9),
    "cut at 50 %": cut(0.5),
    "cut at 12 %": cut(0.12),
    "last tenth zeros": zeros_from(0.9),
    "4 KB of zeros in the middle": hole(0.5, 4 * KIB, noise=False),
    "4 KB of noise in the middle": hole(0.4, 4 * KIB, noise=True),
    "30 KB of noise": hole(0.6, 30 * KIB, noise=True),
    "a bit at 30 %": flip(0.3),
    "a bit at 70 %": flip(0.7),
    "a bit anywhere": flip(),
    "another bit": flip(),
    "a bit in the first bytes": header_flip,
    "several": lambda data, dice: cut(0.8)(hole(0.3, 3 * KIB, noise=True)(flip()(data, dice), dice), dice),
}
"""Name -> what it makes of the bytes of a file."""


def damaged(folder, kind, damage, sound):
    """Write a damaged copy of a sound recording."""
    path = folder / sound.name
    (shutil.copytree if sound.is_dir() else shutil.copy)(sound, path)
    spoil(storage_of(path), kind, damage)
    return path


def spoil(file, kind, damage):
    """Damage a file."""
    dice = random.Random(f"{kind} {damage}")
    file.write_bytes(DAMAGES[damage](file.read_bytes(), dice))


# --- oracles -----------------------------------------------------------------------------


def linear_reader(data):
    """What the mcap library reads before it gives up; checksums are verified."""
    found, channels = Counter(), {}
    try:
        for record in StreamReader(BytesIO(data), validate_crcs=True).records:
            if isinstance(record, Channel):
                channels[record.id] = record.topic
            elif isinstance(record, Message):
                found[channels[record.channel_id], record.log_time, bytes(record.data)] += 1
    except (McapError, Exception):  # noqa: BLE001  (it raises anything)
        pass
    return found


def reindex_rule(data):
    """What `rosbag reindex` would index: chunk after chunk, up to the first that is not whole."""
    found, topics, at = Counter(), {}, 0
    try:
        at = data.index(b"\n") + 1
        while at < len(data):
            fields, body, end = _record(data, at)
            op = fields["op"][0]
            if op == CHUNK:
                (size,) = struct.unpack("<I", fields["size"])
                inside = Counter()
                content = decompress(body, fields["compression"].decode(), size)
                begin = 0
                while begin < size:
                    header_, payload, begin = _record(content, begin)
                    (connection,) = struct.unpack("<I", header_["conn"])
                    if header_["op"][0] == CONNECTION:
                        topics[connection] = header_["topic"].decode()
                    elif header_["op"][0] == MESSAGE:
                        seconds, nanoseconds = struct.unpack("<II", header_["time"])
                        inside[topics[connection], seconds * 10**9 + nanoseconds, payload] += 1
                    else:
                        raise ValueError(begin)  # noqa: TRY301  (as the rule stops there)
                found += inside
            elif op not in {3, INDEX, CONNECTION, CHUNK_INFO}:
                break
            at = end
    except Exception:  # noqa: BLE001  (whatever damaged bytes lead to)
        pass
    return found


def _record(data, at):
    (size,) = struct.unpack_from("<I", data, at)
    fields, begin, at = {}, at + 4, at + 4
    while at < begin + size:
        (length,) = struct.unpack_from("<I", data, at)
        name, sep, value = data[at + 4 : at + 4 + length].partition(b"=")
        if not sep:
            raise ValueError(at)
        fields[name.decode()] = value
        at += 4 + length
    (length,) = struct.unpack_from("<I", data, at)
    if at + 4 + length > len(data):
        raise ValueError(at)
    return fields, data[at + 4 : at + 4 + length], at + 4 + length


def page_walk(data, topics):
    """Which messages of a database lie in leaf pages of 4096 bytes that are there; overflow pages are followed one by one."""
    found = Counter()
    for begin in range(0, len(data) - 4095, 4096):
        at = begin + (100 if begin == 0 else 0)
        if data[at] != 13:
            continue
        for i in range(int.from_bytes(data[at + 3 : at + 5], "big")):
            place = begin + int.from_bytes(data[at + 8 + 2 * i : at + 10 + 2 * i], "big")
            try:
                found.update([_row(data, place, topics)])
            except (IndexError, KeyError, ValueError):
                continue
    return found


def _row(data, at, topics):
    size, at = _number(data, at)
    _, at = _number(data, at)
    most, local = 4096 - 35, size
    if size > most:
        least = (4096 - 12) * 32 // 255 - 23
        local = least + (size - least) % 4092
        local = least if local > most else local
    content = data[at : at + local]
    link = data[at + local : at + local + 4]
    while len(content) < size:
        page = (int.from_bytes(link, "big") - 1) * 4096
        if page <= 0 or page + 4096 > len(data):
            raise ValueError(page)
        link, content = data[page : page + 4], content + data[page + 4 : page + 4096]
    content = content[:size]
    end, place = _number(content, 0)
    kinds = []
    while place < end:
        kind, place = _number(content, place)
        kinds.append(kind)
    if len(kinds) != 4 or kinds[3] < 12 or max(kinds[:3]) > 9:
        raise ValueError(kinds)
    values = []
    for kind in kinds[:3]:
        length = (0, 1, 2, 3, 4, 6, 8, 8, 0, 0)[kind]
        value = kind - 8 if kind in {8, 9} else int.from_bytes(content[place : place + length], "big")
        values.append(value)
        place += length
    return topics[values[1]], values[2], content[place:]


def _number(data, at):
    value = 0
    for i in range(9):
        byte = data[at + i]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at + i + 1
    raise ValueError(at)


def topics_in(database):
    with sqlite3.connect(database) as connection:
        return dict(connection.execute("SELECT id, name FROM topics"))


def unpacked(data):
    """What a zstd file unpacks to, up to where it is damaged."""
    pieces = []
    try:
        with zstandard.ZstdDecompressor().stream_reader(BytesIO(data)) as reader:
            while piece := reader.read(4096):
                pieces.append(piece)
    except zstandard.ZstdError:
        pass
    return b"".join(pieces)


def oracle(kind, path, sound):
    """What the best of other programs saves of a damaged recording: how often each message."""
    if not path.is_dir():
        data = path.read_bytes()
        if path.suffix == ".bag":
            return reindex_rule(data)
        return linear_reader(data) if path.suffix == ".mcap" else page_walk(data, topics_in(sound))
    found = Counter()
    for file in path.iterdir():
        if file.suffix == ".bag":
            found += reindex_rule(file.read_bytes())
        elif file.suffix == ".mcap":
            found += linear_reader(file.read_bytes())
        elif file.suffix == ".db3" and kind != "folder zstd messages":
            found += page_walk(file.read_bytes(), topics_in(sound / file.name))
        elif file.suffix == ".zstd":
            data = unpacked((sound / file.name).read_bytes())
            (whole := path.parent / "whole.db3").write_bytes(data)
            found += page_walk(unpacked(file.read_bytes()), topics_in(whole))
            whole.unlink()
    return found
