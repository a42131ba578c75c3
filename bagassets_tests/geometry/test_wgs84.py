"""The ellipsoid and UTM, against published coordinates and against what defines them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.geometry.portable import arctan2, arctanh_small, sinh_cosh_small
from bagassets.geometry.se3 import SE3, quaternion_multiply
from bagassets.geometry.wgs84 import LocalFrame, ecef, ecef_Q_enu, utm_track

A = 6_378_137.0
F = 1 / 298.257223563
B = A * (1 - F)
E2 = F * (2 - F)

latitudes = st.floats(-89.0, 89.0)
longitudes = st.floats(-180.0, 180.0)
heights = st.floats(-500.0, 9000.0)
local = st.floats(-20_000.0, 20_000.0)


def arrays(*values):
    return [np.array([value]) for value in values]


def meridian_arc(lat_deg):
    """Metres along a meridian from the equator: Gauss-Legendre on the integral of its curvature."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    phi = math.radians(lat_deg) / 2 * (nodes + 1)
    curvature = A * (1 - E2) / (1 - E2 * np.sin(phi) ** 2) ** 1.5
    return math.radians(lat_deg) / 2 * float((weights * curvature).sum())


class TestEcef:
    """Earth-centred coordinates."""

    @pytest.mark.parametrize(
        ("lat", "lon", "alt", "expected"),
        [
            (0, 0, 0, (A, 0, 0)),
            (0, 90, 10, (0, A + 10, 0)),
            (0, 180, 0, (-A, 0, 0)),
            (90, 0, 0, (0, 0, B)),
            (-90, 33, 5, (0, 0, -B - 5)),
        ],
    )
    def test_the_axes_of_the_ellipsoid(self, lat, lon, alt, expected):
        np.testing.assert_allclose(ecef(*arrays(lat, lon, alt))[0], expected, atol=1e-8)

    @given(latitudes, longitudes)
    def test_points_of_height_0_lie_on_the_ellipsoid(self, lat, lon):
        x, y, z = ecef(*arrays(lat, lon, 0.0))[0]
        assert (x * x + y * y) / A**2 + z * z / B**2 == pytest.approx(1.0, abs=1e-14)

    @given(latitudes, longitudes, heights)
    def test_height_is_measured_along_the_normal(self, lat, lon, alt):
        ground, above = ecef(*arrays(lat, lon, 0.0))[0], ecef(*arrays(lat, lon, alt))[0]
        gradient = ground / [A**2, A**2, B**2]
        np.testing.assert_allclose(above - ground, alt * gradient / np.linalg.norm(gradient), atol=1e-8)


class TestLocalFrame:
    """Local metres: east, north, up."""

    @given(latitudes, longitudes, heights)
    def test_the_origin_is_at_zero(self, lat, lon, alt):
        np.testing.assert_allclose(
            LocalFrame(lat, lon, alt).to_local(*arrays(lat, lon, alt)), [[0, 0, 0]], atol=1e-9
        )

    @pytest.mark.parametrize("lat", [-60.0, -1.0, 0.0, 35.0, 48.0, 85.0])
    def test_small_steps_have_the_lengths_of_the_ellipsoids_curvature(self, lat):
        frame, step = LocalFrame(lat, 11.0, 0.0), 1e-5
        sine = math.sin(math.radians(lat))
        normal = A / math.sqrt(1 - E2 * sine**2)
        meridian = A * (1 - E2) / (1 - E2 * sine**2) ** 1.5
        east, north, up = frame.to_local(
            np.array([lat, lat + step, lat]),
            np.array([11.0 + step, 11.0, 11.0]),
            np.array([0.0, 0.0, 2.5]),
        )
        metres = math.radians(step)
        np.testing.assert_allclose(east, [normal * math.cos(math.radians(lat)) * metres, 0, 0], atol=1e-6)
        np.testing.assert_allclose(north, [0, meridian * metres, 0], atol=1e-6)
        np.testing.assert_allclose(up, [0, 0, 2.5], atol=1e-9)

    @settings(deadline=None)
    @given(latitudes, longitudes, heights, local, local, st.floats(-100.0, 100.0))
    def test_there_and_back(self, lat, lon, alt, x, y, z):
        frame = LocalFrame(lat, lon, alt)
        point = np.array([[x, y, z]])
        np.testing.assert_allclose(frame.to_local(*frame.to_geodetic(point)), point, atol=2e-6)

    @given(latitudes, longitudes, heights, local, local)
    def test_it_is_a_rigid_change_of_coordinates(self, lat, lon, alt, x, y):
        frame = LocalFrame(lat, lon, alt)
        points = np.array([[x, y, 3.0], [0.0, 0.0, 0.0]])
        earth = frame.ecef_SE3_enu.transform_points(points)
        assert np.linalg.norm(earth[0] - earth[1]) == pytest.approx(np.linalg.norm(points[0]), abs=1e-6)
        np.testing.assert_allclose(ecef(*frame.to_geodetic(points)), earth, atol=2e-6)

    @given(latitudes, longitudes)
    def test_its_axes_are_those_of_growing_longitude_latitude_and_height(self, lat, lon):
        step = 1e-4
        rotation = SE3.create(ecef_Q_enu(*arrays(lat, lon))[0], (0, 0, 0)).rotation_matrix
        for axis, change in enumerate(((0, step, 0), (step, 0, 0), (0, 0, 1.0))):
            plus, minus = (
                ecef(*arrays(lat + s * change[0], lon + s * change[1], s * change[2]))[0] for s in (1, -1)
            )
            direction = (plus - minus) / np.linalg.norm(plus - minus)
            np.testing.assert_allclose(rotation[:, axis], direction, atol=1e-6)

    @given(latitudes, longitudes, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
    def test_orientations_are_turned_with_the_ground(self, lat, lon, dlat, dlon):
        """A body that points east at its own place, seen from another: where its neighbour to the east lies."""
        frame = LocalFrame(lat, lon, 0.0)
        there = arrays(max(-89.0, min(89.0, lat + dlat)), lon + dlon)
        turned = frame.rotations_to_local(*there, np.array([[1.0, 0.0, 0.0, 0.0]]))[0]
        pair = frame.to_local(np.repeat(there[0], 2), there[1] + np.array([-1e-4, 1e-4]), np.zeros(2))
        east = (pair[1] - pair[0]) / np.linalg.norm(pair[1] - pair[0])
        np.testing.assert_allclose(SE3.create(turned, (0, 0, 0)).rotation_matrix[:, 0], east, atol=1e-6)
        yawed = np.array([[math.cos(0.3), 0.0, 0.0, math.sin(0.3)]])
        np.testing.assert_allclose(
            frame.rotations_to_local(*there, yawed)[0], quaternion_multiply(turned, yawed[0]), atol=1e-14
        )

    def test_over_the_date_line(self):
        east = LocalFrame(10.0, 179.9999, 0.0).to_local(*arrays(10.0, -179.9999, 0.0))[0]
        normal = A / math.sqrt(1 - E2 * math.sin(math.radians(10)) ** 2)
        assert east[0] == pytest.approx(normal * math.cos(math.radians(10)) * math.radians(0.0002), abs=1e-4)


def utm(lat, lon):
    """The UTM coordinates of one point."""
    return utm_track(np.array([lat]), np.array([lon]))


class TestUtm:
    """UTM is the one conformal map that keeps the central meridian's length times 0.9996."""

    @pytest.mark.parametrize(
        ("lat", "lon", "zone", "easting", "northing"),
        [
            (48 + 51 / 60 + 29.52 / 3600, 2 + 17 / 60 + 40.20 / 3600, "31N", 448_251.795, 5_411_932.678),
            (0.0, 3.0, "31N", 500_000.0, 0.0),
            (0.0, -177.0, "1N", 500_000.0, 0.0),
        ],
    )
    def test_published_coordinates(self, lat, lon, zone, easting, northing):
        grid = utm(lat, lon)
        assert grid.zones == [zone]
        assert (grid.easting_m, grid.northing_m) == pytest.approx((easting, northing), abs=2e-3)

    @pytest.mark.parametrize("lat", [-79.0, -33.0, 0.5, 31.0, 48.137, 70.0, 83.9])
    def test_northing_on_the_central_meridian_is_its_arc(self, lat):
        grid = utm(lat, 9.0 if abs(lat) < 72 else 15.0)
        south = 10_000_000.0 if lat < 0 else 0.0
        assert grid.easting_m == pytest.approx(500_000.0, abs=1e-6)
        assert grid.northing_m - south == pytest.approx(0.9996 * meridian_arc(lat), abs=1e-6)
        assert grid.convergence_deg == pytest.approx(0.0, abs=1e-12)

    @settings(deadline=None)
    @given(st.floats(-79.9, 83.9), st.floats(-2.9, 2.9))
    def test_it_is_conformal(self, lat, from_meridian):
        """A step north and one east, equally long on the ellipsoid, are so on the grid, and at right angles."""
        lon = 51.0 + from_meridian
        step = 1e-4
        sine = math.sin(math.radians(lat))
        normal, meridian = A / math.sqrt(1 - E2 * sine**2), A * (1 - E2) / (1 - E2 * sine**2) ** 1.5

        def difference(dlat, dlon):
            one, other = utm(lat + dlat, lon + dlon), utm(lat - dlat, lon - dlon)
            south = 1e7 * ((one.zones[0][-1] == "S") - (other.zones[0][-1] == "S"))
            return np.array(
                [*(one.easting_m - other.easting_m), *(one.northing_m - other.northing_m - south)]
            ) / math.radians(2 * step)

        north = difference(step, 0.0) / meridian
        east = difference(0.0, step) / (normal * math.cos(math.radians(lat)))
        np.testing.assert_allclose([-east[1], east[0]], north, atol=2e-6)
        assert utm(lat, lon).convergence_deg == pytest.approx(
            math.degrees(math.atan2(-north[0], north[1])), abs=1e-3
        )

    @pytest.mark.parametrize(
        ("lat", "lon", "zone"),
        [
            # Svalbard: from 0 to 42 degrees east there are four wide zones.
            (72.0, 0.0, "31N"),
            (72.0, 8.99, "31N"),
            (80.0, 9.0, "33N"),
            (80.0, 20.99, "33N"),
            (80.0, 21.0, "35N"),
            (80.0, 32.99, "35N"),
            (80.0, 33.0, "37N"),
            (80.0, 41.99, "37N"),
            (80.0, 42.0, "38N"),
            (80.0, -0.01, "30N"),
            (71.99, 7.0, "32N"),
            # Norway: zone 32 begins three degrees farther west.
            (56.0, 3.0, "32N"),
            (63.99, 11.99, "32N"),
            (55.99, 3.0, "31N"),
            (64.0, 3.0, "31N"),
            (60.0, 2.99, "31N"),
            (60.0, 12.0, "33N"),
            (60.0, 4.0, "32N"),
            (60.0, 2.9, "31N"),
            (78.0, 8.0, "31N"),
            (78.0, 10.0, "33N"),
            (78.0, 35.0, "37N"),
            (78.0, 43.0, "38N"),
            (-33.9, 151.2, "56S"),
            (10.0, 180.0, "1N"),
            (10.0, 179.99, "60N"),
            (10.0, -180.0, "1N"),
            (10.0, 540.0, "1N"),
        ],
    )
    def test_zones_and_their_exceptions(self, lat, lon, zone):
        assert utm(lat, lon).zones == [zone]

    def test_a_track_is_its_points(self):
        lat, lon = np.array([48.0, -33.9, 85.0, 60.0]), np.array([11.6, 151.2, 0.0, 364.0])
        track = utm_track(lat, lon)
        assert track.zones == ["32N", "56S", None, "32N"]
        assert np.isnan(track.easting_m[2])
        for i in (0, 1, 3):
            alone = utm(float(lat[i]), float(lon[i]))
            assert (track.easting_m[i], track.northing_m[i], track.convergence_deg[i]) == (
                alone.easting_m,
                alone.northing_m,
                alone.convergence_deg,
            )

    @pytest.mark.parametrize("lat", [-80.1, 84.1, 90.0])
    def test_there_is_none_at_the_poles(self, lat):
        track = utm(lat, 10.0)
        assert track.zones == [None]
        assert np.isnan([track.easting_m, track.northing_m, track.convergence_deg]).all()


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_arctan2_agrees_with_the_c_library(y, x):
    if x != 0 or y != 0:  # the sign of a zero means nothing here
        assert abs(float(arctan2(np.array(y), np.array(x)))) == pytest.approx(
            abs(math.atan2(y, x)), abs=2e-15
        )


def test_arctan2_of_the_axes_and_the_origin():
    y, x = np.array([0.0, 1.0, 0.0, -1.0, 0.0]), np.array([1.0, 0.0, -1.0, 0.0, 0.0])
    np.testing.assert_array_equal(arctan2(y, x), [0.0, math.pi / 2, math.pi, -math.pi / 2, 0.0])


@given(st.floats(-0.12, 0.12))
def test_artanh_agrees_with_the_c_library(ratio):
    assert float(arctanh_small(np.array(ratio))) == pytest.approx(math.atanh(ratio), rel=1e-15, abs=1e-300)


@given(st.floats(-1.5, 1.5))
def test_hyperbolic_functions_agree_with_the_c_library(value):
    sinh, cosh = sinh_cosh_small(np.array(value))
    assert float(sinh) == pytest.approx(math.sinh(value), rel=2e-15, abs=1e-300)
    assert float(cosh) == pytest.approx(math.cosh(value), rel=2e-15)
