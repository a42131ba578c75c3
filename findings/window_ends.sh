#!/usr/bin/env bash
# A recording with a message each second is read in windows: from 0 to 5 s, then from 5 to 10 s. Who has the message at 5 s, and what does a
# selection of topics that is empty, since no topic fits a pattern, select? Guess: start belongs to a window and end does not, so that
# windows add up; and nothing is selected. Seen on 2026-11-29, of one file:
#   mcap 1.6.0, small-mcap 0.16.0       5 messages a window; an empty selection is empty
#   rosbags 0.11.9                      5 messages a window; an empty selection of connections is ALL of them
#   pybag-sdk 0.13.0, @mcap/core 2.2.2  6 messages a window, that at 5 s in both; an empty selection is empty
# Nothing is said. Newer names of mcap itself, `ending_before` and `ending_at`, say which it is.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mcap==1.6.0 mcap-ros2-support==0.6.0 small-mcap==0.16.0 rosbags==0.11.9 \
  pybag-sdk==0.13.0
cd "$folder"
npm install --silent --no-fund --no-audit @mcap/core@2.2.2 @mcap/nodejs@1.0.2 @mcap/support@1.1.0
cat >windows.mjs <<'JS'
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";

const file = await open("drive.mcap");
const decompressHandlers = await loadDecompressHandlers();
const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(file), decompressHandlers });
const seconds = async (options) => {
  const found = [];
  for await (const message of reader.readMessages(options)) found.push(Number(message.logTime / 1_000_000_000n));
  return found;
};
const first = await seconds({ startTime: 0n, endTime: 5_000_000_000n });
const second = await seconds({ startTime: 5_000_000_000n, endTime: 10_000_000_000n });
console.log(JSON.stringify([first, second, await seconds({ topics: [] })]));
await file.close();
JS
venv/bin/python -W ignore::DeprecationWarning - <<'PYTHON'
import json
import subprocess
from pathlib import Path

import small_mcap
from mcap.reader import make_reader
from mcap_ros2.writer import Writer
from pybag.mcap_reader import McapFileReader
from rosbags.highlevel import AnyReader

SECOND = 10**9
WINDOWS = ((0, 5 * SECOND), (5 * SECOND, 10 * SECOND))
with open("drive.mcap", "wb") as file:
    writer = Writer(file)
    point = writer.register_msgdef("geometry_msgs/msg/Point", "float64 x\nfloat64 y\nfloat64 z\n")
    for second in range(11):
        time_ns = second * SECOND
        writer.write_message("/point", point, {"x": 0.0, "y": 0.0, "z": 0.0}, log_time=time_ns, publish_time=time_ns)
    writer.finish()

seen = {}
with open("drive.mcap", "rb") as file:
    reader = make_reader(file)
    read = [[m.log_time // SECOND for _, _, m in reader.iter_messages(start_time=a, end_time=b)] for a, b in WINDOWS]
    seen["mcap"] = [*read, list(reader.iter_messages(topics=[]))]
read = []
for start, end in WINDOWS:
    with open("drive.mcap", "rb") as file:
        found = small_mcap.read_message(file, start_time_ns=start, end_time_ns=end)
        read.append([message.log_time // SECOND for _, _, message in found])
with open("drive.mcap", "rb") as file:
    seen["small-mcap"] = [*read, list(small_mcap.read_message(file, should_include=small_mcap.include_topics([])))]
with AnyReader([Path("drive.mcap")]) as reader:
    read = [[time_ns // SECOND for _, time_ns, _ in reader.messages(start=a, stop=b)] for a, b in WINDOWS]
    seen["rosbags"] = [*read, [time_ns // SECOND for _, time_ns, _ in reader.messages([])]]
with McapFileReader.from_file("drive.mcap") as reader:
    read = [[m.log_time // SECOND for m in reader.messages("/point", start_time=a, end_time=b)] for a, b in WINDOWS]
    seen["pybag"] = [*read, list(reader.messages([]))]
ran = subprocess.run(["node", "windows.mjs"], capture_output=True, check=True, text=True)
seen["@mcap/core"] = json.loads(ran.stdout)

for name, (first, second, none) in seen.items():
    print(f"{name}: {first}, {second}; of no topics: {len(none)}")
    both = 5 if name in ("pybag", "@mcap/core") else 4
    assert first == list(range(both + 1))
    assert second == list(range(5, both + 6))
    assert len(none) == (11 if name == "rosbags" else 0)
PYTHON
