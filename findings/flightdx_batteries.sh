#!/usr/bin/env bash
# A drone with PX4 flies with two batteries and two receivers, whose messages have one name in its log (ULog), and numbers, 0 and 1. The first battery is drained to 3.1 V a cell,
# and the first receiver, which it flies by, loses its fix. flightdx reads the log and looks for incidents, as it says: "deterministic flight-log anomaly detection".
# Guess: signals of both, or of the first, and an incident. Seen with flightdx 0.1.0 and pyulog 1.3.0 on 2026-11-30, without a word:
# - signals and messages are those of the LAST, number 1, alone: half of what is in the log is nowhere, and a drained battery is an incident only if it is the last
# - of GNSS there is no incident in any order: what looks for them reads messages by their names in ArduPilot, and finds none in logs of PX4, whose signals it has
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check flightdx==0.1.0 pyulog==1.3.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import struct

from flightdx.engine.report_builder import analyze_log
from flightdx.parsers.ulog import parse_ulog

FORMATS = {
    "battery_status": ("uint64_t timestamp;float voltage_v;float current_a;", "<Qff"),
    "vehicle_gps_position": ("uint64_t timestamp;float hdop;uint8_t fix_type;uint8_t satellites_used;", "<QfBB"),
}
SECONDS = range(1, 31)


def message(kind, body):
    return struct.pack("<H", len(body)) + kind.encode() + body


def read(**instances):
    """Return what flightdx reads of a log of these topics; each instance has a row of values per second."""
    log = b"ULog\x01\x12\x35\x01" + bytes(8) + message("B", bytes(40))
    log += b"".join(message("F", f"{topic}:{FORMATS[topic][0]}".encode()) for topic in instances)
    numbered = [(topic, number, rows) for topic, several in instances.items() for number, rows in enumerate(several)]
    for identity, (topic, number, _) in enumerate(numbered):
        log += message("A", struct.pack("<BH", number, identity) + topic.encode())
    for second in SECONDS:
        for identity, (topic, _, rows) in enumerate(numbered):
            values = struct.pack(FORMATS[topic][1], second * 10**6, *rows[second - 1])
            log += message("D", struct.pack("<H", identity) + values)
    with open("flight.ulg", "wb") as file:
        file.write(log)
    return parse_ulog("flight.ulg")


def kinds(parsed):
    return sorted({incident.type for incident in analyze_log(parsed).incidents})


drained = [(16.8 - second * 0.145, 20.0) for second in SECONDS]
full = [(16.8, 1.0)] * len(SECONDS)
lost = [(0.8, 3, 14) if second < 10 else (9.9, 0, 0) for second in SECONDS]
fixed = [(0.8, 3, 14)] * len(SECONDS)

for batteries, found in (([drained], True), ([full, drained], True), ([drained, full], False)):
    parsed = read(battery_status=batteries)
    signal = parsed.signals["battery_voltage"].values
    print(f"{len(batteries)} batteries: {len(signal)} of {len(SECONDS) * len(batteries)} values, to {signal[-1]:.2f} V; incidents: {kinds(parsed)}")
    assert len(signal) == len(parsed.messages["battery_status"]) == len(SECONDS)
    assert any("batt" in kind for kind in kinds(parsed)) == found

for receivers in ([lost], [fixed, lost], [lost, fixed]):
    parsed = read(vehicle_gps_position=receivers)
    print(f"{len(receivers)} receivers: {parsed.signals['gps_status'].values[-1]:.0f} as the last fix; incidents: {kinds(parsed)}")
    assert not kinds(parsed)
PYTHON
