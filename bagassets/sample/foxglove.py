"""The writer of sample recordings without ROS: MCAP with Foxglove's messages as protobuf."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message as ProtobufMessage
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType, Writer

from bagassets.base.errors import RecordingError
from bagassets.recordings.heads import time_ns
from bagassets.recordings.model import Message
from bagassets.sample.recorder import Compression, Recorder
from bagassets.view.mcap_scene import register
from bagassets.view.messages import stamp


class FoxgloveRecorder(Recorder):
    """An MCAP; messages are made as those of ROS 2, and converted to the ones of Foxglove that say the same."""

    def __init__(self, path: Path, compression: Compression, stack: ExitStack) -> None:
        super().__init__(ros1=False)
        stream = stack.enter_context(path.open("xb"))
        self._writer = Writer(stream, compression=CompressionType[compression.upper()])
        self._writer.start(profile="", library="bagassets sample")
        stack.callback(self._writer.finish)

    @staticmethod
    def converted(msgtype: str, message: Message) -> Any:  # noqa: ANN401  (a protobuf message, whose fields only its schema knows)
        """Return the message of Foxglove that says the same as one of ROS.

        Raises:
            RecordingError: it is none of the arm.
        """
        if msgtype not in _CONVERTERS:
            raise RecordingError(f"{msgtype}: recordings of the sample without ROS have no such messages.")
        return _CONVERTERS[msgtype](message)

    def serialize(self, msgtype: str, message: Message) -> bytes:
        """Return the bytes of a message, as `converted`."""
        return bytes(self.converted(msgtype, message).SerializeToString(deterministic=True))

    def _add(self, topic: str, msgtype: str) -> Callable[[int, bytes | bytearray], None]:
        channel = register(self._writer, topic, _DESCRIBED[msgtype]().DESCRIPTOR)
        return lambda log_time_ns, data: self._writer.add_message(
            channel, log_time_ns, bytes(data), log_time_ns
        )


@cache
def _joint_states() -> type[ProtobufMessage]:
    """Return the class of `foxglove.JointStates`, which versions of the package before 0.4 lack."""
    kinds = FieldDescriptorProto
    file = FileDescriptorProto(name="foxglove/JointStates.proto", package="foxglove", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    joint = file.message_type.add(name="JointState")
    joint.field.add(name="name", number=1, type=kinds.TYPE_STRING, label=kinds.LABEL_OPTIONAL)
    for number, name in enumerate(("position", "velocity", "acceleration", "effort"), 2):
        joint.oneof_decl.add(name=f"_{name}")
        joint.field.add(
            name=name, number=number, type=kinds.TYPE_DOUBLE, label=kinds.LABEL_OPTIONAL,
            proto3_optional=True, oneof_index=number - 2,
        )  # fmt: skip
    states = file.message_type.add(name="JointStates")
    states.field.add(
        name="timestamp", number=1, type=kinds.TYPE_MESSAGE, label=kinds.LABEL_OPTIONAL,
        type_name=".google.protobuf.Timestamp",
    )  # fmt: skip
    states.field.add(
        name="joints",
        number=2,
        type=kinds.TYPE_MESSAGE,
        label=kinds.LABEL_REPEATED,
        type_name=".foxglove.JointState",
    )
    pool = DescriptorPool()
    pool.AddSerializedFile(Timestamp.DESCRIPTOR.file.serialized_pb)
    pool.AddSerializedFile(file.SerializeToString())
    made: type[ProtobufMessage] = GetMessageClass(pool.FindMessageTypeByName("foxglove.JointStates"))
    return made


def _converted_joints(message: Message) -> ProtobufMessage:
    states: Any = _joint_states()()
    stamp_ns = time_ns(message.header.stamp) or 0
    states.timestamp.seconds, states.timestamp.nanos = divmod(stamp_ns, 10**9)
    for name, position in zip(message.name, message.position, strict=True):
        states.joints.add(name=name, position=float(position))
    return states


def _head(message: Message) -> dict[str, Any]:
    return {"timestamp": stamp(time_ns(message.header.stamp) or 0), "frame_id": message.header.frame_id}


# Type in ROS -> the class of Foxglove's message, and what makes one.
_DESCRIBED: Mapping[str, Callable[[], type[ProtobufMessage]]] = {
    "sensor_msgs/msg/CompressedImage": lambda: CompressedImage,
    "sensor_msgs/msg/Image": lambda: RawImage,
    "sensor_msgs/msg/JointState": _joint_states,
    "std_msgs/msg/String": lambda: Log,
}
_CONVERTERS: Mapping[str, Callable[[Message], ProtobufMessage]] = {
    "sensor_msgs/msg/CompressedImage": lambda one: CompressedImage(
        **_head(one), data=one.data.tobytes(), format=one.format
    ),
    "sensor_msgs/msg/Image": lambda one: RawImage(
        **_head(one),
        width=one.width,
        height=one.height,
        encoding=one.encoding,
        step=one.step,
        data=one.data.tobytes(),
    ),
    "sensor_msgs/msg/JointState": _converted_joints,
    "std_msgs/msg/String": lambda one: Log(message=one.data, level=Log.INFO),
}
