#!/usr/bin/env bash
# A sprayer in Germany works from 10:30 to 10:31 in the morning, in July, and its terminal logs it once a second as ISOXML does (ISO 11783-10): times of the task and of the records are local, without a zone, and
# each position has the UTC of its receiver, 8:30. In the fourth second the receiver has lost its fix (status 0), and repeats its last position. It is read (version 3) with isoxml of npm on a computer of
# that zone, and saved. Guess: records within the task, as local times or as 8:30 UTC; the same task when saved; no valid position without a fix.
# Seen with isoxml 1.11.2 on 2026-11-30, without a word:
# - the task begins at 08:30:00Z, its first record is at 10:30:00Z: two hours after its end, and after `GpsUtcTime` beside it. Records are taken as UTC, the task as local to the computer
# - saved, the task begins at 08:30:00, without a zone: two hours earlier each time that it is read and saved; records stay. On a computer
#   that runs in UTC, as servers do, task and records agree, at 10:30Z, two hours after the receiver
# - `isValidPosition` is true without a fix
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-audit --no-fund isoxml@1.11.2 >/dev/null 2>&1
cat > times.js <<'JAVASCRIPT'
const assert = require("assert");
const { ISOXMLManager } = require("isoxml");
const JSZip = require("jszip");

const HEAD = '<?xml version="1.0" encoding="UTF-8"?>';
const TASK = `${HEAD}<ISO11783_TaskData VersionMajor="3" VersionMinor="3" ManagementSoftwareManufacturer="a" ManagementSoftwareVersion="1" DataTransferOrigin="2">
<DVC A="DVC-1" B="Sprayer" D="A00C800C00000000" F="31000000000000" G="FF000000006564"><DET A="DET-1" B="1" C="1" D="Boom" E="0" F="0"/></DVC>
<TSK A="TSK-1" B="Field" G="4"><TIM A="2026-07-15T10:30:00" B="2026-07-15T10:31:00" D="4"/><TLG A="TLG00001" C="1"/></TSK></ISO11783_TaskData>`;
const LOG = `${HEAD}<TIM A="" D="4"><PTN A="" B="" D="" H="" I=""/><DLV A="0001" B="" C="DET-1"/></TIM>`;
const DAYS = Math.floor((Date.UTC(2026, 6, 15) - Date.UTC(1980, 0, 1)) / 86400000);

function record(second) {
  const buffer = Buffer.alloc(27);
  let end = buffer.writeUInt32LE((10 * 3600 + 30 * 60 + second) * 1000, 0);
  end = buffer.writeUInt16LE(DAYS, end);
  end = buffer.writeInt32LE(521000000 + Math.min(second, 2) * 100, end);
  end = buffer.writeInt32LE(41000000, end);
  end = buffer.writeUInt8(second === 3 ? 0 : 4, end);
  end = buffer.writeUInt32LE((8 * 3600 + 30 * 60 + second) * 1000, end);
  end = buffer.writeUInt16LE(DAYS, end);
  end = buffer.writeUInt8(1, end);
  end = buffer.writeUInt8(0, end);
  assert.strictEqual(buffer.writeInt32LE(20000, end), buffer.length);
  return buffer;
}

async function readAndSave(data) {
  const manager = new ISOXMLManager();
  await manager.parseISOXMLFile(data, "application/zip");
  assert.deepStrictEqual(manager.getWarnings(), []);
  const written = await manager.saveISOXML();
  const zip = await JSZip.loadAsync(written);
  const text = await zip.file(Object.keys(zip.files).find((name) => name.endsWith("TASKDATA.XML"))).async("string");
  return { manager, data: written, saved: text.match(/<TIM A="([^"]*)"/)[1] };
}

(async () => {
  const inUtc = process.env.TZ === "UTC";
  const zip = new JSZip();
  zip.file("TASKDATA/TASKDATA.XML", TASK).file("TASKDATA/TLG00001.xml", LOG);
  zip.file("TASKDATA/TLG00001.bin", Buffer.concat([0, 1, 2, 3].map(record)));
  const { manager, saved: again, data } = await readAndSave(await zip.generateAsync({ type: "uint8array" }));
  const { saved: twice } = await readAndSave(data);
  const task = manager.rootElement.attributes.Task[0];
  const { Start: start } = task.attributes.Time[0].attributes;
  const records = task.attributes.TimeLog[0].parseBinaryFile().timeLogs;
  const [first] = records;
  const receiver = new Date(Date.UTC(1980, 0, 1) + first.position.GpsUtcDate * 86400000 + first.position.GpsUtcTime);
  console.log(`${process.env.TZ}: task ${new Date(start).toISOString()}, record ${first.time.toISOString()}, its receiver ${receiver.toISOString()}, saved ${again}, again ${twice}`);
  console.log(`${process.env.TZ}: status ${records.map((one) => one.position.PositionStatus)}, valid ${records.map((one) => one.isValidPosition)}`);
  assert.strictEqual(first.time.toISOString(), "2026-07-15T10:30:00.000Z");
  assert.strictEqual(receiver.toISOString(), "2026-07-15T08:30:00.000Z");
  assert.strictEqual(new Date(start).toISOString(), inUtc ? "2026-07-15T10:30:00.000Z" : "2026-07-15T08:30:00.000Z");
  assert.deepStrictEqual([again, twice], inUtc ? ["2026-07-15T10:30:00", "2026-07-15T10:30:00"] : ["2026-07-15T08:30:00", "2026-07-15T06:30:00"]);
  assert(records[3].position.PositionStatus === "0" && records[3].isValidPosition);
})().catch((error) => {
  console.error(error);
  process.exit(1);
});
JAVASCRIPT
for zone in Europe/Berlin UTC; do
  TZ=$zone node times.js > said.txt 2>&1 || { tail -8 said.txt; exit 1; }
  if grep -i warn said.txt; then exit 1; fi
  cat said.txt
done
