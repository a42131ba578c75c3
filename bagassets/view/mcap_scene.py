"""Writing a scene as MCAP.

Topics: `/tf` (foxglove.FrameTransforms), `/ego` (PoseInFrame), `/path` (PosesInFrame), `/location`
(LocationFix), `/boxes` (SceneUpdate), `/<CHANNEL>/image` and `/calibration` (CompressedImage,
CameraCalibration), `/<CHANNEL>/points` (PointCloud). Every message carries the time of the reading that it is
made from; schemas are embedded, so that any reader of MCAP with protobuf can decode the file.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.descriptor import Descriptor, FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message
from mcap.writer import CompressionType, Writer

from bagassets import __version__
from bagassets.base.errors import DatasetError
from bagassets.base.files import make_folder, replacing
from bagassets.formats.reader.source import Reading
from bagassets.geometry.wgs84 import LocalFrame
from bagassets.recordings.own_files import VIEW_LIBRARY
from bagassets.view import messages
from bagassets.view.scene import DatasetScene

Fix = tuple[int, float, float]
TimedMessage = tuple[str, int, Message]


def write_scene(scene: DatasetScene, output: Path, fixes: Sequence[Fix] = ()) -> dict[str, int]:
    """Write a scene, whole or not at all; return topic -> number of messages.

    Args:
        scene: the scene.
        output: the file; an existing one is replaced.
        fixes: stamp, latitude and longitude, for scenes whose global frame has no known place on Earth.

    Raises:
        DatasetError: a file of the scene is missing, or the output cannot be written.
    """
    counts: Counter[str] = Counter()
    try:
        make_folder(output.parent)
        with replacing(output) as temporary, temporary.open("wb") as stream:
            writer: Any = Writer(stream, compression=CompressionType.ZSTD)
            writer.start(profile="", library=f"{VIEW_LIBRARY} {__version__}")
            channels: dict[str, int] = {}
            for topic, stamp_ns, message in _in_order(scene, fixes):
                if topic not in channels:
                    channels[topic] = register(writer, topic, message.DESCRIPTOR)
                data = message.SerializeToString(deterministic=True)
                writer.add_message(channels[topic], log_time=stamp_ns, publish_time=stamp_ns, data=data)
                counts[topic] += 1
            writer.finish()
    except OSError as err:
        raise DatasetError(
            f"{err.filename or output}: cannot be read or written ({err.strerror}); build the dataset again, or choose "
            "another --output."
        ) from err
    return dict(sorted(counts.items()))


def _in_order(scene: DatasetScene, fixes: Sequence[Fix]) -> Iterator[TimedMessage]:
    """Yield the messages in order of time; each file is read when it is needed."""
    if not scene.readings:
        return
    categories = sorted({row["category"] for rows in scene.boxes.values() for row in rows})
    start_ns = scene.readings[0].stamp_ns
    poses = {reading.stamp_ns: reading.find_pose() for reading in scene.readings}
    yield "/path", start_ns, messages.path(start_ns, [poses[stamp] for stamp in sorted(poses)])
    events: list[tuple[int, str, Callable[[], Message]]] = [
        *((at, "/boxes", partial(messages.boxes, at, rows, categories)) for at, rows in scene.boxes.items()),
        *((at, "/location", partial(messages.location, at, *place)) for at, place in _places(scene, fixes)),
    ]
    waiting = sorted(events, key=lambda event: event[:2])
    mounts = {reading.channel: reading.ego_SE3_sensor for reading in scene.readings}
    moved_ns = None
    for reading in scene.readings:
        while waiting and waiting[0][0] <= reading.stamp_ns:
            at_ns, topic, make = waiting.pop(0)
            yield topic, at_ns, make()
        if moved_ns != reading.stamp_ns:
            moved_ns = reading.stamp_ns
            edges = [(messages.GLOBAL, messages.EGO, reading.find_pose())]
            # Extrinsics are constant, but repeated with each pose so that playback may begin anywhere.
            edges += [(messages.EGO, name, ego_SE3_sensor) for name, ego_SE3_sensor in sorted(mounts.items())]
            yield "/tf", moved_ns, messages.transforms(moved_ns, edges)
            yield "/ego", moved_ns, messages.pose(moved_ns, reading.find_pose())
        yield from _reading(reading)
    for at_ns, topic, make in waiting:
        yield topic, at_ns, make()


def _reading(reading: Reading) -> Iterator[TimedMessage]:
    name = f"/{reading.channel}"
    if reading.modality == "camera":
        if reading.intrinsics:
            yield f"{name}/calibration", reading.stamp_ns, messages.calibration(reading)
        yield f"{name}/image", reading.stamp_ns, messages.image(reading)
    else:
        yield f"{name}/points", reading.stamp_ns, messages.cloud(reading)


def _places(
    scene: DatasetScene, fixes: Sequence[Fix]
) -> Iterator[tuple[int, tuple[float, float, float | None]]]:
    """Yield places of the vehicle: from its pose at each sample, else from the fixes during the scene."""
    first_ns, last_ns = scene.readings[0].stamp_ns, scene.readings[-1].stamp_ns
    if scene.origin is None or scene.origin.get("kind") != "wgs84":
        for stamp_ns, lat, lon in fixes:
            if first_ns <= stamp_ns <= last_ns:
                yield stamp_ns, (lat, lon, None)
        return
    frame = LocalFrame(scene.origin["lat"], scene.origin["lon"], scene.origin["alt"])
    samples = set(scene.samples)
    at = {r.stamp_ns: r.find_pose().translation for r in scene.readings if r.stamp_ns in samples}
    columns = frame.to_geodetic(np.array([at[stamp] for stamp in sorted(at)]).reshape(-1, 3))
    for stamp_ns, lat, lon, alt in zip(sorted(at), *(column.tolist() for column in columns), strict=True):
        yield stamp_ns, (lat, lon, alt)


def register(writer: Any, topic: str, descriptor: Descriptor) -> int:
    """Register a topic with the schema of its messages; return the channel."""
    files = FileDescriptorSet()
    _add_file(files, descriptor.file)
    schema = writer.register_schema(
        descriptor.full_name, "protobuf", files.SerializeToString(deterministic=True)
    )
    return int(writer.register_channel(topic, "protobuf", schema))


def _add_file(files: FileDescriptorSet, file: FileDescriptor) -> None:
    """Add a file after its imports, each file once."""
    if any(known.name == file.name for known in files.file):
        return
    for dependency in file.dependencies:
        _add_file(files, dependency)
    file.CopyToProto(files.file.add())
