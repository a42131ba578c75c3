#!/usr/bin/env bash
# A wristband (EMG, 1000 Hz) and a hand tracker (100 Hz) are recorded with Lab Streaming Layer (XDF), by one clock. The tracker is switched on 2.5 s after the wristband. Ten seconds in, a finger bends,
# and the muscle is tense at that moment. Where are the two in the table that biosigio makes, `sync_streams=True` ("synchronize streams to common timestamps")? Guess: in the same row, at 10 s.
# Seen with biosigio 1.2.13 and emgio 0.6.0 (as it was called before), with pyxdf 1.17.5, on 2026-11-30, without a word:
# - the muscle at 10.0 s, the finger at 7.5 s: each stream's time begins with its own first sample. Over the last 2.5 s, where it then has none, its last value stands. `sync_streams=False`: the same
# - `sample_frequency` of the finger is 100 Hz, and it has a value for each ms: whoever counts samples by it has a take ten times as long. It is not told that they are interpolated
# - with pyxdf's own stamps both are at 10.0 s
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check biosigio==1.2.13 emgio==0.6.0 pyxdf==1.17.5 numpy==2.4.6 pandas==2.3.3 2>/dev/null
cat > take.py <<'PYTHON'
import struct
from pathlib import Path

import biosigio
import emgio
import numpy as np
import pyxdf

START_S, END_S, BENT_S, LATE_S = 100.0, 20.0, 10.0, 2.5


def chunk(tag, body):
    return b"\x04" + struct.pack("<IH", len(body) + 2, tag) + body


def stream(number, name, kind, rate_hz, first_s):
    """Return the chunks of a stream, whose value is 1 from the bend on."""
    times_s = np.arange(round(first_s * rate_hz), round(END_S * rate_hz)) / rate_hz
    header = (
        f"<info><name>{name}</name><type>{kind}</type><channel_count>1</channel_count><nominal_srate>{rate_hz}</nominal_srate>"
        f"<channel_format>double64</channel_format><created_at>0</created_at><desc><channels><channel><label>{name}</label></channel></channels></desc></info>"
    )
    samples = b"".join(struct.pack("<Bdd", 8, START_S + time_s, time_s >= BENT_S) for time_s in times_s)
    clock = b"".join(chunk(4, struct.pack("<Idd", number, START_S + second, 0.0)) for second in range(0, 21, 5))
    footer = f"<info><first_timestamp>{START_S + times_s[0]}</first_timestamp><last_timestamp>{START_S + times_s[-1]}</last_timestamp><sample_count>{len(times_s)}</sample_count></info>"
    parts = chunk(2, struct.pack("<I", number) + header.encode()), chunk(3, struct.pack("<IBI", number, 4, len(times_s)) + samples) + clock
    return *parts, chunk(6, struct.pack("<I", number) + footer.encode())


parts = zip(stream(1, "wristband", "EMG", 1000, 0), stream(2, "finger", "MoCap", 100, LATE_S))
Path("take.xdf").write_bytes(b"XDF:" + chunk(1, b"<info><version>1.0</version></info>") + b"".join(b"".join(part) for part in parts))

own = {}
for read in pyxdf.load_xdf("take.xdf")[0]:
    own[read["info"]["name"][0]] = float(read["time_stamps"][np.argmax(read["time_series"][:, 0])] - START_S)
print("bent by pyxdf, s:", own)
assert np.allclose(list(own.values()), BENT_S, atol=0.01)
for package in (biosigio, emgio):
    for sync in (True, False):
        recording = package.Recording.from_file("take.xdf", importer="xdf", sync_streams=sync)
        table = recording.signals
        bent = {name: float(table.index[np.argmax(table[name].to_numpy() >= 1)]) for name in own}
        rates = {name: round(recording.channels[name]["sample_frequency"]) for name in own}
        print(f"{package.__name__}, sync_streams={sync}: bent at {bent}, rates {rates}, {len(table)} rows, step {1000 * np.diff(table.index).mean():.2f} ms")
        assert np.allclose([bent["wristband"], bent["finger"]], [BENT_S, BENT_S - LATE_S], atol=0.01)
        assert rates == {"wristband": 1000, "finger": 100} and len(table) == 1000 * END_S and table["finger"].notna().all()
PYTHON
venv/bin/python -W error take.py > said.txt 2>&1 || { tail -8 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
