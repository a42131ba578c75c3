#!/usr/bin/env bash
# How exact are the times that pykitti reads from a raw drive of KITTI, whose files have nanoseconds?
# Guess: to the microsecond of a datetime, rounded or cut. Seen with pykitti 0.3.1 on 2026-11-28: cut to microseconds, by leaving out the
# last four characters of a line, the line end among them. If the file's last line has no end, as editors and exporters may leave it,
# a digit more is lost of that stamp: .223456789 is read as .223450, 7 microseconds early, and only there.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pykitti==0.3.1 numpy==2.4.6 opencv-python-headless==4.14.0.94
cd "$folder"
venv/bin/python - <<'PYTHON'
from pathlib import Path

import pykitti

day = Path("2011_09_26")
data = day / "2011_09_26_drive_0001_sync" / "oxts" / "data"
data.mkdir(parents=True)
for name in ("calib_imu_to_velo.txt", "calib_velo_to_cam.txt"):
    (day / name).write_text("R: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n")
lines = [f"P_rect_0{n}: 1 0 0 0 0 1 0 0 0 0 1 0\nR_rect_0{n}: 1 0 0 0 1 0 0 0 1\n" for n in range(4)]
(day / "calib_cam_to_cam.txt").write_text("".join(lines))
for number in range(2):
    (data / f"{number:010d}.txt").write_text(" ".join(["49.0", "8.0", "100.0", *["0"] * 22, *["1"] * 5]))
seen = []
for end in ("\n", ""):
    stamps = "2011-09-26 13:02:25.123456789\n2011-09-26 13:02:25.223456789" + end
    (data.parent / "timestamps.txt").write_text(stamps)
    seen.append([stamp.microsecond for stamp in pykitti.raw(".", day.name, "0001").timestamps])
    print("with" if end else "without", "a last line end:", seen[-1])
raise SystemExit(0 if seen == [[123456, 223456], [123456, 223450]] else "no longer so")
PYTHON
