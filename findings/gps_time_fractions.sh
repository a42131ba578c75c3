#!/usr/bin/env bash
# A GNSS receiver gives ten fixes a second. A web page turns their Unix times, in milliseconds, into GPS time with gps-time of npm (`toGPSMS`), and back (`toUnixMS`).
# Guess: 18 s more than the difference of the two epochs, for each of the ten, and the same time when it comes back. Seen with gps-time 1.0.8 of npm on 2026-11-30,
# without a word: so it is for one of ten, that on the whole second. The other nine are half a second late, in GPS time and when they come back: a time whose
# milliseconds are not 0 is taken for a leap second, which the package marks that way. So a drive has gaps of 0.6 s, and after 0.9 s comes a whole second that
# is earlier
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-fund --no-audit gps-time@1.0.8 >/dev/null
cat > times.cjs <<'JS'
const assert = require("assert");
const { toGPSMS, toUnixMS } = require("gps-time");
const GPS_EPOCH_MS = Date.UTC(1980, 0, 6);
const LEAP_MS = 18_000; // by which GPS time is ahead of UTC since 2017
const START_MS = Date.UTC(2023, 10, 14, 22, 13, 20);
const fixes = Array.from({ length: 11 }, (_, n) => START_MS + 100 * n);
const late = fixes.map((ms) => toGPSMS(ms) - (ms - GPS_EPOCH_MS + LEAP_MS));
const back = fixes.map((ms) => toUnixMS(toGPSMS(ms)) - ms);
const steps = fixes.slice(1).map((ms, n) => toGPSMS(ms) - toGPSMS(fixes[n]));
console.log("late, in GPS time:", late.join(" "), "ms; and back in Unix time:", back.join(" "), "ms");
console.log("from one fix to the next:", steps.join(" "), "ms");
assert.deepEqual(late, [0, ...Array(9).fill(500), 0]);
assert.deepEqual(back, late);
assert.deepEqual(steps, [600, ...Array(8).fill(100), -400]);
assert.equal(toUnixMS(START_MS + 300 - GPS_EPOCH_MS + LEAP_MS), START_MS + 300); // the way from GPS time alone is right
JS
node times.cjs
