"""The elevation of the sun against another way to compute it, and what counts as day."""

from datetime import UTC, datetime, timedelta
from math import asin, atan2, cos, degrees, radians, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bagassets.geometry.sun import daylight, sun_elevation_deg

J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)


def almanac_elevation_deg(lat_deg, lon_deg, when):
    """Astronomical Almanac, "Low precision formulas for the Sun": good to 0.01 degrees from 1950 to 2050."""
    days = (when - J2000) / timedelta(days=1)
    mean_longitude, anomaly = 280.460 + 0.9856474 * days, radians(357.528 + 0.9856003 * days)
    ecliptic = radians(mean_longitude + 1.915 * sin(anomaly) + 0.020 * sin(2 * anomaly))
    obliquity = radians(23.439 - 0.0000004 * days)
    right_ascension = atan2(cos(obliquity) * sin(ecliptic), cos(ecliptic))
    declination = asin(sin(obliquity) * sin(ecliptic))
    sidereal_deg = 280.46061837 + 360.98564736629 * days + lon_deg
    hour_angle, lat = radians(sidereal_deg) - right_ascension, radians(lat_deg)
    return degrees(asin(sin(lat) * sin(declination) + cos(lat) * cos(declination) * cos(hour_angle)))


@given(
    st.floats(-80, 80),
    st.floats(-180, 180),
    st.datetimes(datetime(2020, 1, 1), datetime(2029, 12, 31)),  # noqa: DTZ001  (made UTC below)
)
def test_the_elevation_is_that_of_the_almanac(lat_deg, lon_deg, moment):
    when = moment.replace(microsecond=0, tzinfo=UTC)
    ours = sun_elevation_deg(lat_deg, lon_deg, int(when.timestamp()) * 10**9)
    assert ours == pytest.approx(almanac_elevation_deg(lat_deg, lon_deg, when), abs=0.6)


@pytest.mark.parametrize("month", range(1, 13))
@pytest.mark.parametrize("hour", [0, 5, 9, 12, 15, 18, 21])
def test_through_the_months_of_a_leap_year(month, hour):
    when = datetime(2024, month, 15, hour, 30, 30, tzinfo=UTC)
    ours = sun_elevation_deg(48.1, 11.6, int(when.timestamp()) * 10**9)
    assert ours == pytest.approx(almanac_elevation_deg(48.1, 11.6, when), abs=0.28)


def elevation_is(deg):
    """A place on the equator where the sun stands so high in the afternoon of an equinox."""
    stamp_ns = int(datetime(2024, 3, 20, 12, tzinfo=UTC).timestamp()) * 10**9
    low, high = 0.0, 180.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if sun_elevation_deg(0.0, middle, stamp_ns) > deg else (low, middle)
    return 0.0, middle, stamp_ns


@pytest.mark.parametrize(
    ("deg", "name"),
    [(50, "day"), (0.01, "day"), (-0.01, "twilight"), (-5.99, "twilight"), (-6.01, "night"), (-60, "night")],
)
def test_day_ends_with_the_sun_and_twilight_six_degrees_below(deg, name):
    assert daylight(*elevation_is(deg)) == name


@pytest.mark.parametrize("year", [1970, 1980, 1989])
def test_a_clock_that_was_not_set_gives_none(year):
    assert daylight(48.1, 11.6, int(datetime(year, 6, 1, 12, tzinfo=UTC).timestamp()) * 10**9) is None
