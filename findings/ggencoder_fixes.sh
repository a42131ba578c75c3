#!/usr/bin/env bash
# A boat's receiver sends RMC (with the date) and GGA (with the height), ten times a second, on 2026-01-15 from 10:30 on: 12.3 knots, 3 m above the sea, where the compass is off by 11 degrees; later
# it has no fix. They are decoded with ggencoder, "AIS & NMEA encoding decoding". Guess: each fix's own time, 12.3 knots, 3 m; nothing, or not valid, without a fix.
# Seen with ggencoder 1.0.10 on 2026-11-30, all with `valid: true` and without a word:
# - RMC: `alt` is 11, the variation of the compass (0 if it is left out); `sog` is 6.3, metres a second with one digit, where its AIS decoder has knots
# - RMC: `date` has whole seconds: ten fixes have one time. GGA: `date` is the instant at which it is decoded, so a log of January is of today
# - GGA without a fix (quality 0, no position): latitude and longitude of 0. A sentence whose digit was lost on the line (92.3 for 12.3, which its checksum tells) is a fix, too
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-audit --no-fund ggencoder@1.0.10 >/dev/null 2>&1
cat > fixes.js <<'JAVASCRIPT'
const assert = require("assert");
const { AisDecode, AisEncode, NmeaDecode } = require("ggencoder");

function sentence(body) {
  const checksum = [...body].reduce((sum, letter) => sum ^ letter.charCodeAt(0), 0);
  return `$${body}*${checksum.toString(16).toUpperCase().padStart(2, "0")}`;
}

const rmc = (time, speed = "12.3", variation = "11.0,E") => sentence(`GPRMC,${time},A,3348.0000,S,15112.0000,E,${speed},90.5,150126,${variation}`);
const gga = (time) => sentence(`GPGGA,${time},3348.0000,S,15112.0000,E,1,08,1.0,3.0,M,20.0,M,,`);

const first = new NmeaDecode(rmc("103000.00"));
console.log(`RMC: ${first.lat}, ${first.lon}, alt ${first.alt}, sog ${first.sog}`);
assert(first.valid && first.lat === -33.8 && first.lon === 151.2 && first.alt === 11 && first.sog === 6.3);
assert.strictEqual(new NmeaDecode(rmc("103000.00", "12.3", ",")).alt, 0);
const report = new AisEncode({ aistype: 18, repeat: 0, mmsi: "503123456", sog: 12.3, lon: 151.2, lat: -33.8, cog: 90.5, hdg: 90, utc: 0 });
assert.strictEqual(new AisDecode(report.nmea).sog, 12.3);

const dates = new Set();
for (let tenth = 0; tenth < 10; tenth++) dates.add(new NmeaDecode(rmc(`103000.${tenth}0`)).date);
console.log(`ten RMC of a second: ${dates.size} time`);
assert.deepStrictEqual([...dates], [first.date]);

const before = Date.now();
const height = new NmeaDecode(gga("103000.00"));
console.log(`GGA of 2026-01-15 10:30: alt ${height.alt}, decoded within a second of now: ${height.date - before < 1000}`);
assert(height.alt === 3 && height.date >= before && height.date - before < 10000);

const none = new NmeaDecode(sentence("GPGGA,103000.00,,,,,0,00,99.9,,M,,M,,"));
console.log(`GGA without a fix: valid ${none.valid}, ${none.lat}, ${none.lon}`);
assert(none.valid && none.lat === 0 && none.lon === 0);

const damaged = new NmeaDecode(rmc("103000.00").replace("12.3", "92.3"));
console.log(`RMC whose checksum is wrong: valid ${damaged.valid}, sog ${damaged.sog}`);
assert(damaged.valid && damaged.sog === 47.5);
JAVASCRIPT
node fixes.js > said.txt 2>&1 || { tail -8 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
