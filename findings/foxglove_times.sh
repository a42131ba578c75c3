#!/usr/bin/env bash
# Does a stamp of Foxglove's messages stay the same, to the nanosecond, in protobuf, JSON and CDR, through the decoders of mcap?
# Guess: yes, since all three hold two integers. Seen with foxglove-sdk 0.30.3, mcap-protobuf-support 0.6.0, protobuf 7.36.2 and
# mcap-ros2-support 0.6.0 on 2026-11-28: as integers, yes. Otherwise a stamp is lost in four ways, of which one says so:
# - `Timestamp.from_epoch_secs(1700000000.1)` is 96 ns early; `ToDatetime()` of what was read cuts off nanoseconds
# - a stamp that was not given reads as 1970-01-01 (only `HasField` tells), with no word of it in the writer
# - the decoded message as JSON (`MessageToDict`) has text in place of sec and nsec, so it does not fit Foxglove's own JSON schema
# - `Duration.from_secs(-0.1)` is -1 s + 900,000,000 ns, whose signs differ: protobuf forbids that, and `MessageToDict` fails for the
#   whole message, which the SDK wrote without complaint
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check foxglove-sdk==0.30.3 mcap==1.6.0 protobuf==7.36.2 \
  mcap-protobuf-support==0.6.0 mcap-ros2-support==0.6.0
cd "$folder"
venv/bin/python - <<'PYTHON'
import json
from pathlib import Path

import foxglove
from foxglove.channels import PosesInFrameChannel, SceneUpdateChannel
from foxglove.messages import Duration, PosesInFrame, SceneEntity, SceneUpdate, Timestamp
from google.protobuf.json_format import MessageToDict, SerializeToJsonError
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoder
from mcap_ros2.decoder import DecoderFactory as CdrDecoder
from mcap_ros2.writer import Writer as CdrWriter

SEC, NSEC = 1700000000, 123456789
with foxglove.open_mcap("proto.mcap"):
    poses, scenes = PosesInFrameChannel("/poses"), SceneUpdateChannel("/scene")
    poses.log(PosesInFrame(timestamp=Timestamp(SEC, NSEC), frame_id="map"), log_time=1)
    poses.log(PosesInFrame(frame_id="map"), log_time=2)
    lifetime = Duration.from_secs(-0.1)
    scenes.log(SceneUpdate(entities=[SceneEntity(timestamp=Timestamp(SEC, NSEC), lifetime=lifetime)]), log_time=3)
with foxglove.open_mcap("json.mcap"):
    channel = foxglove.Channel("/poses_json", message_encoding="json")
    channel.log({"timestamp": {"sec": SEC, "nsec": NSEC}, "frame_id": "map"}, log_time=1)
with Path("cdr.mcap").open("wb") as file:
    writer = CdrWriter(file)
    definition = "builtin_interfaces/Time timestamp\nstring frame_id\n" + "=" * 80
    definition += "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    schema = writer.register_msgdef("foxglove_msgs/msg/PosesInFrame", definition)
    writer.write_message("/poses", schema, {"timestamp": {"sec": SEC, "nanosec": NSEC}, "frame_id": "map"})
    writer.finish()


def decoded(path, *factories):
    with Path(path).open("rb") as file:
        return [message for *_, message in make_reader(file, decoder_factories=factories).iter_decoded_messages()]


stamped, unstamped, scene = decoded("proto.mcap", ProtobufDecoder())
(cdr,) = decoded("cdr.mcap", CdrDecoder())
with Path("json.mcap").open("rb") as file:
    ((_, _, message),) = make_reader(file).iter_messages()
plain = json.loads(message.data)["timestamp"]
print("as integers:", stamped.timestamp.ToNanoseconds(), cdr.timestamp, plain)
assert (stamped.timestamp.seconds, stamped.timestamp.nanos) == (SEC, NSEC)
assert (cdr.timestamp.sec, cdr.timestamp.nanosec) == (plain["sec"], plain["nsec"]) == (SEC, NSEC)

early = Timestamp.from_epoch_secs(SEC + 0.1)
print("from_epoch_secs(1700000000.1):", early.sec, early.nsec, " ToDatetime:", stamped.timestamp.ToDatetime())
assert (early.sec, early.nsec) == (SEC, 99999904)
assert stamped.timestamp.ToDatetime().microsecond * 1000 == 123456000

print("not given:", unstamped.timestamp.ToDatetime(), unstamped.HasField("timestamp"))
assert unstamped.timestamp.ToNanoseconds() == 0
assert not unstamped.HasField("timestamp")

print("MessageToDict:", MessageToDict(stamped))
assert MessageToDict(stamped)["timestamp"] == "2023-11-14T22:13:20.123456789Z"

span = scene.entities[0].lifetime
assert (span.seconds, span.nanos) == (-1, 900000000)
try:
    MessageToDict(scene)
except SerializeToJsonError as error:
    print(f"-1 s + 900,000,000 ns: {error}")
else:
    raise SystemExit("protobuf takes it now")
PYTHON
