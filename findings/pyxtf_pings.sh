#!/usr/bin/env bash
# A boat at 2 m/s records .xtf: fixes at 10 Hz (`XTFPosRawNavigation`), side scan with weights, and a sub-bottom profiler whose range is switched from 40
# to 41 m. What are speeds, and echoes in the picture that `concatenate_channel` makes? Guess: 2 m/s, and echoes times 2^-weight, as its docstring says.
# Seen with pyxtf 1.5.0 on 2026-11-30, without a word: 200 m/s, and 0.2 m/s once in a second, as the format counts tenths of milliseconds (0 to 9999) where
# pyxtf counts microseconds: every fix of a second is within its first 9 ms. `weighted` cuts echoes to whole numbers (20 of weight 5 is 0, not 0.625) and
# takes what exceeds 65535 modulo 65536 (30000 of weight -2 is 54464). Of a profiler's pings of several lengths, all of the longest are zero: whatever was
# recorded after the switch. Samples are read in the type of the first channel of a file, whichever they are of: a profiler's of float32 beside side scan of
# 16 bits are as many halves of numbers, of half of the depth. The picture's first row is the last ping, so against the list that it has sorted. Side scan of
# several lengths, without `weighted`, and the times of pings are well
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pyxtf==1.5.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
import pyxtf

PORT, STARBOARD, PROFILER = (kind.value for kind in (pyxtf.XTFChannelType.port, pyxtf.XTFChannelType.stbd, pyxtf.XTFChannelType.subbottom))


def record(*packets, profiler=np.uint16):
    """Write the packets as an .xtf of three channels, and return its header and its packets by kind, as pyxtf reads them."""
    header = pyxtf.XTFFileHeader()
    header.NumberOfSonarChannels = 3
    for at, (kind, samples) in enumerate(((PORT, np.uint16), (STARBOARD, np.uint16), (PROFILER, profiler))):
        header.ChanInfo[at].TypeOfChannel, header.ChanInfo[at].SubChannelNumber, header.ChanInfo[at].BytesPerSample = kind, at, samples().itemsize
        header.ChanInfo[at].SampleFormat = 5 if samples is np.float32 else 0
    written = bytes(header)
    for packet in packets:
        size = len(packet.to_bytes())
        packet.NumBytesThisRecord = -(-size // 64) * 64
        written += packet.to_bytes() + bytes(packet.NumBytesThisRecord - size)
    with open("boat.xtf", "wb") as file:
        file.write(written)
    return pyxtf.xtf_read("boat.xtf")


def at(packet, number, hertz):
    """Stamp the packet as that of a number, and return the tenths of milliseconds of its second."""
    seconds, rest = divmod(number * 10_000 // hertz, 10_000)
    packet.Year, packet.Month, packet.Day, packet.Hour, packet.Minute, packet.Second = 2026, 6, 1, 12, 0, seconds
    return rest


def ping(number, weight, *echoes, first=0):
    """Return a ping of one or two channels, beginning with that number."""
    made = pyxtf.XTFPingHeader()
    made.HSeconds = at(made, number, 5) // 100
    made.PingNumber, made.NumChansToFollow, made.ping_chan_headers, made.data = number, len(echoes), [], list(echoes)
    for channel, samples in enumerate(echoes, first):
        head = pyxtf.XTFPingChanHeader()
        head.ChannelNumber, head.NumSamples, head.Weight = channel, len(samples), weight
        made.ping_chan_headers.append(head)
    return made


fixes = []
for number in range(40):
    fix = pyxtf.XTFPosRawNavigation()
    fix.Microsecond = at(fix, number, 10)
    fix.RawXcoordinate, fix.RawYcoordinate = 500_000 + 2 * number / 10, 6_600_000
    fix.NumBytesThisRecord = 64
    fixes.append(fix)
read = record(*fixes)[1][pyxtf.XTFHeaderType.pos_raw_navigation]
east = np.array([fix.RawXcoordinate for fix in read])
times = np.array([fix.get_time() for fix in read]).astype("datetime64[us]")
speeds = np.diff(east) / (np.diff(times) / np.timedelta64(1, "s"))
print(f"fixes at 10 Hz, 2 m/s: the first are {', '.join(str(time)[17:] for time in times[:12])}; speeds {np.unique(speeds.round(3))} m/s")
assert np.allclose(np.unique(speeds.round(3)), [0.202, 200])

flat = [np.full(8, level, np.uint16) for level in (40, 20, 2000, 30000)]
weights = [5, 5, 5, -2]
header, packets = record(*(ping(number, weight, level, level) for number, (weight, level) in enumerate(zip(weights, flat))))
pings = packets[pyxtf.XTFHeaderType.sonar]
picture = pyxtf.concatenate_channel(pings, header, 0, weighted=True)[:, 0]
true = [float(level[0]) * 2.0**-weight for weight, level in zip(weights, flat)]
print(f"weighted: {true} are {picture[::-1]}, the last row first; the list of pings begins with {pings[0].PingNumber}")
assert list(picture[::-1]) == [1, 0, 62, 54464] and [one.PingNumber for one in pings] == [0, 1, 2, 3]

lengths = [800] * 10 + [820] * 10
for first, channels, name in ((0, 2, "side scan"), (2, 1, "sub-bottom profiler")):
    header, packets = record(*(ping(number, 0, *[np.full(length, 1000, np.uint16)] * channels, first=first) for number, length in enumerate(lengths)))
    picture = pyxtf.concatenate_channel(packets[pyxtf.XTFHeaderType.sonar], header, 0)[::-1]
    short, long = (np.unique((half > 0).sum(1)) for half in (picture[:10], picture[10:]))
    print(f"{name}: pings of {lengths[0]} samples have {short} echoes, those of {lengths[-1]} {long}")
    assert (picture[:10] == 1000).sum() == 8000 and (picture[10:] == 1000).sum() == (0 if first else 8200)

depth = np.linspace(0.1, 0.9, 800, dtype=np.float32)
header, packets = record(*(ping(number, 0, depth, first=2) for number in range(5)), profiler=np.float32)
read = packets[pyxtf.XTFHeaderType.sonar][0].data[0]
print(f"profiler of float32: {depth[:4].round(3)} are {read[:4]}, {len(read)} of {read.dtype}")
assert np.array_equal(read, depth.view(np.uint16)[:800])
PYTHON
