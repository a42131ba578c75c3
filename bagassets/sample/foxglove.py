"""The writer of sample recordings without ROS: MCAP with Foxglove's messages as protobuf."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import Message as ProtobufMessage

from bagassets.base.errors import RecordingError
from bagassets.recordings.heads import time_ns
from bagassets.recordings.model import Message
from bagassets.sample.recorder import Compression, McapRecorder
from bagassets.view.mcap_scene import register
from bagassets.view.messages import stamp


class FoxgloveRecorder(McapRecorder):
    """An MCAP; messages are made as those of ROS 2, and converted to the ones of Foxglove that say the same."""

    def __init__(self, path: Path, compression: Compression, stack: ExitStack) -> None:
        super().__init__(path, compression, stack, profile="")

    @staticmethod
    def converted(msgtype: str, message: Message) -> Any:  # noqa: ANN401  (a protobuf message, whose fields only its schema knows)
        """Return the message of Foxglove that says the same as one of ROS.

        Raises:
            RecordingError: it is none of the arm.
        """
        if msgtype not in _MESSAGES:
            raise RecordingError(f"{msgtype}: recordings of the sample without ROS have no such messages.")
        kind, fields_of = _MESSAGES[msgtype]
        return kind(**fields_of(message))

    def serialize(self, msgtype: str, message: Message) -> bytes:
        """Return the bytes of a message, as `converted`."""
        return bytes(self.converted(msgtype, message).SerializeToString(deterministic=True))

    def _channel(self, topic: str, msgtype: str) -> int:
        return register(self._writer, topic, _MESSAGES[msgtype][0].DESCRIPTOR)


def _joints(message: Message) -> dict[str, Any]:
    pairs = zip(message.name, message.position, strict=True)
    return {
        "timestamp": stamp(time_ns(message.header.stamp) or 0),
        "joints": [JointState(name=name, position=float(position)) for name, position in pairs],
    }


def _image(message: Message, *fields: str) -> dict[str, Any]:
    head = {"timestamp": stamp(time_ns(message.header.stamp) or 0), "frame_id": message.header.frame_id}
    return head | {"data": message.data.tobytes()} | {name: getattr(message, name) for name in fields}


# Type in ROS -> the class of Foxglove's message, and what its fields are.
_MESSAGES: Mapping[str, tuple[type[ProtobufMessage], Callable[[Message], dict[str, Any]]]] = {
    "sensor_msgs/msg/CompressedImage": (CompressedImage, lambda one: _image(one, "format")),
    "sensor_msgs/msg/Image": (RawImage, lambda one: _image(one, "width", "height", "encoding", "step")),
    "sensor_msgs/msg/JointState": (JointStates, _joints),
    "std_msgs/msg/String": (Log, lambda one: {"message": one.data, "level": Log.INFO}),
}
