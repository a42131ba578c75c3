"""A ROS 1 bag whose index was made anew, as `rosbag reindex` does it."""

import struct
from collections import defaultdict

MAGIC = b"#ROSBAG V2.0\n"
HEADER_BYTES = 4096
MESSAGE, HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7


def reindexed(bag: bytes) -> bytes:
    """Return the bag with the same chunks and an index made from what is in them.

    Connections are listed in another order than before, as they are when another program writes the index.
    Chunks must not be compressed.
    """
    out = bytearray(bag[: len(MAGIC) + HEADER_BYTES])
    connections, infos = {}, []
    for fields, body, start, end in records(bag, len(MAGIC)):
        if fields["op"][0] != CHUNK:
            continue
        assert fields["compression"] == b"none"
        infos.append((len(out), index := index_of(body, connections)))
        out += bag[start:end]
        for connection in sorted(index, reverse=True):
            entries = index[connection]
            out += record(
                {"op": INDEX, "ver": u32(1), "conn": u32(connection), "count": u32(len(entries))},
                b"".join(time + u32(offset) for time, offset in entries),
            )
    at = len(out)
    for connection in sorted(connections, reverse=True):
        out += connections[connection]
    for chunk_at, index in infos:
        times = sorted((time for entries in index.values() for time, _ in entries), key=seconds)
        out += record(
            {
                "op": CHUNK_INFO, "ver": u32(1), "chunk_pos": u64(chunk_at), "start_time": times[0],
                "end_time": times[-1], "count": u32(len(index)),
            },
            b"".join(u32(connection) + u32(len(index[connection])) for connection in sorted(index, reverse=True)),
        )  # fmt: skip
    fields = {
        "op": HEADER,
        "index_pos": u64(at),
        "conn_count": u32(len(connections)),
        "chunk_count": u32(len(infos)),
    }
    padding = HEADER_BYTES - len(record(fields, b""))
    out[len(MAGIC) : len(MAGIC) + HEADER_BYTES] = record(fields, b" " * padding)
    return bytes(out)


def index_of(chunk, connections):
    """Return connection -> (time, offset) of the messages in a chunk; note the connections' records."""
    index = defaultdict(list)
    for fields, _, start, end in records(chunk, 0):
        connection = struct.unpack("<I", fields["conn"])[0]
        if fields["op"][0] == CONNECTION:
            connections[connection] = chunk[start:end]
        else:
            assert fields["op"][0] == MESSAGE
            index[connection].append((fields["time"], start))
    return index


def records(data, at):
    """Yield (fields of the header, body, start, end) of the records from an offset on."""
    while at < len(data):
        start = at
        (header_bytes,) = struct.unpack_from("<I", data, at)
        fields, at = {}, at + 4
        while at < start + 4 + header_bytes:
            (field_bytes,) = struct.unpack_from("<I", data, at)
            name, _, value = data[at + 4 : at + 4 + field_bytes].partition(b"=")
            fields[name.decode()] = value
            at += 4 + field_bytes
        (body_bytes,) = struct.unpack_from("<I", data, at)
        end = at + 4 + body_bytes
        yield fields, data[at + 4 : end], start, end
        at = end


def record(fields, body):
    entries = [name.encode() + b"=" + (bytes([v]) if isinstance(v, int) else v) for name, v in fields.items()]
    header = b"".join(u32(len(entry)) + entry for entry in entries)
    return u32(len(header)) + header + u32(len(body)) + body


def u32(value):
    return struct.pack("<I", value)


def u64(value):
    return struct.pack("<Q", value)


def seconds(time):
    return struct.unpack("<II", time)
