"""Recordings that announce or unpack to far more than they hold, a few kilobytes each."""

import bz2
import io
import sqlite3
import struct
import zlib
from functools import cache

import numpy as np
import zstandard
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from bagassets_tests.recorded_bags import NOON_NS, text, write_ros2
from bagassets_tests.small_drive import START_NS, STORE2, messages

RULE = "=" * 80 + "\n"
GIGABYTE = 1_000_000_000


def write_mcap(path, topics, *, compression=CompressionType.ZSTD, chunk_size=1024 * 1024):
    """Write (topic, type, definition, payload) a message each; the encoding is cdr unless the topic says ros1."""
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size, compression)
        writer.start()
        channels = {}
        for number, (topic, msgtype, definition, payload) in enumerate(topics):
            if topic not in channels:
                data = definition if isinstance(definition, bytes) else definition.encode()
                one = "ros1" if topic.startswith("/ros1") else "cdr"
                schema = writer.register_schema(msgtype, "ros1msg" if one == "ros1" else "ros2msg", data)
                channels[topic] = writer.register_channel(topic, one, schema)
            writer.add_message(channels[topic], NOON_NS + number, payload, NOON_NS + number)
        writer.finish()
    return path


def cdr(body=b""):
    return b"\0\1\0\0" + body


def serialized(message, msgtype):
    return bytes(STORE2.serialize_cdr(message, msgtype))


def definition_of(msgtype):
    return STORE2.generate_msgdef(msgtype, ros_version=2)[0]


def header(frame="cam", number=0):
    stamp_ns = START_NS + 10_000_000 + number * 100_000_000
    stamp = STORE2.types["builtin_interfaces/msg/Time"](stamp_ns // GIGABYTE, stamp_ns % GIGABYTE)
    return STORE2.types["std_msgs/msg/Header"](stamp, frame)


# --- definitions and messages ----------------------------------------------------------------

DEFINITIONS = {
    "a thousand million strings": ("string[1000000000] x\n", cdr()),
    "a thousand million messages": (f"Inner[1000000000] x\n{RULE}MSG: my_msgs/Inner\nuint8 a\n", cdr()),
    "arrays in arrays": (
        "A[1000] x\n" + "".join(f"{RULE}MSG: my_msgs/{one}\n{two}[1000] x\n" for one, two in ("AB", "BC", "CD"))
        + f"{RULE}MSG: my_msgs/D\nuint8 a\n",
        cdr(),
    ),
    "more lists than bytes": (f"Inner[] x\n{RULE}MSG: my_msgs/Inner\nuint8[0] a\n", cdr(struct.pack("<I", 40_000_000) + bytes(41_000_000))),
    "a negative length": (f"Inner[] x\n{RULE}MSG: my_msgs/Inner\nuint8[-1] a\n", cdr(struct.pack("<I", 2**31))),
}  # fmt: skip


def write_definition(path, name):
    definition, payload = DEFINITIONS[name]
    return write_mcap(path, [("/hostile", "my_msgs/msg/Hostile", definition, payload)] * 3)


def write_empty_elements(path):
    """ROS 1 messages of four bytes that announce four thousand million messages without fields."""
    definition = f"Empty[] x\n{RULE}MSG: my_msgs/Empty\n"
    return write_mcap(path, [("/ros1", "my_msgs/Hostile", definition, struct.pack("<I", 2**32 - 1))] * 3)


# --- chunks --------------------------------------------------------------------------------


def ros1_record(fields, data):
    body = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
        for name, value in fields.items()
    )
    return struct.pack("<I", len(body)) + body + struct.pack("<I", len(data)) + data


def write_ros1_chunk(path, packed, announced, compression=b"bz2"):
    """Write a bag of one chunk with one message at its beginning, as its index says."""

    def u32(value):
        return struct.pack("<I", value)

    time = struct.pack("<II", NOON_NS // GIGABYTE, 0)
    connection = ros1_record(
        {"op": b"\x07", "conn": u32(0), "topic": b"/text"},
        ros1_record({"topic": b"/text", "type": b"std_msgs/String", "md5sum": b"*", "message_definition": b"string data\n"}, b"")[4:-4],
    )  # fmt: skip
    magic = b"#ROSBAG V2.0\n"

    def bag_header(index_pos):
        fields = {
            "op": b"\x03",
            "index_pos": struct.pack("<Q", index_pos),
            "conn_count": u32(1),
            "chunk_count": u32(1),
        }
        return ros1_record(fields, b" " * 4000)

    at = len(magic) + len(bag_header(0))
    chunk = ros1_record({"op": b"\x05", "compression": compression, "size": u32(announced)}, packed)
    index = ros1_record({"op": b"\x04", "ver": u32(1), "conn": u32(0), "count": u32(1)}, time + u32(0))
    info = ros1_record(
        {"op": b"\x06", "ver": u32(1), "chunk_pos": struct.pack("<Q", at), "start_time": time, "end_time": time, "count": u32(1)},
        u32(0) + u32(1),
    )  # fmt: skip
    path.write_bytes(magic + bag_header(at + len(chunk) + len(index)) + chunk + index + connection + info)
    return path


@cache
def bz2_zeros(size):
    """Zeros that unpack to `size` bytes: streams may follow each other."""
    piece = bz2.compress(bytes(100_000_000))
    return piece * (size // 100_000_000)


@cache
def zstd_zeros(size):
    """Zeros in one frame that does not say how large it is."""
    out = io.BytesIO()
    with zstandard.ZstdCompressor(level=1, write_content_size=False).stream_writer(
        out, closefd=False
    ) as packer:
        for _ in range(size // 100_000_000):
            packer.write(bytes(100_000_000))
    return out.getvalue()


def write_mcap_chunks(path, packed, announced, *, compression="zstd", number=1):
    """Write chunks of one channel by hand; each announces to hold so many bytes."""

    def text_(value):
        return struct.pack("<I", len(value)) + value

    def record(opcode, data):
        return struct.pack("<BQ", opcode, len(data)) + data

    magic = b"\x89MCAP0\r\n"
    body = magic + record(1, text_(b"") + text_(b"test"))
    schema = record(
        3, struct.pack("<H", 1) + text_(b"std_msgs/msg/String") + text_(b"ros2msg") + text_(b"string data\n")
    )
    channel = record(4, struct.pack("<HH", 1, 1) + text_(b"/text") + text_(b"cdr") + text_(b""))
    indexes = b""
    name = compression.encode()
    for _ in range(number):
        offset = len(body)
        chunk = record(
            6,
            struct.pack("<QQQI", NOON_NS, NOON_NS + GIGABYTE, announced, 0)
            + text_(name)
            + struct.pack("<Q", len(packed))
            + packed,
        )
        body += chunk
        indexes += record(
            8,
            struct.pack("<QQQQ", NOON_NS, NOON_NS + GIGABYTE, offset, len(chunk))
            + text_(b"")
            + struct.pack("<Q", 0)
            + text_(name)
            + struct.pack("<QQ", len(packed), announced),
        )
    body += record(15, struct.pack("<I", 0))
    statistics = record(
        11,
        struct.pack("<QHIIIIQQ", number, 1, 1, 0, 0, number, NOON_NS, NOON_NS)
        + text_(struct.pack("<HQ", 1, number)),
    )
    footer = record(2, struct.pack("<QQI", len(body), 0, 0))
    path.write_bytes(body + schema + channel + statistics + indexes + footer + magic)
    return path


def small_messages(size):
    """A chunk of `size` bytes of empty messages."""
    one = struct.pack("<BQHIQQ", 5, 22, 1, 0, NOON_NS, NOON_NS)
    return one * (size // len(one))


# --- folders and databases ------------------------------------------------------------------


def write_packed_file(path, size):
    """A bag folder whose storage is packed by file, and unpacks to `size` bytes of zeros."""
    write_ros2(path, [text(NOON_NS)])
    (database,) = path.glob("*.db3")
    database.unlink()
    (path / f"{database.name}.zstd").write_bytes(zstd_zeros(size))
    metadata = path / "metadata.yaml"
    said = metadata.read_text().replace(database.name, f"{database.name}.zstd")
    said = said.replace("compression_format: ''", "compression_format: zstd").replace(
        "compression_mode: ''", "compression_mode: FILE"
    )
    assert "zstd" in said
    assert "FILE" in said
    metadata.write_text(said)
    return path


def write_packed_message(path, size):
    """A bag folder whose messages are packed one by one; one of them unpacks to `size` bytes."""
    write_ros2(path, [text(NOON_NS), text(NOON_NS + 1)])
    (database,) = path.glob("*.db3")
    with sqlite3.connect(database) as connection:
        for number, data in connection.execute("SELECT id, data FROM messages").fetchall():
            packed = zstandard.compress(data) if number > 1 else zstd_zeros(size)
            connection.execute("UPDATE messages SET data = ? WHERE id = ?", (packed, number))
    metadata = path / "metadata.yaml"
    said = metadata.read_text()
    said = said.replace("compression_format: ''", "compression_format: zstd").replace(
        "compression_mode: ''", "compression_mode: MESSAGE"
    )
    assert "MESSAGE" in said
    metadata.write_text(said)
    return path


def write_view(path):
    """A database whose messages are computed, without end."""
    write_ros2(path, [text(NOON_NS)])
    (database,) = path.glob("*.db3")
    with sqlite3.connect(database) as connection:
        connection.execute("DROP TABLE messages")
        connection.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
            "SELECT i AS id, 1 AS topic_id, i AS timestamp, zeroblob(900000000) AS data FROM n"
        )
    return path


# --- images and clouds ----------------------------------------------------------------------


def png_of(width, height):
    """A PNG that announces a size, and has a few bytes of pixels."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    pixels = zlib.compress(bytes(1000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def jpeg_of(image, width, height):
    """A JPEG that announces another size than it has."""
    at = image.index(b"\xff\xc0")
    return image[: at + 5] + struct.pack(">HH", height, width) + image[at + 9 :]


def image_message(width, height, data=None, number=0, encoding="rgb8", step=None):
    kind = STORE2.types["sensor_msgs/msg/Image"]
    values = np.zeros(100, np.uint8) if data is None else data
    return serialized(
        kind(
            header(number=number),
            height,
            width,
            encoding,
            0,
            width * 3 % 2**32 if step is None else step,
            values,
        ),
        "sensor_msgs/msg/Image",
    )


def compressed_message(data, number=0):
    kind = STORE2.types["sensor_msgs/msg/CompressedImage"]
    return serialized(
        kind(header(number=number), "", np.frombuffer(data, np.uint8)), "sensor_msgs/msg/CompressedImage"
    )


def cloud_message(width, height, point_step, data, number=0, fields="xyz", datatype=2):
    """A cloud whose fields all lie at the first byte of a point."""
    field = STORE2.types["sensor_msgs/msg/PointField"]
    kind = STORE2.types["sensor_msgs/msg/PointCloud2"]
    return serialized(
        kind(
            header("lidar", number), height, width, [field(name, 0, datatype, 1) for name in fields], False,
            point_step, width * point_step % 2**32, data, True,
        ),
        "sensor_msgs/msg/PointCloud2",
    )  # fmt: skip


def plain_drive(image, cloud=None, info_size=None):
    """The messages of the small drive, every fourth image and cloud replaced by what is given."""
    entries, numbers = [], {}
    replaced = {"/cam/image_raw": image, "/points": cloud}
    for topic, msgtype, _, message in messages(STORE2, 1.2):
        number = numbers[topic] = numbers.get(topic, -1) + 1
        if topic == "/cam/camera_info" and info_size is not None:
            message.width, message.height = info_size
        make = replaced.get(topic) if number % 4 == 3 else None
        data = serialized(message, msgtype) if make is None else make(number)
        entries.append((topic, msgtype, definition_of(msgtype), data))
    return entries


def compressed_drive(image):
    """The messages of the small drive, with a compressed image each time."""
    msgtype = "sensor_msgs/msg/CompressedImage"
    return [
        (topic, msgtype, definition_of(msgtype), compressed_message(image(number), number))
        if topic == "/cam/image_raw"
        else (topic, kind, definition, data)
        for number, (topic, kind, definition, data) in _numbered(plain_drive(None))
    ]


def _numbered(entries):
    numbers = {}
    for entry in entries:
        numbers[entry[0]] = numbers.get(entry[0], -1) + 1
        yield numbers[entry[0]], entry
