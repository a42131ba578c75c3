#!/usr/bin/env bash
# A boat drifts to the east off Sydney at 0.3 knots, and reports its position by AIS every 10 s, in steps of 1/10,000 of a minute (17 cm): the sentences are logged with the time that the shore station
# received them (tag block, `c:`, in seconds or, as NMEA 4.10 allows, too, in milliseconds). They are decoded with aiscat ("fast, complete") and with pyais. Guess: the same positions, and each sentence's time.
# Seen with aiscat 0.68.16 and pyais 3.3.1 on 2026-11-30, without a word, of aiscat:
# - coordinates have the digits of float32, though they come as Python's floats: steps of 1.4 m off Sydney (beyond 128 degrees). The boat stands still, jumps by up to 2.8 m, and
#   drives at 0 to 0.55 knots by its positions, which are up to 1.2 m off; off Rotterdam, 4 cm
# - a time in milliseconds is dropped: there is no `toa`, only `rxuxtime`, which is when it was decoded; a replayed log of January is of today
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check aiscat==0.68.16 pyais==3.3.1 2>/dev/null
cat > positions.py <<'PYTHON'
import functools
import math
import operator
import time

import aiscat
import pyais

KNOT_MPS, DEGREE_M = 0.514444, 111_320


def sentence(longitude, latitude):
    report = {"type": 1, "mmsi": "503123456", "speed": 0.3, "lon": longitude, "lat": latitude, "course": 90.0, "heading": 90, "second": 0}
    return pyais.encode_dict(report, talker_id="AI", sentence_type="VDM")[0]


for place, longitude, latitude, off_m in (("Sydney", 151.2, -33.8, 1.2), ("Rotterdam", 4.1, 52.0, 0.04)):
    a_degree_m = DEGREE_M * math.cos(math.radians(latitude))
    sent = [sentence(longitude + 10 * number * 0.3 * KNOT_MPS / a_degree_m, latitude) for number in range(30)]
    right = [pyais.decode(line).lon for line in sent]
    found = [aiscat.decode(line)["lon"] for line in sent]
    most_m = max(abs(one - other) for one, other in zip(found, right)) * a_degree_m
    for name, longitudes in (("pyais", right), ("aiscat", found)):
        knots = [(after - before) * a_degree_m / 10 / KNOT_MPS for before, after in zip(longitudes, longitudes[1:])]
        print(f"{place}, {name}: {min(knots):.2f} to {max(knots):.2f} knots, {len(set(longitudes))} positions")
        assert max(knots) < 0.35 or (place, name) == ("Sydney", "aiscat")
        assert (place, name) != ("Sydney", "aiscat") or (abs(min(knots)) < 0.01 and 0.5 < max(knots) < 0.6)
    print(f"{place}: up to {most_m:.2f} m off")
    assert math.isclose(most_m, off_m, rel_tol=0.2)

times = []
for stamp in ("c:1768478400", "c:1768478400123"):
    tag = f"{stamp}*{functools.reduce(operator.xor, stamp.encode()):02X}"
    (message,) = aiscat.iter_decode([f"\\{tag}\\{sentence(151.2, -33.8)}\n".encode()])
    times.append(message.get("toa"))
    print(stamp, "toa:", message.get("toa"), "rxuxtime:", message["rxuxtime"])
    assert abs(message["rxuxtime"] - time.time()) < 60
assert times == [1768478400.0, None]
PYTHON
venv/bin/python positions.py > said.txt 2>&1 || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
