#!/usr/bin/env bash
# Recordings (MCAP, ROS 2) of a minute are checked with clockdoctor, which models each topic's clock as bias, drift and jitter, and flags what is wrong. A lidar's driver stamps 25 scans a second in whole
# hundredths of a second, once alone and once beside a topic of words without a header (std_msgs/String). And in the middle of a drive NTP sets the recorder's clock by 50 ms, while the lidar's runs on.
# Guess: coarse stamps are flagged in both; a step, or two biases, but no drift.
# Seen with clockdoctor 0.1.0 on 2026-11-30, without a word:
# - alone, "coarse"; beside a topic without stamps, a resolution of a nanosecond and no flag: times of all topics are one column, which pandas turns into float64, as one of them
#   has none, and a time of today has steps of 256 ns in it
# - the step is "drifts +1249ppm … the two clocks run at different rates, not just a fixed offset", though both run alike; whoever corrects stamps by bias and drift makes them up to 25 ms worse
# - eleven messages in a second at 10 Hz have a rate of 11 Hz: messages are counted, not the steps between them
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check clockdoctor==0.1.0 mcap-ros2-support==0.6.0 mcap==1.6.0 rosbags==0.11.9 numpy==2.4.6 pandas==3.1.1 2>/dev/null
cat > clocks.py <<'PYTHON'
import contextlib
import io
import json
from pathlib import Path

from clockdoctor.analyze import analyze_jsonl
from clockdoctor.extract import extract_to_jsonl
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
START_NS, POINT, WORDS = 1_768_478_400 * 10**9, "geometry_msgs/msg/PointStamped", "std_msgs/msg/String"


def of(name, *values):
    return STORE.types[name](*values)


def point(stamp_ns):
    header = of("std_msgs/msg/Header", of("builtin_interfaces/msg/Time", stamp_ns // 10**9, stamp_ns % 10**9), "lidar")
    return of(POINT, header, of("geometry_msgs/msg/Point", 0.0, 0.0, 0.0))


def examined(name, stamps_ns, logged_ns, words=False):
    """Record this; return summary, flags and what is printed of the lidar."""
    with Writer(Path(name), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        lidar = writer.add_connection("/lidar", POINT, typestore=STORE)
        if words:
            writer.write(writer.add_connection("/words", WORDS, typestore=STORE), START_NS, STORE.serialize_cdr(of(WORDS, "ready"), WORDS))
        for stamp_ns, time_ns in zip(stamps_ns, logged_ns):
            writer.write(lidar, time_ns, STORE.serialize_cdr(point(stamp_ns), POINT))
    (path,) = Path(name).glob("*.mcap")
    _, rows = extract_to_jsonl(path)
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        results = analyze_jsonl(rows)
    found = json.loads(Path(results["timeline_json"]).read_text())
    resolutions = [line.split("resolution~")[1].split(";")[0] for line in printed.getvalue().splitlines() if "resolution~" in line]
    return found["summary"]["/lidar"], {flag["type"]: flag["message"] for flag in found["flags"] if flag["topic"] == "/lidar"}, resolutions[0]


measured_ns = [START_NS + 40_000_000 * number + 11_000_000 for number in range(25 * 60)]
received_ns = [time_ns + 5_000_000 for time_ns in measured_ns]
coarse_ns = [time_ns // 10_000_000 * 10_000_000 for time_ns in measured_ns]
for name, words in (("alone", False), ("beside words", True)):
    _, flags, resolution = examined(name, coarse_ns, received_ns, words)
    print(f"stamps in hundredths of a second, {name}: resolution {resolution}, flags {sorted(flags)}")
    assert ("coarse_resolution" in flags, resolution) == ((False, "0.0000ms") if words else (True, "10.0000ms"))

stepped_ns = [time_ns + 50_000_000 * (number >= len(received_ns) // 2) for number, time_ns in enumerate(received_ns)]
summary, flags, _ = examined("step", measured_ns, stepped_ns)
print(f"a step of 50 ms: {flags['clock_drift']}")
assert 1200 < summary["drift_ppm"] < 1300 and "run at different rates" in flags["clock_drift"]
seconds = [(time_ns - stepped_ns[0]) / 1e9 for time_ns in stepped_ns]
mean_s = sum(seconds) / len(seconds)
lags_ms = [(logged - stamp) / 1e6 for logged, stamp in zip(stepped_ns, measured_ns)]
left_ms = [lag - summary["mean_ms"] - summary["drift_ppm"] / 1000 * (second - mean_s) for lag, second in zip(lags_ms, seconds)]
print(f"left after bias and drift: {min(left_ms):.1f} to {max(left_ms):.1f} ms")
assert -26 < min(left_ms) < -20 and 20 < max(left_ms) < 26

tenths_ns = [START_NS + 100_000_000 * number for number in range(11)]
summary, _, _ = examined("second", tenths_ns, tenths_ns)
print("11 messages in a second:", summary["rate_hz"], "Hz")
assert summary["rate_hz"] == 11
PYTHON
venv/bin/python clocks.py > said.txt 2>&1 || { tail -8 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
