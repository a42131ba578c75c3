#!/usr/bin/env bash
# A boat's drive of January, over midnight, is replayed from its sentences: RMC, with the date, and GGA, with the height, ten times a second.
# @signalk/nmea0183-signalk, the parser of Signal K, makes deltas of them, each with a timestamp. Of when are they? Guess: of the times of the sentences, to
# the tenth; GGA has no date, and takes that of RMC, or has none. Seen with @signalk/nmea0183-signalk 3.20.1 of npm on 2026-11-30, without a word:
# - RMC: as guessed. GGA, GLL and GNS: on the day on which they are PARSED, years later, though the RMC of the same fix came before: `navigation.position`
#   jumps between the drive and today
# - GGA, GLL and GNS have whole seconds: ten heights of a second have one time; RMC, parsed by the same package, has its tenths
# - live, a GGA of 23:59:59.9 that is parsed 0.15 s later (the clock is set to that) is of the day that has just begun, 24 h ahead
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-fund --no-audit @signalk/nmea0183-signalk@3.20.1 @signalk/nmea0183-utilities@1.1.1 >/dev/null
cat > replay.cjs <<'JS'
const assert = require("assert");
const Parser = require("@signalk/nmea0183-signalk");

function sentence(body) {
  const sum = [...body].reduce((total, char) => total ^ char.charCodeAt(0), 0);
  return `$${body}*${sum.toString(16).toUpperCase().padStart(2, "0")}`;
}

const parser = new Parser();
const stamps = {};
for (const [time, date] of [["235959.90", "150126"], ["000000.00", "160126"], ["000000.10", "160126"], ["000000.20", "160126"]]) {
  const place = "4808.00000,N,01130.00000,E";
  for (const [name, body] of [
    ["RMC", `GPRMC,${time},A,${place},19.44,90.0,${date},,,A`],
    ["GGA", `GPGGA,${time},${place},4,20,0.6,560.0,M,46.0,M,,`],
    ["GLL", `GPGLL,${place},${time},A,A`],
    ["GNS", `GNGNS,${time},${place},RR,20,0.6,560.0,46.0,,`],
  ]) {
    const [update] = parser.parse(sentence(body)).updates;
    assert(update.values.some((value) => value.path === "navigation.position"));
    (stamps[name] ??= []).push(update.timestamp);
  }
}
const today = new Date().toISOString().slice(0, 10);
console.log(stamps.RMC, stamps.GGA);
assert.deepStrictEqual(stamps.RMC, ["2026-01-15T23:59:59.900Z", "2026-01-16T00:00:00.000Z", "2026-01-16T00:00:00.100Z", "2026-01-16T00:00:00.200Z"]);
for (const name of ["GGA", "GLL", "GNS"]) {
  assert.deepStrictEqual(stamps[name], ["23:59:59", "00:00:00", "00:00:00", "00:00:00"].map((time) => `${today}T${time}.000Z`));
}

const RealDate = Date;
globalThis.Date = class extends RealDate {
  constructor(...given) {
    super(...(given.length ? given : [RealDate.UTC(2026, 0, 16, 0, 0, 0, 50)]));
  }
};
const [live] = new Parser().parse(sentence("GPGGA,235959.90,4808.00000,N,01130.00000,E,4,20,0.6,560.0,M,46.0,M,,")).updates;
console.log("live:", live.timestamp);
assert.strictEqual(live.timestamp, "2026-01-16T23:59:59.000Z");
JS
node replay.cjs
