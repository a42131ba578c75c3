"""Packets of an Ouster that tests write, byte by byte after its manual: four beams, 64 columns a turn, 16 in each packet."""

import json
import struct
from dataclasses import dataclass

import numpy as np

from bagassets_tests.sweep_data import raw

PACKETS = "ouster_sensor_msgs/msg/PacketMsg"
COLUMNS, PER_PACKET, TURN_NS = 64, 16, 100_000_000
COLUMN_NS = TURN_NS // COLUMNS
ALTITUDES, AZIMUTHS = [30.0, 10.0, -10.0, -30.0], [3.0, 1.0, -1.0, -3.0]
ORIGIN_MM = 20.0
RANGE_MM = 10_000
OS_NS = 1_234_000_000_000  # since the lidar was switched on


@dataclass
class PacketMsg:
    buf: np.ndarray


def metadata(**fields):
    """Metadata as firmware 2.1 has it, with other `fields` of the format."""
    form = {
        "columns_per_frame": COLUMNS, "columns_per_packet": PER_PACKET, "pixels_per_column": 4,
        "column_window": [0, COLUMNS - 1], "udp_profile_lidar": "RNG19_RFL8_SIG16_NIR16",
    }  # fmt: skip
    return json.dumps(
        {
            "lidar_mode": "64x10",
            "beam_altitude_angles": ALTITUDES,
            "beam_azimuth_angles": AZIMUTHS,
            "lidar_origin_to_beam_origin_mm": ORIGIN_MM,
            "data_format": {**form, **fields},
        }
    ).encode()


def packet(
    first, *, first_frame=7, window=(0, COLUMNS - 1), start_ns=OS_NS, range_mm=RANGE_MM, column_ns=COLUMN_NS
):
    """The packet whose first column is `first`, counted over all turns."""
    frame = (first_frame + first // COLUMNS) % 65_536
    parts = [struct.pack("<HH28x", 1, frame)]
    for column in range(first, first + PER_PACKET):
        number = column % COLUMNS
        inside = (number - window[0]) % COLUMNS <= (window[1] - window[0]) % COLUMNS
        parts.append(struct.pack("<QHH", start_ns + column * column_ns, number, inside))
        parts += [struct.pack("<IBxHHxx", range_mm, 40 + beam, 500, 90) for beam in range(4)]
    return b"".join([*parts, bytes(32)])


def messages(turns, *, begin=0, logged_ns, window=(0, COLUMNS - 1), **options):
    """The packets of so many turns; each was logged when its last column had been measured, `logged_ns` after it began at 0."""
    for first in range(begin, begin + round(turns * COLUMNS), PER_PACKET):
        numbers = [column % COLUMNS for column in range(first, first + PER_PACKET)]
        if any((number - window[0]) % COLUMNS <= (window[1] - window[0]) % COLUMNS for number in numbers):
            yield message(packet(first, window=window, **options), first, logged_ns)


def message(data, first, logged_ns):
    log_time_ns = logged_ns + (first + PER_PACKET - 1) * COLUMN_NS
    return raw(PacketMsg(np.frombuffer(data, np.uint8)), PACKETS, log_time_ns)


def seen(column, beam, range_mm=RANGE_MM):
    """Where a beam of the lidar hits, in its frame, metres: the encoder turns the beam's origin and the beam with it."""
    encoder = np.radians(-360.0 * (column % COLUMNS) / COLUMNS)
    azimuth, altitude = np.radians(-AZIMUTHS[beam]), np.radians(ALTITUDES[beam])
    along = np.array(
        [np.cos(azimuth) * np.cos(altitude), np.sin(azimuth) * np.cos(altitude), np.sin(altitude)]
    )
    turn = np.array(
        [[np.cos(encoder), -np.sin(encoder), 0], [np.sin(encoder), np.cos(encoder), 0], [0, 0, 1]]
    )
    return turn @ (np.array([ORIGIN_MM, 0, 0]) + (range_mm - ORIGIN_MM) * along) / 1000
