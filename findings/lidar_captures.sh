#!/usr/bin/env bash
# The packets of a lidar are captured as pcap with `tcpdump -i any`, or as pcapng by dumpcap on two ports at once, of which the lidar's has stamps
# in nanoseconds and the other in microseconds. Who finds the lidar's packets, and when?
# Guess: a reader of captures knows what kind of link it was, and the resolution of each port, as both are in the file; or it refuses.
# Seen with velodyne-decoder 3.1.0, dpkt 1.9.8, scapy 2.8.0 and python-pcapng 2.1.1 on 2026-11-29:
# - velodyne-decoder: of a capture of `any` ("Linux cooked") there are no revolutions at all, without a word: it takes all for Ethernet, and
#   passes over what does not fit. Of the same packets as Ethernet there are three.
# - velodyne-decoder: pcapng is "Data is from a HDL-64E", whatever lidar it was and although the model is given
# - dpkt.pcapng: all ports have the resolution of the first, so that the lidar's packets are in the year 55840, without a word
# - python-pcapng: times are floats, 211 ns off; scapy has them to the nanosecond
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check velodyne-decoder==3.1.0 dpkt==1.9.8 scapy==2.8.0 python-pcapng==2.1.1
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import struct
from decimal import Decimal

import dpkt
import velodyne_decoder as velodyne
from pcapng import FileScanner
from scapy.all import IP, UDP, CookedLinux, Ether, rdpcap

START_NS, FIRING_US = 1_700_000_000_123_456_789, 55.296  # of a VLP-16


def packets():
    """Yield times and payloads of two revolutions and a bit, all returns at 10 m."""
    for number in range(160):
        us = int(number * 24 * FIRING_US)
        blocks = (
            struct.pack("<HH", 0xEEFF, (number * 12 + block) * 40 % 36000) + struct.pack("<HB", 5000, 100) * 32
            for block in range(12)
        )
        datagram = IP(src="192.168.1.201") / UDP(sport=2368, dport=2368) / (b"".join(blocks) + struct.pack("<IBB", us, 0x37, 0x22))
        yield START_NS + us * 1000, datagram


def pcapng_block(kind, body):
    return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)


for name, link, layer in (("ethernet.pcap", 1, Ether(dst="ff:ff:ff:ff:ff:ff")), ("any.pcap", 113, CookedLinux(proto=0x800))):
    with open(name, "wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, link))
        for time_ns, datagram in packets():
            data = bytes(layer / datagram)
            file.write(struct.pack("<IIII", time_ns // 10**9, time_ns % 10**9, len(data), len(data)) + data)
with open("two.pcapng", "wb") as file:
    file.write(pcapng_block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)))
    for resolution in (6, 9):  # powers of ten, of one port each
        file.write(pcapng_block(1, struct.pack("<HHIHHB3xHH", 1, 0, 0, 9, 1, resolution, 0, 0)))
    for time_ns, datagram in packets():
        data = bytes(Ether(dst="ff:ff:ff:ff:ff:ff") / datagram)
        head = struct.pack("<IIIII", 1, time_ns >> 32, time_ns & 0xFFFFFFFF, len(data), len(data))
        file.write(pcapng_block(6, head + data + bytes(-len(data) % 4)))

config = velodyne.Config(model=velodyne.Model.VLP16)
found = {name: len(list(velodyne.read_pcap(name, config))) for name in ("ethernet.pcap", "any.pcap")}
try:
    error = f"{len(list(velodyne.read_pcap('two.pcapng', config)))} revolutions"
except ValueError as exc:
    error = str(exc)
with open("two.pcapng", "rb") as file:
    by_dpkt, _ = next(iter(dpkt.pcapng.Reader(file)))
with open("two.pcapng", "rb") as file:
    by_pcapng = next(block.timestamp for block in FileScanner(file) if hasattr(block, "timestamp"))
by_scapy = rdpcap("two.pcapng", count=1)[0].time
print(f"velodyne-decoder: {found}, pcapng: {error}")
print(f"dpkt {by_dpkt!r}, python-pcapng {by_pcapng!r}, scapy {by_scapy}")
assert found == {"ethernet.pcap": 3, "any.pcap": 0}
assert error.startswith("Data is from a HDL-64E")
assert by_dpkt // 1000 == 1_700_000_000 and Decimal(by_scapy) == Decimal("1700000000.123456789")
assert by_pcapng != by_scapy and abs(by_pcapng - 1_700_000_000.123456789) < 1e-6
PYTHON
