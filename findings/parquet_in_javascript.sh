#!/usr/bin/env bash
# A table of an episode as robot datasets have it, in Parquet: images as bytes of JPEG beside their path (as Hugging Face keeps them), stamps to the nanosecond, counts of microseconds.
# It is read in JavaScript, as viewers of datasets on web pages do it. Guess: bytes are bytes; stamps of nanoseconds are BigInt, as Date has milliseconds, or fail.
# Seen with hyparquet 1.33.0 and apache-arrow 21.2.0 of npm, and pyarrow 26.0.1 on 2026-11-30, without a word:
# - hyparquet makes TEXT of bytes as if they were UTF-8, also within a struct: what is none is U+FFFD, and an image of 6 bytes is another one of 11. With `utf8: false` it has the bytes,
#   and text that is marked as such is text still
# - timestamps are Date in hyparquet, cut off to milliseconds, so that messages 0.4 ms apart have one time. Plain integers of 64 bits are BigInt, exact
# - apache-arrow has milliseconds as a number of 64 bits: to the next 256 ns; `.toArray()` of the column is exact. A duration is BigInt in both
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pyarrow==26.0.1
npm install --silent --no-fund --no-audit --prefix "$folder" hyparquet@1.33.0 apache-arrow@21.2.0
venv/bin/python - <<'PYTHON'
import pyarrow as pa
import pyarrow.parquet as pq

stamp_ns = 1_700_000_000_123_456_789
image = bytes.fromhex("ffd8ffe04142")
table = pa.table(
    {
        "image": pa.array([{"bytes": image, "path": "a.jpg"}] * 2),
        "raw": pa.array([image] * 2),
        "stamp": pa.array([stamp_ns, stamp_ns + 400_000], pa.timestamp("ns")),
        "stamp_ns": pa.array([stamp_ns, stamp_ns + 400_000], pa.int64()),
        "late": pa.array([1500, 1501], pa.duration("ns")),
        "task": pa.array(["pick ü", "place"]),
    }
)
pq.write_table(table, "episode.parquet")
with pa.OSFile("episode.arrow", "wb") as file, pa.ipc.new_file(file, table.schema) as writer:
    writer.write_table(table)
PYTHON
cat > read.mjs <<'JAVASCRIPT'
import assert from "node:assert/strict";
import fs from "node:fs";
import { asyncBufferFromFile, parquetReadObjects } from "hyparquet";
import { tableFromIPC } from "apache-arrow";

const file = await asyncBufferFromFile("episode.parquet");
const [first, second] = await parquetReadObjects({ file });
console.log("hyparquet:", first, second.stamp);
for (const bytes of [first.image.bytes, first.raw]) {
  assert.equal(typeof bytes, "string");
  const again = Buffer.from(bytes, "utf8");
  console.log("  as bytes again:", again.toString("hex"));
  assert(again.length > 6);
  assert(bytes.startsWith("\ufffd"));
}
assert.equal(first.stamp.toISOString(), "2023-11-14T22:13:20.123Z");
assert.equal(second.stamp.getTime(), first.stamp.getTime());
assert.equal(first.stamp_ns, 1700000000123456789n);
assert.equal(first.late, 1500n);

const [asBytes] = await parquetReadObjects({ file, utf8: false });
assert.equal(Buffer.from(asBytes.image.bytes).toString("hex"), "ffd8ffe04142");
assert.deepEqual([asBytes.image.path, asBytes.task], ["a.jpg", "pick ü"]);

const table = tableFromIPC(fs.readFileSync("episode.arrow"));
const stamps = table.getChild("stamp");
console.log("apache-arrow:", stamps.get(0), table.getChild("stamp_ns").get(0), stamps.toArray()[0]);
assert.equal(typeof stamps.get(0), "number");
assert.notEqual(BigInt(Math.round((stamps.get(0) % 1000) * 1e6)) % 1000000000n, 123456789n);
assert.equal(stamps.toArray()[0], 1700000000123456789n);
assert.deepEqual([...table.getChild("raw").get(0)], [255, 216, 255, 224, 65, 66]);
JAVASCRIPT
node read.mjs
