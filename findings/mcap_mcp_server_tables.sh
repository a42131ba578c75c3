#!/usr/bin/env bash
# Recordings (MCAP, ROS 2) are asked in SQL through mcap-mcp-server, as by a language model. The first has two wheels that publish by turns, and is read with `downsample=2`. In the
# second, of a later day, fixes have one more field, their age, before latitude and longitude; it is loaded beside the first, under a name of its own.
# Guess: every second message of each topic; and the second's fields by its own definition, which MCAP keeps in each file, or an error.
# Seen with mcap-mcp-server 0.5.1 on 2026-11-30, without a word:
# - one wheel has all of its messages, the other has no table at all: messages of all topics are counted together. By 10 the IMU of 100 Hz may have them all
# - the later fixes have the age for latitude and the latitude for longitude, since definitions are kept by their number in a file, for all files that are loaded,
#   and both have number 1. `get_schema` names three fields, the table has two
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mcap-mcp-server==0.5.1 mcp==1.30.0 mcap==1.6.0 mcap-ros2-support==0.6.0 duckdb==2.0.1 pandas==3.1.1
cd "$folder"
venv/bin/python - 2>/dev/null <<'PYTHON'
import asyncio
import json
import struct
from pathlib import Path

from mcap.writer import Writer
from mcap_mcp_server.config import ServerConfig
from mcap_mcp_server.server import create_server

FIX = "float64 latitude\nfloat64 longitude\n"


def write(path, definitions, messages):
    """Write messages (topic, numbers), 10 ms apart, of topics whose definitions have float64 alone."""
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {}
        for topic, definition in definitions.items():
            schema = writer.register_schema(f"robot_msgs/msg/{topic.title()}", "ros2msg", definition.encode())
            channels[topic] = writer.register_channel(f"/{topic}", "cdr", schema)
        for number, (topic, values) in enumerate(messages):
            data = b"\0\1\0\0" + struct.pack(f"<{len(values)}d", *values)
            writer.add_message(channels[topic], number * 10**7, data, number * 10**7)
        writer.finish()


server = create_server(ServerConfig(data_dir=Path()))


def call(tool, **arguments):
    content, *_ = asyncio.run(server.call_tool(tool, arguments))
    return json.loads((content[0] if isinstance(content, list) else content).text)


wheels = [(("left", "right")[number % 2], [float(number)]) for number in range(20)]
write("wheels.mcap", {"left": "float64 speed\n", "right": "float64 speed\n"}, wheels)
tables = call("load_recording", file="wheels.mcap", downsample=2)["tables"]
print("every second message:", tables)
assert tables == {"right": {"rows": 10, "columns": 2}}

write("monday.mcap", {"fix": FIX}, [("fix", (48.1, 11.5))])
write("friday.mcap", {"fix": f"float64 age\n{FIX}"}, [("fix", (0.25, 48.2, 11.6))])
server = create_server(ServerConfig(data_dir=Path()))
fixes = {}
for day in ("monday", "friday"):
    call("load_recording", file=f"{day}.mcap", alias=day)
    found = call("query", sql=f"SELECT * FROM {day}_fix")
    fixes[day] = dict(zip(found["columns"], *found["rows"], strict=True))
print(fixes)
assert fixes["monday"] == {"timestamp_us": 0, "latitude": 48.1, "longitude": 11.5}
assert fixes["friday"] == {"timestamp_us": 0, "latitude": 0.25, "longitude": 48.2}
fields = call("get_schema", file="friday.mcap")["topics"]["/fix"]["fields"]
assert [field["name"] for field in fields] == ["timestamp_us", "age", "latitude", "longitude"]

server = create_server(ServerConfig(data_dir=Path()))
call("load_recording", file="friday.mcap", alias="friday")
assert call("query", sql="SELECT latitude FROM friday_fix")["rows"] == [[48.2]]
PYTHON
