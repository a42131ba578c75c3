#!/usr/bin/env bash
# Cameras beside a robot are cut by timecode (SMPTE): one of 24000/1001 pictures a second, and one of 30000/1001 with drop-frame codes, which leave out the codes of frames 0 and 1 of each minute but each tenth.
# Picture 86,400 of the first is at 01:00:00:00, since there are no drop-frame codes at its rate. Of the second each picture of ten minutes, 17,982, gets its code.
# Guess: 01:00:00:00; and as many codes as pictures, the one after 00:00:59;29 at 00:01:00;02, as with timecode and smpte-timecode.
# Seen with dftt-timecode 1.0.0 (Python) and timecode-boss 6.2.0 (Node.js), beside timecode 1.5.1 and smpte-timecode 1.3.6, on 2026-11-30, without a word:
# - dftt-timecode: 01:00:03;14, three and a half seconds later: codes are dropped at 23.976 and 23.98, whether `drop_frame=False` or not, and "01:00:00:00" is refused there. At 29.97 and 59.94 all is right
# - timecode-boss: the last two pictures of each minute, 00:00:59;28 and 00:00:59;29, are at 00:01:00;02 and ;03, as the two after them are: 20 codes in ten minutes stand for two pictures each. From code
#   to picture it is right
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-deps dftt-timecode==1.0.0 timecode==1.5.1 2>/dev/null
npm install --silent --no-fund --no-audit timecode-boss@6.2.0 smpte-timecode@1.3.6 > npm.txt 2>&1 || { tail -3 npm.txt; exit 1; }
cat > codes.py <<'PYTHON'
from dftt_timecode import DfttTimecode
from dftt_timecode.error import DFTTTimecodeInitializationError
from timecode import Timecode

for rate_hz in (23.976, 24000 / 1001, 23.98):
    code = DfttTimecode(86_400, "frame", fps=rate_hz, drop_frame=False).timecode_output("smpte")
    try:
        refused = str(DfttTimecode("01:00:00:00", fps=rate_hz, drop_frame=False).framecount)
    except DFTTTimecodeInitializationError as error:
        refused = str(error)
    print(f"dftt-timecode, picture 86400 at {rate_hz:.5f} Hz: {code}; of 01:00:00:00: {refused}")
    assert code == "01:00:03;14" and "DONOT match" in refused
print("timecode:", Timecode("23.976", frames=86_401))  # which counts pictures from 1
assert str(Timecode("23.976", frames=86_401)) == "01:00:00:00"
for picture, code in ((1799, "00:00:59;29"), (1800, "00:01:00;02"), (17_982, "00:10:00;00")):
    both = DfttTimecode(picture, "frame", fps=29.97, drop_frame=True).timecode_output("smpte"), str(Timecode("29.97", frames=picture + 1))
    assert both == (code, code), both
PYTHON
cat > codes.mjs <<'JAVASCRIPT'
import assert from "node:assert";
import smpte from "smpte-timecode";
import boss from "timecode-boss";

const Timecode = boss.default ?? boss;
const pictures = [...Array(17982 + 2).keys()];
const codes = pictures.map((picture) => new Timecode(picture, 29.97).toString());
const right = pictures.map((picture) => smpte(picture, 29.97, true).toString());
const wrong = pictures.filter((picture) => codes[picture] !== right[picture]);
console.log(`timecode-boss: ${new Set(codes).size} codes of ${codes.length} pictures;`, wrong.slice(0, 4).map((picture) => `${right[picture]} is ${codes[picture]}`).join(", "));
console.log(`and picture ${codes.lastIndexOf(codes[1799])} is ${codes[1799]}, too; smpte-timecode: ${new Set(right).size} codes`);
assert.equal(wrong.length, 20);
assert.deepEqual([codes[1798], codes[1799], codes[1800], codes[1801]], ["00:01:00;02", "00:01:00;03", "00:01:00;02", "00:01:00;03"]);
assert.equal(new Set(codes).size, 17984 - 20);
assert.equal(new Set(right).size, 17984);
assert.equal(new Timecode("00:00:59;29", 29.97).frameCount(), 1799);
JAVASCRIPT
venv/bin/python -W error codes.py
node codes.mjs
