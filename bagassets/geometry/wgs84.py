"""The WGS84 ellipsoid: geodetic coordinates, local east-north-up metres, UTM.

Angles are degrees at the interface. What is computed here is written into datasets, so all of it
is made of `bagassets.geometry.portable`.
"""

from dataclasses import dataclass
from math import pi

import numpy as np

from bagassets.geometry.portable import arctan2, arctanh_small, sin_cos, sin_cos_deg, sinh_cosh_small
from bagassets.geometry.se3 import SE3, Floats, quaternion_multiply

# NIMA TR8350.2, "Department of Defense World Geodetic System 1984".
SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1 / 298.257223563
ECCENTRICITY_2 = FLATTENING * (2 - FLATTENING)

UTM_SCALE = 0.9996
FALSE_EASTING_M = 500_000.0
FALSE_NORTHING_M = 10_000_000.0
UTM_SOUTH_DEG, UTM_NORTH_DEG = -80.0, 84.0


def ecef(lat_deg: Floats, lon_deg: Floats, alt_m: Floats) -> Floats:
    """Return earth-centred, earth-fixed metres.

    Args:
        lat_deg: (N,) geodetic latitude.
        lon_deg: (N,) longitude.
        alt_m: (N,) height above the ellipsoid.

    Returns:
        (N, 3) x towards 0°, 0°; y towards 0°, 90° E; z towards the north pole.
    """
    sin_lat, cos_lat = sin_cos_deg(lat_deg)
    sin_lon, cos_lon = sin_cos_deg(lon_deg)
    normal_m = _normal_m(sin_lat)
    across_m = (normal_m + alt_m) * cos_lat
    up_m = (normal_m * (1 - ECCENTRICITY_2) + alt_m) * sin_lat
    return np.stack([across_m * cos_lon, across_m * sin_lon, up_m], axis=-1)


def ecef_Q_enu(lat_deg: Floats, lon_deg: Floats) -> Floats:
    """Return (N, 4) quaternions that turn east, north, up at (N,) places into earth-centred axes.

    They are a turn of lon + 90° about the Earth's axis after one of 90° - lat about the east.
    """
    sine_z, cosine_z = sin_cos_deg((np.asarray(lon_deg) + 90.0) / 2)
    sine_x, cosine_x = sin_cos_deg((90.0 - np.asarray(lat_deg)) / 2)
    return np.stack([cosine_z * cosine_x, cosine_z * sine_x, sine_z * sine_x, sine_z * cosine_x], axis=-1)


@dataclass(frozen=True)
class LocalFrame:
    """Local metres on the plane that touches the ellipsoid at an origin: x east, y north, z up (REP 103).

    The plane is flat and the Earth is not: 10 km from the origin the ground lies 7.8 m below z = 0.
    """

    lat_deg: float
    lon_deg: float
    alt_m: float

    @property
    def ecef_SE3_enu(self) -> SE3:
        """Pose of the local frame in earth-centred, earth-fixed coordinates."""
        origin = ecef(np.array(self.lat_deg), np.array(self.lon_deg), np.array(self.alt_m))
        return SE3.create(ecef_Q_enu(np.array(self.lat_deg), np.array(self.lon_deg)), origin)

    def to_local(self, lat_deg: Floats, lon_deg: Floats, alt_m: Floats) -> Floats:
        """Return (N, 3) east, north, up in metres of (N,) geodetic coordinates."""
        (sin_lat, sin_lon), (cos_lat, cos_lon) = sin_cos_deg(np.array([self.lat_deg, self.lon_deg]))
        origin = ecef(np.array(self.lat_deg), np.array(self.lon_deg), np.array(self.alt_m))
        dx, dy, dz = np.moveaxis(ecef(lat_deg, lon_deg, alt_m) - origin, -1, 0)
        outward = cos_lon * dx + sin_lon * dy
        return np.stack(
            [
                cos_lon * dy - sin_lon * dx,
                cos_lat * dz - sin_lat * outward,
                cos_lat * outward + sin_lat * dz,
            ],
            axis=-1,
        )

    def rotations_to_local(self, lat_deg: Floats, lon_deg: Floats, enu_Q_body: Floats) -> Floats:
        """Return (N, 4) orientations in this frame of those given east, north, up at their own places.

        Up and north differ between places: by a tenth of a degree 10 km apart.

        Args:
            lat_deg: (N,) latitude of each place.
            lon_deg: (N,) longitude of each place.
            enu_Q_body: (N, 4) quaternions w, x, y, z.
        """
        local_Q_ecef = ecef_Q_enu(np.array(self.lat_deg), np.array(self.lon_deg)) * [1.0, -1.0, -1.0, -1.0]
        local_Q_enu = quaternion_multiply(local_Q_ecef, ecef_Q_enu(lat_deg, lon_deg))
        return quaternion_multiply(local_Q_enu, enu_Q_body)

    def to_geodetic(self, local_m: Floats) -> tuple[Floats, Floats, Floats]:
        """Return (N,) latitude and longitude in degrees and height in metres of (N, 3) local metres.

        By fixed-point iteration on the latitude, which loses a factor of 150 of its error each
        time; within 100 km of the surface it ends below a micrometre.
        """
        x, y, z = np.moveaxis(self.ecef_SE3_enu.transform_points(local_m), -1, 0)
        across_m = np.sqrt(x * x + y * y)
        lat_rad = arctan2(z, across_m * (1 - ECCENTRICITY_2))
        for _ in range(8):
            sin_lat, _cos = sin_cos(lat_rad)
            lat_rad = arctan2(z + ECCENTRICITY_2 * _normal_m(sin_lat) * sin_lat, across_m)
        sin_lat, cos_lat = sin_cos(lat_rad)
        # Height along the normal; dividing by the cosine of the latitude would fail at the poles.
        alt_m = across_m * cos_lat + z * sin_lat - SEMI_MAJOR_M**2 / _normal_m(sin_lat)
        return lat_rad * (180 / pi), arctan2(y, x) * (180 / pi), alt_m


@dataclass(frozen=True, eq=False)
class UtmTrack:
    """Universal Transverse Mercator coordinates of N points, each in its own zone; None and NaN where UTM is not defined.

    Attributes:
        zones: number and hemisphere: 32N, 55S.
        easting_m: false easting included.
        northing_m: false northing included in the south.
        convergence_deg: direction of grid north, clockwise from true north. East-north-up
            metres are aligned with true north; this turns them onto the grid.
    """

    zones: list[str | None]
    easting_m: Floats
    northing_m: Floats
    convergence_deg: Floats


def utm_track(lat_deg: Floats, lon_deg: Floats) -> UtmTrack:
    """Return UTM coordinates of (N,) points, which are defined from 80° S to 84° N.

    The series of Krüger in the third flattening to the sixth order, with errors of nanometres in a
    zone: C. F. F. Karney, "Transverse Mercator with an accuracy of a few nanometers", Journal of
    Geodesy 85 (2011), equations 7-11, 23-26 and 35.
    """
    defined = (lat_deg >= UTM_SOUTH_DEG) & (lat_deg <= UTM_NORTH_DEG)
    lat_deg = np.where(defined, lat_deg, 0.0)
    lon_deg = np.mod(lon_deg + 180.0, 360.0) - 180.0
    numbers = [_zone_number(lat, lon) for lat, lon in zip(lat_deg.tolist(), lon_deg.tolist(), strict=True)]
    sin_lat, cos_lat = sin_cos_deg(lat_deg)
    sin_lon, cos_lon = sin_cos_deg(lon_deg - (6.0 * np.array(numbers, dtype=np.float64) - 183.0))

    # Conformal latitude, as its tangent: equations 7-9.
    eccentricity = np.sqrt(ECCENTRICITY_2)
    tan_lat = sin_lat / cos_lat
    sigma, _ = sinh_cosh_small(eccentricity * arctanh_small(eccentricity * sin_lat))
    tan_conformal = tan_lat * np.sqrt(1 + sigma * sigma) - sigma * np.sqrt(1 + tan_lat * tan_lat)

    # Gauss-Schreiber coordinates, equation 10; arsinh y = artanh(y / sqrt(1 + y²)).
    xi = arctan2(tan_conformal, cos_lon)
    across = sin_lon / np.sqrt(tan_conformal * tan_conformal + cos_lon * cos_lon)
    eta = arctanh_small(across / np.sqrt(1 + across * across))

    # Krüger's series, equation 11, and its derivative for the convergence, equations 23-26.
    y, x, p, q = xi, eta, np.ones_like(xi), np.zeros_like(xi)
    for j, alpha in enumerate(_ALPHA, start=1):
        sin_xi, cos_xi = sin_cos(2 * j * xi)
        sinh_eta, cosh_eta = sinh_cosh_small(2 * j * eta)
        y = y + alpha * sin_xi * cosh_eta
        x = x + alpha * cos_xi * sinh_eta
        p = p + 2 * j * alpha * cos_xi * cosh_eta
        q = q + 2 * j * alpha * sin_xi * sinh_eta
    turn_schreiber = arctan2(tan_conformal * sin_lon, np.sqrt(1 + tan_conformal * tan_conformal) * cos_lon)
    south = lat_deg < 0
    scale_m = UTM_SCALE * _RECTIFYING_RADIUS_M
    nowhere = np.where(defined, 0.0, np.nan)
    hemispheres = np.where(south, "S", "N").tolist()
    named = zip(numbers, hemispheres, defined.tolist(), strict=True)
    return UtmTrack(
        [f"{number}{hemisphere}" if known else None for number, hemisphere, known in named],
        FALSE_EASTING_M + scale_m * x + nowhere,
        np.where(south, FALSE_NORTHING_M, 0.0) + scale_m * y + nowhere,
        (turn_schreiber + arctan2(q, p)) * (180 / pi) + nowhere,
    )


def _normal_m(sin_lat: Floats) -> Floats:
    """Radius of curvature in the prime vertical, metres."""
    return SEMI_MAJOR_M / np.sqrt(1 - ECCENTRICITY_2 * sin_lat * sin_lat)


def _zone_number(lat_deg: float, lon_deg: float) -> int:
    """UTM zone, with the exceptions for Norway and Svalbard."""
    if 56 <= lat_deg < 64 and 3 <= lon_deg < 12:
        return 32
    if lat_deg >= 72 and 0 <= lon_deg < 42:
        return 31 + 2 * int((lon_deg + 3) // 12)
    return int((lon_deg + 180) // 6) % 60 + 1


_THIRD_FLATTENING = FLATTENING / (2 - FLATTENING)
# Factors of powers of the third flattening in equation 35; row j begins with its jth power.
_POWERS: list[list[float]] = [
    [1 / 2, -2 / 3, 5 / 16, 41 / 180, -127 / 288, 7891 / 37800],
    [13 / 48, -3 / 5, 557 / 1440, 281 / 630, -1983433 / 1935360],
    [61 / 240, -103 / 140, 15061 / 26880, 167603 / 181440],
    [49561 / 161280, -179 / 168, 6601661 / 7257600],
    [34729 / 80640, -3418889 / 1995840],
    [212378941 / 319334400],
]
_ALPHA = [
    sum(value * _THIRD_FLATTENING ** (j + power) for power, value in enumerate(row))
    for j, row in enumerate(_POWERS, start=1)
]
_RECTIFYING_RADIUS_M = (
    SEMI_MAJOR_M
    / (1 + _THIRD_FLATTENING)
    * (1 + _THIRD_FLATTENING**2 / 4 + _THIRD_FLATTENING**4 / 64 + _THIRD_FLATTENING**6 / 256)
)
