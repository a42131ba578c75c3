#!/usr/bin/env bash
# An arm of Dynamixel motors (as of ALOHA, GELLO and many others) is recorded with the maker's library. A motor is at -100 ticks, turns back at -5, with a current of -20;
# all three are signed, by two's complement. And one of three motors does not answer, as its plug is loose. What is read?
# Guess: -100, -5, -20; and an error for that motor, while the others are read. Seen with dynamixel-sdk 4.1.0 on 2026-11-29, with motors that this script plays on a
# pseudo-terminal:
# - 4294967196, 4294967291 and 65516, without a word, by `read4ByteTxRx`, `read2ByteTxRx` and by `getData` of `GroupSyncRead`: no function of it is signed
# - if one is missing, `txRxPacket` returns -3001, and `getData` is 0 for ALL motors, also for those that answered: for a script that does not look at the result
#   the whole arm is at 0
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dynamixel-sdk==4.1.0
"$folder/venv/bin/python" - <<'PYTHON'
import os
import pty
import struct
import threading
import tty

from dynamixel_sdk import GroupSyncRead, PacketHandler, PortHandler

CURRENT, VELOCITY, POSITION = 126, 128, 132
TABLE = struct.pack("<hii", -20, -5, -100)  # from CURRENT on
SYNC_READ, MISSING = 0x82, 2


def crc(packet):
    """Return the check sum of protocol 2."""
    rest = 0
    for byte in packet:
        rest ^= byte << 8
        for _ in range(8):
            rest = (rest << 1 ^ (0x8005 if rest & 0x8000 else 0)) & 0xFFFF
    return rest


def motors(line):
    """Answer what is read of the motors."""
    received = b""
    while received := received + os.read(line, 256):
        while len(received) >= 7 and len(received) >= (length := 7 + struct.unpack_from("<H", received, 5)[0]):
            packet, received = received[:length], received[length:]
            start, size = struct.unpack_from("<HH", packet, 8)
            for number in packet[12:-2] if packet[7] == SYNC_READ else packet[4:5]:
                if number != MISSING:
                    answer = b"\xff\xff\xfd\0" + struct.pack("<BHBB", number, 4 + size, 0x55, 0) + TABLE[start - CURRENT :][:size]
                    os.write(line, answer + struct.pack("<H", crc(answer)))


line, terminal = pty.openpty()
tty.setraw(terminal)
threading.Thread(target=motors, args=(line,), daemon=True).start()
port, protocol = PortHandler(os.ttyname(terminal)), PacketHandler(2.0)
assert port.openPort() and port.setBaudRate(57600)
single = protocol.read4ByteTxRx(port, 1, POSITION), protocol.read4ByteTxRx(port, 1, VELOCITY), protocol.read2ByteTxRx(port, 1, CURRENT)
print("position, velocity, current:", single)
assert single == ((4294967196, 0, 0), (4294967291, 0, 0), (65516, 0, 0))
for numbers, result, positions in (([1, 3], 0, [4294967196] * 2), ([1, MISSING, 3], -3001, [0] * 3)):
    group = GroupSyncRead(port, protocol, CURRENT, len(TABLE))
    for number in numbers:
        group.addParam(number)
    got = group.txRxPacket(), [group.getData(number, POSITION, 4) for number in numbers]
    print("motors", numbers, "together:", got)
    assert got == (result, positions)
PYTHON
