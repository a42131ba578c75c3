#!/usr/bin/env bash
# A drone of DJI starts on a hill at 10:00:00.000 on its clock, in Munich in summer, at 520 m, and sinks by a metre each half second. Beside the video lies an
# SRT file with a block for each frame, whose heights are in one pair of brackets, as DJI writes them: [rel_alt: 2.000 abs_alt: 522.000]. Three packages
# make a track (GPX) of it. Guess: 522 m to 517 m, from 8:00 UTC on. Seen with dji-telemetry 1.0.1, djiutil 1.0.3 and dji-drone-metadata-embedder 2.18.0 on
# 2026-11-29: dji-telemetry has a height of 0 everywhere, and 0, too, below the start, where it no longer sinks, as it reads no minus; its time is the
# drone's, called UTC, two hours late. djiutil takes the height above the start for that of the track; its UTC is right where the computer that runs it is
# set to the drone's time zone. Only the third has the heights; like djiutil, it cuts the fractions of seconds off, so that points share a time.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dji-telemetry==1.0.1 djiutil==1.0.3 dji-drone-metadata-embedder==2.18.0
cd "$folder"
cat > flight.py <<'PYTHON'
from pathlib import Path

blocks = []
for n in range(6):
    begin, end = (f"00:00:{ms // 1000:02d},{ms % 1000:03d}" for ms in (500 * n, 500 * n + 500))
    blocks.append(
        f'{n + 1}\n{begin} --> {end}\n<font size="28">FrameCnt: {n + 1}, DiffTime: 500ms\n'
        f"2026-06-29 10:00:0{n // 2}.{500 * (n % 2):03d}\n[iso: 100] [shutter: 1/1000.0] [fnum: 2.8] [ev: 0] [color_md: default] [focal_len: 24.00] "
        f"[latitude: 48.123456] [longitude: 11.567890] [rel_alt: {2.0 - n:.3f} abs_alt: {522.0 - n:.3f}] [ct: 5500] </font>\n"
    )
Path("flight.srt").write_text("\n".join(blocks))
PYTHON
venv/bin/python flight.py
venv/bin/dji-embed convert gpx flight.srt -o embedder.gpx --tz-offset +02:00 >log 2>&1
TZ=Europe/Berlin venv/bin/python - <<'PYTHON'
import re
from pathlib import Path

from dji_telemetry import parse_srt
from dji_telemetry.exporter import to_gpx
from djiutil.convert import convert_srt_to_gpx

flight = parse_srt("flight.srt", smooth_speeds=False)
to_gpx(flight, "telemetry.gpx")
convert_srt_to_gpx("flight.srt", "djiutil.gpx")
heights_m, times = {}, {}
for name in ("telemetry", "djiutil", "embedder"):
    points = Path(f"{name}.gpx").read_text().split("<trkseg>")[1]
    heights_m[name] = [float(value) for value in re.findall("<ele>(.*?)</ele>", points)]
    times[name] = re.findall("<time>.*?T?(10:|08:)(.*?)Z?</time>", points)
    print(f"{name}: heights {heights_m[name]}, times {[hour + rest for hour, rest in times[name]]}")
print("above the start, by dji-telemetry:", [frame.rel_alt for frame in flight.frames], "sinking:", [frame.v_speed for frame in flight.frames])
assert heights_m["embedder"] == [522.0, 521.0, 520.0, 519.0, 518.0, 517.0]
assert heights_m["telemetry"] == [0.0] * 6
assert heights_m["djiutil"] == [2.0, 1.0, 0.0, -1.0, -2.0, -3.0]
assert [frame.rel_alt for frame in flight.frames] == [2.0, 1.0, 0.0, 0.0, 0.0, 0.0]
assert [frame.v_speed for frame in flight.frames] == [0.0, -2.0, -2.0, 0.0, 0.0, 0.0]
assert {hour for hour, _ in times["telemetry"]} == {"10:"}
assert [hour + rest for hour, rest in times["djiutil"]] == ["08:00:00"] * 2 + ["08:00:01"] * 2 + ["08:00:02"] * 2
PYTHON
