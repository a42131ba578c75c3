"""`sensor_msgs/NavSatFix`: a position on the WGS84 ellipsoid."""

from dataclasses import dataclass
from math import isfinite, nan

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import stamp_and_frame
from bagassets.recordings.model import Message

__all__ = ["FixReading", "decode_navsat"]

STATUS_NO_FIX = -1


@dataclass(frozen=True, slots=True)
class FixReading:
    """One GNSS fix.

    Attributes:
        stamp_ns: header stamp.
        frame_id: frame of the antenna, without leading slash.
        lat_deg: WGS84 latitude.
        lon_deg: WGS84 longitude.
        alt_m: height above the ellipsoid; NaN if the receiver gives none.
    """

    stamp_ns: int
    frame_id: str
    lat_deg: float
    lon_deg: float
    alt_m: float


def decode_navsat(message: Message) -> FixReading:
    """Return the fix.

    Raises:
        DecodeError: the receiver has no fix, or the coordinates are not on Earth.
    """
    stamp_ns, frame_id = stamp_and_frame(message.header)
    lat, lon, alt = float(message.latitude), float(message.longitude), float(message.altitude)
    if int(message.status.status) <= STATUS_NO_FIX:
        raise DecodeError("the receiver has no fix (status -1)")
    if not (isfinite(lat) and isfinite(lon)):
        raise DecodeError("its latitude or longitude is not finite")
    if abs(lat) > 90.0 or abs(lon) > 360.0:
        raise DecodeError("its latitude or longitude is out of range")
    if lat == 0.0 and lon == 0.0:
        raise DecodeError("it is at 0, 0, which receivers send before they know better")
    return FixReading(stamp_ns, frame_id, lat, lon, alt if isfinite(alt) else nan)
