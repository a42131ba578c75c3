#!/usr/bin/env bash
# Three markers of motion capture (TRC) are followed: at the wrist, which is hidden in the second of three frames, at the elbow and at the shoulder. A hidden marker is an empty place between
# tabs; the package writes it so, too. The take is read with trc-data-reader, kept, and read again. Guess: the wrist has no position in the second frame, and the rest is as before.
# Seen with trc-data-reader 0.4.1 on 2026-11-30, without a word:
# - in the second frame the elbow's position is the wrist's, the shoulder's is the elbow's, and the SHOULDER is hidden: lines are split at any white space, so empty places close up.
#   The wrist jumps by the length of the forearm for as long as it is hidden; hidden in the last column, all is right
# - kept again, the shifted positions are the file's; and its times are rounded to milliseconds: at 240 Hz by up to half of one, an eighth of a step
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check trc-data-reader==0.4.1 c3d==0.6.0 numpy==2.4.6 2>/dev/null
cat > take.py <<'PYTHON'
import math
from pathlib import Path

from trc import TRCData

MARKERS = {"Wrist": (500.0, 100.0, 1000.0), "Elbow": (250.0, 100.0, 1000.0), "Shoulder": (0.0, 100.0, 1300.0)}
RATE_HZ = 240


def write(path, hidden):
    """Write three frames; this marker is hidden in the second one."""
    names = list(MARKERS)
    rows = [
        "PathFileType\t4\t(X/Y/Z)\ttake.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{RATE_HZ}\t{RATE_HZ}\t3\t3\tmm\t{RATE_HZ}\t1\t3",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{number}" for number in (1, 2, 3) for axis in "XYZ"),
        "",
    ]
    for frame in (1, 2, 3):
        places = ["\t\t" if frame == 2 and name == hidden else "\t".join(str(value) for value in MARKERS[name]) for name in names]
        rows.append(f"{frame}\t{(frame - 1) / RATE_HZ:.6f}\t" + "\t".join(places))
    Path(path).write_text("\n".join(rows) + "\n")


def read(path):
    """Return the data, and positions of all markers in the second frame, None if hidden."""
    data = TRCData()
    data.load(path)
    assert [data[name][frame] for name in MARKERS for frame in (0, 2)] == [list(place) for place in MARKERS.values() for _ in (0, 2)]
    return data, {name: None if math.isnan(data[name][1][0]) else tuple(data[name][1]) for name in MARKERS}


for hidden in ("Shoulder", "Wrist"):
    write("take.trc", hidden)
    data, second = read("take.trc")
    print(f"hidden is the {hidden}:", second)
assert second == {"Wrist": MARKERS["Elbow"], "Elbow": MARKERS["Shoulder"], "Shoulder": None}
data.save("kept.trc")
kept, again = read("kept.trc")
print("kept again:", again, "- times in s:", kept["Time"])
assert again == second and kept["Time"] == [0.0, 0.004, 0.008]

# The package's own file of a hidden wrist, which it imported as such, has the empty place, too.
data["Frame#"], data[2] = [1, 2, 3], (1 / RATE_HZ, [[math.nan] * 3, list(MARKERS["Elbow"]), list(MARKERS["Shoulder"])])
data.save("own.trc")
assert Path("own.trc").read_text().splitlines()[-2].split("\t")[2:6] == ["", "", "", "250.00000"]
print("its own file:", read("own.trc")[1])
assert read("own.trc")[1] == second
PYTHON
venv/bin/python -W error take.py
