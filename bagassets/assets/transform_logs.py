"""Reading the TF topics of a recording into edges, with every sample accounted for."""

from collections.abc import Collection

from bagassets.assets.channel import Counts
from bagassets.decode.loading import own_decoder
from bagassets.decode.tf import decode_transform
from bagassets.errors import DecodeError
from bagassets.geometry.tf_tree import Edge, TransformLog
from bagassets.recipe.model_base import Clock
from bagassets.recordings.recording import Recording

__all__ = ["read_transforms"]


def read_transforms(
    recording: Recording,
    topics: Collection[str],
    source: str,
    counts: Counts | None = None,
    *,
    clock: Clock = "header",
    troubles: dict[str, str] | None = None,
) -> list[Edge]:
    """Return the edges in `topics`.

    Args:
        recording: has the topics.
        topics: topics of transforms.
        source: name of the source, for edges.
        counts: gets the numbers of transforms read and lost.
        clock: which time of a transform counts: its header stamp, or the log time of its message.
        troubles: gets, for each topic with transforms that cannot be decoded, the first reason.
    """
    log = TransformLog(source)
    counts = counts if counts is not None else Counts()
    troubles = troubles if troubles is not None else {}
    for message in recording.messages(topics):
        try:
            stamped = own_decoder("transforms", message.msgtype)(recording.decode(message))
        except DecodeError as err:
            counts.read += 1
            counts.lose(str(err))
            troubles.setdefault(message.topic, str(err))
            continue
        for transform in stamped:
            counts.read += 1
            try:
                reading = decode_transform(transform)
            except DecodeError as err:
                counts.lose(str(err))
                troubles.setdefault(message.topic, str(err))
                continue
            stamp_ns = reading.stamp_ns if clock == "header" else message.log_time_ns
            log.add(reading.parent, reading.child, stamp_ns, reading.parent_SE3_child, message.topic)
            counts.written += 1
    return log.edges()
