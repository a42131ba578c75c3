#!/usr/bin/env bash
# Two takes of Lab Streaming Layer (XDF) lie in a folder. The first has two wristbands of one model, so of one name and type, told apart by their `source_id`, and a force plate; in the second one the plate
# was off. lsl-xdf-reader writes a table (CSV) for each stream of each take. Guess: three tables of the first take, two of the second.
# Seen with lsl-xdf-reader 0.1 beside pyxdf 1.17.5 on 2026-11-30, after "... DONE!" for each:
# - of the two wristbands there is one, the last
# - the second take has a table of the plate, too, which is the FIRST take's: what a take lacks is filled from those before it
# - "Effective Sampling Rate" of 1000 samples of 1 s at 1000 Hz is 1001 Hz: samples are divided by the time from the first to the last
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check lsl-xdf-reader==0.1 pyxdf==1.17.5 numpy==2.4.6 2>/dev/null
cat > tables.py <<'PYTHON'
import glob
import struct
import sys
from pathlib import Path
from unittest.mock import MagicMock

sys.modules["tkinter"] = sys.modules["tkinter.filedialog"] = MagicMock()  # a window in which one chooses a folder
import numpy as np
import pyxdf
from lsl_xdf_reader import parse_xdf

RATE_HZ, START_S = 1000, 100.0


def chunk(tag, body):
    return b"\x04" + struct.pack("<IH", len(body) + 2, tag) + body


def stream(number, name, kind, value):
    """Return the chunks of a stream of a second, which has this value."""
    times_s = START_S + np.arange(RATE_HZ) / RATE_HZ
    header = (
        f"<info><name>{name}</name><type>{kind}</type><channel_count>1</channel_count><nominal_srate>{RATE_HZ}</nominal_srate><channel_format>double64</channel_format>"
        f"<source_id>serial {number}</source_id><created_at>0</created_at><hostname>robot</hostname>"
        f"<desc><channels><channel><label>{name}</label><unit>V</unit></channel></channels></desc></info>"
    )
    samples = b"".join(struct.pack("<Bdd", 8, time_s, value) for time_s in times_s)
    footer = f"<info><first_timestamp>{times_s[0]}</first_timestamp><last_timestamp>{times_s[-1]}</last_timestamp><sample_count>{RATE_HZ}</sample_count></info>"
    clock = chunk(4, struct.pack("<Idd", number, START_S, 0.0))
    tagged = struct.pack("<I", number)
    return chunk(2, tagged + header.encode()) + chunk(3, struct.pack("<IBI", number, 4, RATE_HZ) + samples) + clock + chunk(6, tagged + footer.encode())


def write(path, *streams):
    Path(path).write_bytes(b"XDF:" + chunk(1, b"<info><version>1.0</version></info>") + b"".join(stream(number, *of) for number, of in enumerate(streams, 1)))


Path("takes").mkdir()
write("takes/first.xdf", ("wristband", "EMG", 11), ("wristband", "EMG", 12), ("plate", "Force", 700))
write("takes/second.xdf", ("wristband", "EMG", 21), ("wristband", "EMG", 22))
assert len(pyxdf.load_xdf("takes/first.xdf")[0]) == 3
real_glob = glob.glob
glob.glob = lambda pattern: sorted(real_glob(pattern))  # otherwise takes come in the order of the file system
parse_xdf("takes")
tables = {}
for path in sorted(Path("takes").glob("*/*_allExp.csv")):
    values = {float(row.split(",")[1]) for row in path.read_text().splitlines()[1:]}
    tables[path.parent.name.split("_")[0], path.name.removesuffix("_allExp.csv")] = values
rates = {line.split(",")[1].strip() for path in Path("takes").glob("*/*_Report.csv") for line in path.read_text().splitlines() if line.startswith("Effective")}
for (take, name), values in tables.items():
    print(f"{take}: {name} has {values}")
print("rates:", rates)
assert set(tables) == {(take, name) for take in ("first", "second") for name in ("wristband - EMG", "plate - Force")}
assert (tables["first", "wristband - EMG"], tables["second", "wristband - EMG"]) == ({12.0}, {22.0})
assert tables["second", "plate - Force"] == {700.0} and all(np.isclose(float(rate), 1001, atol=0.01) for rate in rates)
PYTHON
venv/bin/python -W error tables.py > said.txt 2>&1 || { tail -8 said.txt; exit 1; }
if grep -i 'warn\|error' said.txt; then exit 1; fi
grep -v '^$' said.txt
