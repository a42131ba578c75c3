#!/usr/bin/env bash
# A web page records what rosbridge sends it: messages of ROS 2 as JSON, where bytes (uint8[]) are base64 and a beam without a return (infinite) is null, as JSON has no such
# numbers. It writes them as CDR, for an MCAP, with @foxglove/rosmsg2-serialization; a script does the same with arrays that it has computed. What is in the file?
# Guess: the pixels, NaN for null, or an error for what is not of the type. Seen with @foxglove/rosmsg2-serialization 3.1.0 and @foxglove/rosmsg 5.0.5 on 2026-11-29,
# without a word of the writer:
# - base64: the length of the TEXT, 16 for 12 bytes, and no bytes at all behind it. Read again, a picture is 16 zeros, or what comes behind it in the message
# - null: a range of 0 m
# - Float64Array for float32[], or Float32Array for float64[], as computations give them: the length, and no numbers
# - a flag that is 1, as Python and SQL have it, is false; 300 in a uint8 is 44
# What the reader makes of it is an error, "Offset is outside the bounds", only where the message is too short.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-fund --no-audit --prefix "$folder" @foxglove/rosmsg2-serialization@3.1.0 @foxglove/rosmsg@5.0.5
cat > write.mjs <<'JAVASCRIPT'
import assert from "node:assert/strict";
import { parse } from "@foxglove/rosmsg";
import { MessageReader, MessageWriter } from "@foxglove/rosmsg2-serialization";

/** Write a message of this definition, and return its bytes in hexadecimal, without the four of the encapsulation, and what is read of them. */
function writtenAndRead(definition, message) {
  const types = parse(definition, { ros2: true });
  const bytes = new MessageWriter(types).writeMessage(message);
  try {
    return [Buffer.from(bytes).toString("hex").slice(8), new MessageReader(types).readMessage(bytes)];
  } catch (error) {
    return [Buffer.from(bytes).toString("hex").slice(8), error.message];
  }
}

const pixels = Buffer.from([10, 20, 30, 40, 50, 60, 70, 80, 90, 100, 110, 120]);
const image = "uint8[] data\n";
const [right] = writtenAndRead(image, { data: new Uint8Array(pixels) });
assert.equal(right, "0c000000" + pixels.toString("hex"));
const [text, zeros] = writtenAndRead(image, { data: pixels.toString("base64") });
console.log("base64:", text, zeros.data.join(" "));
assert.equal(text, "10000000");
assert.deepEqual([...zeros.data], Array(16).fill(0));

const scan = "float32[] ranges\nfloat32[] intensities\n";
const [, beams] = writtenAndRead(scan, JSON.parse(JSON.stringify({ ranges: [1.5, Infinity, 2.5], intensities: [] })));
console.log("ranges:", beams.ranges.join(" "));
assert.deepEqual([...beams.ranges], [1.5, 0, 2.5]);
const [doubles, error] = writtenAndRead(scan, { ranges: new Float64Array([1, 2, 3]), intensities: [] });
console.log("Float64Array for float32[]:", doubles, error);
assert.equal(doubles, "0300000000000000"); // two lengths, of 3 and 0, and nothing else
assert.match(error, /outside the bounds/);
const [singles] = writtenAndRead("float64[] position\n", { position: new Float32Array([1, 2]) });
assert.equal(singles, "02000000");

const [, flags] = writtenAndRead("bool calibrated\nuint8 level\n", { calibrated: 1, level: 300 });
console.log("flags:", flags);
assert.deepEqual({ ...flags }, { calibrated: false, level: 44 });
JAVASCRIPT
node write.mjs
