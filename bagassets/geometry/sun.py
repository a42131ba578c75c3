"""Elevation of the sun, to tell day from night."""

from datetime import UTC, datetime
from math import asin, cos, degrees, pi, radians, sin

# Below this the sun gives hardly any light (end of civil twilight).
NIGHT_DEG = -6.0
_FIRST_GNSS_NS = 631_152_000 * 1_000_000_000  # 1990-01-01


def sun_elevation_deg(lat_deg: float, lon_deg: float, stamp_ns: int) -> float:
    """Return the elevation of the sun's centre above the horizon, good to about 0.6 degrees.

    In leap years the error is 0.3: the series assumes that each year begins at the same point of the orbit.
    NOAA Global Monitoring Division, "General Solar Position Calculations", low-accuracy series.
    """
    when = datetime.fromtimestamp(stamp_ns / 1e9, tz=UTC)
    hours = when.hour + when.minute / 60 + when.second / 3600
    gamma = 2 * pi / 365 * (when.timetuple().tm_yday - 1 + (hours - 12) / 24)
    equation_min = 229.18 * (
        0.000075
        + 0.001868 * cos(gamma)
        - 0.032077 * sin(gamma)
        - 0.014615 * cos(2 * gamma)
        - 0.040849 * sin(2 * gamma)
    )
    declination = (
        0.006918
        - 0.399912 * cos(gamma)
        + 0.070257 * sin(gamma)
        - 0.006758 * cos(2 * gamma)
        + 0.000907 * sin(2 * gamma)
        - 0.002697 * cos(3 * gamma)
        + 0.00148 * sin(3 * gamma)
    )
    hour_angle = radians((hours * 60 + equation_min + 4 * lon_deg) / 4 - 180)
    lat = radians(lat_deg)
    return degrees(asin(sin(lat) * sin(declination) + cos(lat) * cos(declination) * cos(hour_angle)))


def daylight(lat_deg: float, lon_deg: float, stamp_ns: int) -> str | None:
    """Return `day`, `twilight` or `night`; None before GNSS was in use: the clock is simulated, or was not set."""
    if stamp_ns < _FIRST_GNSS_NS:
        return None
    elevation = sun_elevation_deg(lat_deg, lon_deg, stamp_ns)
    return "day" if elevation > 0 else "twilight" if elevation > NIGHT_DEG else "night"
