#!/usr/bin/env bash
# A recorded drive over midnight, of a receiver of 10 Hz, has sentences RMC, with the date, and GGA, with the height. They become points on a map in a web page. When was each,
# how fast, and where is a receiver that has no position? Guess: at the times of the sentences; knots, or metres per second; nowhere.
# Seen with nmea-simple 3.3.0 and gps 0.9.0 of npm on 2026-11-29, without a word:
# - nmea-simple knows fractions of a second of exactly TWO digits. 221320.5 and 221320.500 are both 20.000 s, so that the ten fixes of a second have one time
# - both put a GGA on the day of READING, as it has no date, also right behind an RMC of that second; over midnight time goes back by a day
# - gps has `speed` in km/h, nmea-simple in knots (`speedKnots`); and a magnetic variation to the west is -3.1 in one, and 3.1 with a "W" in another field in the other
# - without a position, nmea-simple has one at 0, 0, with a height of 0; gps has null
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-fund --no-audit --prefix "$folder" nmea-simple@3.3.0 gps@0.9.0
cat > times.cjs <<'JAVASCRIPT'
const assert = require("node:assert/strict");
const GPS = require("gps");
const simple = require("nmea-simple");

/** Return a sentence with its checksum. */
function sentence(text) {
  const sum = [...text].reduce((sum, letter) => sum ^ letter.charCodeAt(0), 0);
  return `$${text}*${sum.toString(16).toUpperCase().padStart(2, "0")}`;
}

const rmc = (time) => sentence(`GPRMC,${time},A,4807.038,N,01131.000,E,022.4,084.4,141123,003.1,W,A`);
const gga = (time) => sentence(`GPGGA,${time},4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,`);

for (const [time, bySimple] of [["221320.50", 500], ["221320.5", 0], ["221320.500", 0], ["221320.1234", 0]]) {
  const found = simple.parseNmeaSentence(rmc(time)).datetime.getUTCMilliseconds();
  console.log(`${time}: ${found} ms by nmea-simple, ${GPS.Parse(rmc(time)).time.getUTCMilliseconds()} by gps`);
  assert.equal(found, bySimple);
}

const state = new GPS();
const times = [rmc("235959.90"), gga("235959.90"), gga("000000.10")].map((line) => {
  state.update(line);
  return state.state.time;
});
console.log("RMC, GGA, GGA past midnight:", times.map((time) => time.toISOString()).join(" "));
assert.equal(times[0].toISOString(), "2023-11-14T23:59:59.900Z");
assert(times[1].getUTCFullYear() > 2023);
assert.equal(times[1] - times[2], 86399800);
assert(simple.parseNmeaSentence(gga("000000.10")).time.getUTCFullYear() > 2023);

const [byGps, bySimple] = [GPS.Parse(rmc("221320.50")), simple.parseNmeaSentence(rmc("221320.50"))];
assert.deepEqual([byGps.speed, byGps.variation], [41.4848, -3.1]);
assert.deepEqual([bySimple.speedKnots, bySimple.variation, bySimple.variationPole], [22.4, 3.1, "W"]);

const lost = sentence("GPGGA,221320.50,,,,,0,00,99.9,,M,,M,,");
const { latitude, longitude, altitudeMeters } = simple.parseNmeaSentence(lost);
console.log("without a fix:", latitude, longitude, altitudeMeters);
assert.deepEqual([latitude + 0, longitude + 0, altitudeMeters], [0, 0, 0]);
assert.equal(GPS.Parse(lost).lat, null);
JAVASCRIPT
node times.cjs
