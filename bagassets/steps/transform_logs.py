"""Reading the TF topics of a recording into edges, every sample accounted for."""

from collections.abc import Collection

from bagassets.bags.model import Recording
from bagassets.decode.tf import decode_transform, transforms
from bagassets.errors import DecodeError
from bagassets.geometry.tf_tree import Edge, TransformLog
from bagassets.steps.channel import Counts

__all__ = ["read_transforms"]


def read_transforms(
    recording: Recording, topics: Collection[str], source: str, counts: Counts | None = None
) -> list[Edge]:
    """Return the edges in `topics`; `counts` takes the number of transforms read and lost."""
    log = TransformLog(source)
    counts = counts if counts is not None else Counts()
    for message in recording.messages(topics):
        try:
            stamped = transforms(recording.decode(message))
        except DecodeError as err:
            counts.read += 1
            counts.lose(str(err))
            continue
        for transform in stamped:
            counts.read += 1
            try:
                reading = decode_transform(transform)
            except DecodeError as err:
                counts.lose(str(err))
                continue
            log.add(reading.parent, reading.child, reading.stamp_ns, reading.parent_SE3_child)
            counts.written += 1
    return log.edges()
