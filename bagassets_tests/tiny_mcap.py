"""The small drive as an MCAP whose messages a test may spoil, written in a millisecond."""

from functools import cache

from mcap.writer import CompressionType, Writer

from bagassets_tests.small_drive import LATENCY_NS, STORE2, messages


@cache
def _serialized(duration_s):
    return [
        (
            topic,
            msgtype,
            stamp_ns,
            bytes(STORE2.serialize_cdr(message, msgtype)),
            STORE2.generate_msgdef(msgtype, ros_version=2)[0].encode(),
        )
        for topic, msgtype, stamp_ns, message in messages(STORE2, duration_s)
    ]


def write_tiny(
    path, note="", *, duration_s=1.2, spoil=None, compression=CompressionType.ZSTD, chunk_size=1024 * 1024
):
    """Write the drive.

    Args:
        path: the file.
        note: goes into the metadata: the messages stay the same, the content does not.
        duration_s: length of the drive.
        spoil: (topic, number of the message on it, bytes) -> bytes to write instead.
        compression: of chunks.
        chunk_size: bytes of messages after which a chunk ends.
    """
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size, compression)
        writer.start(profile="", library="test")
        channels, numbers = {}, {}
        for topic, msgtype, stamp_ns, data, definition in _serialized(duration_s):
            if topic not in channels:
                schema = writer.register_schema(msgtype, "ros2msg", definition)
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            number = numbers[topic] = numbers.get(topic, -1) + 1
            written = data if spoil is None else spoil(topic, number, data)
            writer.add_message(channels[topic], stamp_ns + LATENCY_NS, written, stamp_ns)
        writer.add_metadata("note", {"text": note})
        writer.finish()
    return path
