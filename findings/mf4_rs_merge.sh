#!/usr/bin/env bash
# A logger writes a file (MDF 4) for each 10 s of a drive, with the time of its begin in its head and times from 0 on; a minute later it writes another. They
# are joined with mf4-rs (`merge_files`), and with asammdf (`MDF.concatenate`). When is the first sample of the second file, after the first of the first?
# Guess: after 60 s, in both. Seen with mf4-rs 3.7.0 and asammdf 8.8.28 on 2026-11-30, without a word: asammdf, after 60 s. mf4-rs: after 0 s. Its file has
# the begin of the first, and the times as they were, 0 to 9.99 s twice: the time goes back by 10 s in the middle, sorting mixes both drives, and a cut of
# seconds 2 to 4 (`cut_mdf_by_time`) has those of both
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mf4-rs==3.7.0 asammdf==8.8.28 numpy==2.4.6 pandas==3.1.1
cat > join.py <<'PYTHON'
from datetime import UTC, datetime, timedelta

import mf4_rs
import numpy as np
from asammdf import MDF, Signal

BEGIN = datetime(2026, 1, 15, 12, tzinfo=UTC)
for number in range(2):
    with MDF(version="4.10") as drive:
        drive.header.start_time = BEGIN + timedelta(minutes=number)
        drive.append([Signal(np.full(1000, number, np.uint16), np.arange(1000) / 100, name="part")])
        drive.save(f"part_{number}.mf4", compression=0)
mf4_rs.merge_files("merged.mf4", "part_0.mf4", "part_1.mf4")
mf4_rs.cut_mdf_by_time("merged.mf4", "cut.mf4", 2.0, 3.99)
for name, second_s, opened in (("mf4-rs", 0.0, MDF("merged.mf4")), ("asammdf", 60.0, MDF.concatenate(["part_0.mf4", "part_1.mf4"]))):
    part = opened.get("part")
    first_s, begin_s = part.timestamps[0], part.timestamps[part.samples == 1][0]
    print(f"{name}: {len(part.samples)} samples from {opened.start_time} on; the second part begins after {begin_s - first_s:.2f} s")
    assert (len(part.samples), opened.start_time) == (2000, BEGIN)
    assert np.isclose(begin_s - first_s, second_s, atol=0.011)
cut = MDF("cut.mf4").get("part")
print(f"cut: {(cut.samples == 0).sum()} samples of the first part and {(cut.samples == 1).sum()} of the second")
assert [(cut.samples == number).sum() for number in range(2)] == [200, 200]
PYTHON
venv/bin/python join.py
