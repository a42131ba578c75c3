"""The WGS84 ellipsoid: geodetic coordinates, local east-north-up metres, UTM.

Scalars and `math` throughout: GNSS positions are few, and their numbers are written down.
"""

from dataclasses import dataclass
from math import asinh, atan2, atanh, cos, cosh, degrees, floor, hypot, radians, sin, sinh, sqrt, tan

import numpy as np

from bagassets.geometry.se3 import SE3, quaternion_from_rotation

__all__ = ["LocalFrame", "Utm", "ecef", "utm"]

# NIMA TR8350.2, "Department of Defense World Geodetic System 1984".
SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1 / 298.257223563
ECCENTRICITY_2 = FLATTENING * (2 - FLATTENING)

UTM_SCALE = 0.9996
FALSE_EASTING_M = 500_000.0
FALSE_NORTHING_M = 10_000_000.0


def ecef(lat_deg: float, lon_deg: float, alt_m: float) -> tuple[float, float, float]:
    """Return earth-centred, earth-fixed x, y, z in metres."""
    lat, lon = radians(lat_deg), radians(lon_deg)
    normal = SEMI_MAJOR_M / sqrt(1 - ECCENTRICITY_2 * sin(lat) ** 2)
    across = (normal + alt_m) * cos(lat)
    return across * cos(lon), across * sin(lon), (normal * (1 - ECCENTRICITY_2) + alt_m) * sin(lat)


@dataclass(frozen=True)
class LocalFrame:
    """East-north-up metres around an origin (REP-103: x east, y north, z up)."""

    lat_deg: float
    lon_deg: float
    alt_m: float

    @property
    def ecef_SE3_enu(self) -> SE3:
        """Pose of the local frame in earth-centred, earth-fixed coordinates."""
        lat, lon = radians(self.lat_deg), radians(self.lon_deg)
        rotation = np.array(
            [
                [-sin(lon), -sin(lat) * cos(lon), cos(lat) * cos(lon)],
                [cos(lon), -sin(lat) * sin(lon), cos(lat) * sin(lon)],
                [0.0, cos(lat), sin(lat)],
            ]
        )
        return SE3.create(quaternion_from_rotation(rotation), ecef(self.lat_deg, self.lon_deg, self.alt_m))

    def to_local(self, lat_deg: float, lon_deg: float, alt_m: float) -> tuple[float, float, float]:
        """Return east, north, up in metres."""
        lat, lon = radians(self.lat_deg), radians(self.lon_deg)
        x0, y0, z0 = ecef(self.lat_deg, self.lon_deg, self.alt_m)
        x, y, z = ecef(lat_deg, lon_deg, alt_m)
        dx, dy, dz = x - x0, y - y0, z - z0
        along = cos(lon) * dx + sin(lon) * dy
        return (
            -sin(lon) * dx + cos(lon) * dy,
            -sin(lat) * along + cos(lat) * dz,
            cos(lat) * along + sin(lat) * dz,
        )

    def to_geodetic(self, east_m: float, north_m: float, up_m: float) -> tuple[float, float, float]:
        """Return latitude and longitude in degrees and ellipsoidal height in metres.

        Bowring's iteration on the reduced latitude, exact to micrometres near the surface.
        """
        x, y, z = (
            float(v) for v in self.ecef_SE3_enu.transform_points(np.array([[east_m, north_m, up_m]]))[0]
        )
        across = hypot(x, y)
        lat = atan2(z, across * (1 - ECCENTRICITY_2))
        for _ in range(8):
            normal = SEMI_MAJOR_M / sqrt(1 - ECCENTRICITY_2 * sin(lat) ** 2)
            lat = atan2(z + ECCENTRICITY_2 * normal * sin(lat), across)
        normal = SEMI_MAJOR_M / sqrt(1 - ECCENTRICITY_2 * sin(lat) ** 2)
        # Measured along the normal, which holds at the poles too.
        alt = across * cos(lat) + z * sin(lat) - SEMI_MAJOR_M**2 / normal
        return degrees(lat), degrees(atan2(y, x)), alt


@dataclass(frozen=True)
class Utm:
    """Universal Transverse Mercator coordinates.

    Attributes:
        zone: number and hemisphere, as in 32N.
        easting_m: metres, false easting included.
        northing_m: metres, false northing included in the south.
    """

    zone: str
    easting_m: float
    northing_m: float


def utm(lat_deg: float, lon_deg: float) -> Utm:
    """Return UTM coordinates in the standard zone of a place (Norway and Svalbard not excepted).

    Krüger's series to n^6, good to nanometres within a zone: C. F. F. Karney, "Transverse
    Mercator with an accuracy of a few nanometers", 2011, equations 7-11 and 35.
    """
    number = min(floor((lon_deg + 180) / 6) + 1, 60)
    central = radians(number * 6 - 183)
    lat, lon = radians(lat_deg), radians(lon_deg) - central
    e = sqrt(ECCENTRICITY_2)
    tau = tan(lat)
    sigma = sinh(e * atanh(e * tau / sqrt(1 + tau * tau)))
    conformal = tau * sqrt(1 + sigma * sigma) - sigma * sqrt(1 + tau * tau)
    xi = atan2(conformal, cos(lon))
    eta = asinh(sin(lon) / hypot(conformal, cos(lon)))
    n = FLATTENING / (2 - FLATTENING)
    x, y = eta, xi
    for j, alpha in enumerate(_kruger(n), start=1):
        y += alpha * sin(2 * j * xi) * cosh(2 * j * eta)
        x += alpha * cos(2 * j * xi) * sinh(2 * j * eta)
    radius = SEMI_MAJOR_M / (1 + n) * (1 + n**2 / 4 + n**4 / 64 + n**6 / 256)
    south = lat_deg < 0
    return Utm(
        f"{number}{'S' if south else 'N'}",
        FALSE_EASTING_M + UTM_SCALE * radius * x,
        (FALSE_NORTHING_M if south else 0.0) + UTM_SCALE * radius * y,
    )


def _kruger(n: float) -> tuple[float, ...]:
    return (
        n / 2 - 2 * n**2 / 3 + 5 * n**3 / 16 + 41 * n**4 / 180 - 127 * n**5 / 288 + 7891 * n**6 / 37800,
        13 * n**2 / 48 - 3 * n**3 / 5 + 557 * n**4 / 1440 + 281 * n**5 / 630 - 1983433 * n**6 / 1935360,
        61 * n**3 / 240 - 103 * n**4 / 140 + 15061 * n**5 / 26880 + 167603 * n**6 / 181440,
        49561 * n**4 / 161280 - 179 * n**5 / 168 + 6601661 * n**6 / 7257600,
        34729 * n**5 / 80640 - 3418889 * n**6 / 1995840,
        212378941 * n**6 / 319334400,
    )
