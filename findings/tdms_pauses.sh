#!/usr/bin/env bash
# A test rig writes the force of an actuator to a TDMS file of LabVIEW, as a waveform: ten samples from 10:00:00 on, 0.1 s apart. It pauses, and a minute later
# ten more are appended to the same channel, with their own start. When was the first block measured, by npTDMS?
# Guess: at 10:00:00, and the second one a minute later; or at 10:00:00 and directly behind it, as a channel has one start.
# Seen with nptdms 1.13.0 on 2026-11-29, without a word: at 10:01:00, a minute late, and the second block at 10:01:01, a second late. Properties of a channel are
# those of its LAST segment, as the format has it, and `time_track` (and `as_dataframe(time_index=True)`) lays all samples in a row from that start on.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check npTDMS==1.13.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from nptdms import ChannelObject, TdmsFile, TdmsWriter

START = np.datetime64("2026-11-29T10:00:00", "us")

for number, mode in enumerate("wa"):
    properties = {"wf_start_time": START + np.timedelta64(60 * number, "s"), "wf_increment": 0.1, "wf_start_offset": 0.0}
    with TdmsWriter("rig.tdms", mode=mode) as writer:
        writer.write_segment([ChannelObject("rig", "force", 100.0 * number + np.arange(10), properties=properties)])

channel = TdmsFile.read("rig.tdms")["rig"]["force"]
late_s = (channel.time_track(absolute_time=True) - START) / np.timedelta64(1, "s")
for number in (0, 9, 10, 19):
    print(f"{channel[number]:g} N: {late_s[number]:g} s after 10:00:00")
assert channel[:].tolist() == [*range(10), *range(100, 110)]
assert np.allclose(late_s, 60 + np.arange(20) / 10)
PYTHON
