#!/usr/bin/env bash
# A GoPro drives past points that it reaches 0.1 s apart, at a speed that rises by 0.1 m/s each. Its telemetry (GPMF) has the ten fixes of a second in one
# block, with one time (GPSU); cameras before it had 18 in a second. What track (GPX) does gpmf make of two such seconds? Guess: twenty points, 0.1 s
# apart. Seen with gpmf 0.1 on 2026-11-29, without a word: it takes 1/18 s between two points, whatever the camera, so each second is driven in its first
# half, at nearly twice the speed, and followed by a pause of half a second; the tenth point is 0.4 s too early. The speeds that it writes beside them
# are those of the first point of each block, ten times. A camera of today (GPS9, since HERO11, which has a time for each fix) has no track at all.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps gpmf==0.1 gpxpy==1.6.2 numpy==2.4.6
cd "$folder"
sed -i '/gps_plot/d' venv/lib/python3*/site-packages/gpmf/__init__.py  # drawing maps, which needs much more
venv/bin/python - <<'PYTHON'
import struct
from datetime import datetime

import gpmf
import numpy as np


def item(key, kind, size, payload):
    """Return an item of GPMF: a name, a type, the size of an element, how many, and the bytes, padded to four."""
    return key + struct.pack(">cBH", kind, size, len(payload) // size if size else len(payload)) + payload + bytes(-len(payload) % 4)


def nested(key, payload):
    return key + struct.pack(">cBH", b"\0", 1, len(payload)) + payload


def second(number, fixes):
    """Return the block of a second: position in 1e-7 degrees, height in mm, speeds in mm/s and cm/s."""
    rows = [
        struct.pack(">5i", int(481234567 + 100 * n), 115678901, 520_000, round(1000 * (10 + n / 10)), round(100 * (10 + n / 10)))
        for n in fixes
    ]
    stream = item(b"STNM", b"c", 1, b"GPS (Lat., Long., Alt., 2D speed, 3D speed)") + item(b"GPSF", b"L", 4, struct.pack(">I", 3))
    stream += item(b"GPSU", b"U", 16, b"261129%06d.000" % (100_000 + number)) + item(b"GPSP", b"S", 2, struct.pack(">H", 150))
    stream += item(b"UNIT", b"c", 3, b"degdegm\0\0m/sm/s") + item(b"SCAL", b"l", 4, struct.pack(">5i", 10**7, 10**7, 1000, 1000, 100))
    return nested(b"DEVC", nested(b"STRM", stream + item(b"GPS5", b"l", 20, b"".join(rows))))


def track(telemetry):
    blocks = [gpmf.gps.parse_gps_block(block) for block in gpmf.gps.extract_gps_blocks(telemetry)]
    return gpmf.gps.make_pgx_segment(blocks).points


points = track(second(0, range(10)) + second(1, range(10, 20)))
start = datetime(2026, 11, 29, 10, 0, 0)
seconds = np.array([(point.time - start).total_seconds() for point in points])
speeds = [float(point.extensions[1].find("value").text) for point in points]
print("times: ", seconds.round(3).tolist())
print("speeds:", speeds)
true_s = np.arange(20) / 10
assert np.allclose([point.latitude for point in points], 48.1234567 + 1e-5 * np.arange(20), atol=1e-9)
assert np.allclose(seconds, np.concatenate([np.arange(10), np.arange(10) + 18]) / 18, atol=1e-5)
assert np.isclose(true_s[9] - seconds[9], 0.4)
assert speeds == [10.0] * 10 + [11.0] * 10

newer = nested(b"DEVC", nested(b"STRM", item(b"SCAL", b"l", 4, struct.pack(">9i", 10**7, 10**7, 1000, 1000, 100, 1, 1000, 100, 1))
    + item(b"TYPE", b"c", 1, b"lllllllSS")
    + item(b"GPS9", b"?", 32, struct.pack(">7iHH", 481234567, 115678901, 520_000, 10_000, 1000, 9829, 36_000_000, 150, 3))))
print("points of a camera with GPS9:", len(track(newer)))
assert track(newer) == []
PYTHON
