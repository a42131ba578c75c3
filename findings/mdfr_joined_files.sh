#!/usr/bin/env bash
# Two loggers of a vehicle write files (MDF 4): one a channel once a second, the other one, which begins 2 s later, another channel ten times a second; a minute later, each goes on in its next
# file. They are joined with mdfr: `merge`, "channel-axis join on shared time axis", `concat_mdf`, "appends other's data after self on the time axis". And a file has samples that
# its logger marked as invalid. Guess: a time axis for each of the two channels, 2.0 to 2.4 s for the second; the next file after 60 s; no invalid samples, or nulls.
# Seen with mdfr 0.7.3 (and asammdf 8.8.28, which writes, and does what was guessed) on 2026-11-30, without a word:
# - `merge`: both channels have the first one's axis, as both are called "time": half a second of measurements lasts 0 to 4 s, also in the file that it writes. If the
#   second has more samples than the first, they are on an axis with fewer times
# - `concat_mdf`: the next file begins one step after the last sample, so a minute of pause is a second; its dates are wrong by that
# - invalid samples are like all others, as arrays, in Polars and in the CSV
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mdfr==0.7.3 asammdf==8.8.28 numpy==2.4.6 pandas==3.1.1 pyarrow==26.0.1 polars==2.1.0 2>/dev/null
cat > join.py <<'PYTHON'
from datetime import UTC, datetime, timedelta
from pathlib import Path

import mdfr
import numpy as np
from asammdf import MDF, Signal

BEGIN = datetime(2026, 1, 15, 12, tzinfo=UTC)


def log(name, begins_s, channel, times_s, **others):
    with MDF(version="4.10") as written:
        written.header.start_time = BEGIN + timedelta(seconds=begins_s)
        written.append([Signal(np.arange(len(times_s)), times_s, name=channel, **others)])
        written.save(name)


def opened(name):
    file = mdfr.Mdfr(name)
    file.load_all_channels_data_in_memory()
    return file


seconds = np.arange(5.0)
log("slow.mf4", 0, "temperature", seconds)
log("fast.mf4", 2, "speed", np.arange(5) / 10)
log("long.mf4", 2, "speed", np.arange(10) / 10)
log("next.mf4", 60, "temperature", seconds)
log("marked.mf4", 0, "angle", seconds, invalidation_bits=np.array([False, False, True, True, False]))

merged = opened("slow.mf4")
merged.merge(opened("fast.mf4"))
merged.write("merged.mf4", mdfr.CompressionAlgorithm.NoCompression)
times_s = MDF("merged.mf4").get("speed", group=0).timestamps
print("merged: speed at", merged.get_channel_master_data("speed"), "in the file at", times_s)
assert np.array_equal(merged.get_channel_master_data("speed"), seconds) and np.array_equal(times_s, seconds)
stacked_s = MDF.stack(["slow.mf4", "fast.mf4"], sync=True).get("speed").timestamps
print("stacked with asammdf: speed at", stacked_s.round(1))
assert np.allclose(stacked_s, 2 + np.arange(5) / 10)

longer = opened("slow.mf4")
longer.merge(opened("long.mf4"))
print("merged with a longer one:", len(longer.get_channel_data("speed")), "samples,", len(longer.get_channel_master_data("speed")), "times")
assert (len(longer.get_channel_data("speed")), len(longer.get_channel_master_data("speed"))) == (10, 5)

joined = opened("slow.mf4")
joined.concat_mdf(opened("next.mf4"))
sixth = joined.get_master_channel_datetimes("temperature")[5].as_py()
print("joined:", joined.get_channel_master_data("temperature"), "s; the next file begins at", sixth)
assert np.array_equal(joined.get_channel_master_data("temperature"), np.arange(10)) and sixth == BEGIN + timedelta(seconds=5)
assert MDF.concatenate(["slow.mf4", "next.mf4"]).get("temperature").timestamps[5] == 60

marked = opened("marked.mf4")
marked.export_to_csv("marked")
rows = Path("marked_time.csv").read_text().split()[1:]
print("marked:", marked.get_channel_data("angle"), "as CSV", rows, "and with asammdf", MDF("marked.mf4").get("angle").samples)
assert marked.get_channel_data("angle").tolist() == [0, 1, 2, 3, 4] and marked.get_polars_series("angle").null_count() == 0 and rows[2] == "2.0,2"
assert MDF("marked.mf4").get("angle").samples.tolist() == [0, 1, 4]
PYTHON
venv/bin/python join.py > said.txt 2>&1 || { tail -8 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
