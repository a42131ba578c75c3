"""OxTS NCOM: the 72-byte packets of structure A that inertial navigation systems by OxTS send.

Layout and units from "NCOM data structures and definitions", Oxford Technical Solutions; all numbers
little-endian::

    0      0xE7
    1-2    milliseconds into the GPS minute
    3-20   accelerations and angular rates, 3 bytes each
    21     navigation status          22  sum of bytes 1-21
    23-42  latitude, longitude (double, radians), height (single, metres)
    43-51  velocity north, east, down, 3 bytes each, 0.1 mm/s
    52-60  heading, pitch, roll, 3 bytes each, microradians
                                      61  sum of bytes 1-60
    62     status channel, 63-70 its content
                                      71  sum of bytes 1-70

The vehicle's axes are x forward, y right, z down; heading counts from north, clockwise seen from above.
"""

from dataclasses import dataclass
from math import isfinite, pi
from struct import Struct

from bagassets.base.errors import DecodeError

PACKET_SIZE = 72
_LAYOUT = Struct("<BH18sBBddf9s9sBB8sB")
_SYNC = 0xE7

# Navigation status: 3 and 4 are solutions in real time, the first still converging; 2 has but a guess.
# Others carry raw measurements, the time of a trigger, or status only.
_INITIALISING = 2
_SOLVED = (3, 4)
_HAS_TIME = (2, 3, 4)

_INVALID = -(1 << 23)
_TIME_CHANNEL, _OFFSET_CHANNEL = 0, 16


@dataclass(frozen=True, slots=True)
class NcomPose:
    """Where the system is.

    Attributes:
        lat_deg: WGS84 latitude.
        lon_deg: WGS84 longitude.
        alt_m: height above the ellipsoid.
        heading_rad: of the vehicle's x axis from true north, clockwise.
        pitch_rad: nose up is positive.
        roll_rad: right side down is positive.
    """

    lat_deg: float
    lon_deg: float
    alt_m: float
    heading_rad: float
    pitch_rad: float
    roll_rad: float

    @property
    def enu_rpy_rad(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw of axes forward, left, up in east, north, up (REP 103)."""
        return self.roll_rad, -self.pitch_rad, pi / 2 - self.heading_rad


@dataclass(frozen=True, slots=True)
class NcomReading:
    """One packet.

    Attributes:
        minute_ms: milliseconds into the GPS minute; None if the packet has no time of its own.
        gps_minute: minutes since 1980-01-06 00:00 GPS time, in the packets that tell.
        utc_offset_s: UTC minus GPS time, in the packets that tell.
        pose: None where the packet has none.
        initialising: True if a pose is missing since there is no solution yet.
    """

    minute_ms: int | None
    gps_minute: int | None
    utc_offset_s: int | None
    pose: NcomPose | None
    initialising: bool


def decode_ncom(data: bytes) -> NcomReading:
    """Return the content of a packet.

    Raises:
        DecodeError: these bytes are no such packet, a checksum is wrong, or the pose is nonsense.
    """
    if len(data) != PACKET_SIZE or data[0] != _SYNC:
        raise DecodeError("it holds no NCOM packet of 72 bytes")
    _, milliseconds, _, status, first, lat, lon, alt, _, angles, second, channel, content, third = (
        _LAYOUT.unpack(data)
    )
    # The third sum is over all bytes; the others let a receiver use a packet that is not complete yet.
    if sum(data[1:22]) & 0xFF != first or sum(data[1:61]) & 0xFF != second or sum(data[1:71]) & 0xFF != third:
        raise DecodeError("a checksum of its NCOM packet is wrong")
    minute = offset = None
    if channel == _TIME_CHANNEL and status in _HAS_TIME:
        minute = int.from_bytes(content[:4], "little", signed=True)
    elif channel == _OFFSET_CHANNEL and content[7] & 1:
        offset = int.from_bytes(content[7:], "little", signed=True) >> 1
    return NcomReading(
        milliseconds if status in _HAS_TIME else None,
        minute if minute is not None and minute >= 0 else None,
        offset,
        _pose(lat, lon, alt, angles) if status in _SOLVED else None,
        status <= _INITIALISING,
    )


def holds_ncom(data: bytes) -> bool:
    """Tell whether the payload of a message is one NCOM packet or several, the first of which is sound."""
    if not data or len(data) % PACKET_SIZE:
        return False
    try:
        decode_ncom(data[:PACKET_SIZE])
    except DecodeError:
        return False
    return True


def _pose(lat_rad: float, lon_rad: float, alt_m: float, angles: bytes) -> NcomPose:
    heading, pitch, roll = (int.from_bytes(angles[i : i + 3], "little", signed=True) for i in (0, 3, 6))
    if not (isfinite(lat_rad) and isfinite(lon_rad) and isfinite(alt_m)):
        raise DecodeError("its NCOM position is not finite")
    lat_deg, lon_deg = lat_rad * (180 / pi), lon_rad * (180 / pi)
    if abs(lat_deg) > 90.0 or abs(lon_deg) > 360.0:
        raise DecodeError("its NCOM position is not on Earth")
    if _INVALID in (heading, pitch, roll):
        raise DecodeError("its NCOM orientation is marked invalid")
    return NcomPose(lat_deg, lon_deg, alt_m, heading * 1e-6, pitch * 1e-6, roll * 1e-6)
