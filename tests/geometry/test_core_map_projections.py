"""The transverse Mercator projection: identities that determine it, and values that can be computed independently."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from farfield.addon.core.geometry.map_projections import ECCENTRICITY, SEMI_MAJOR_AXIS, TransverseMercator

MERIDIAN = 9.0


def meridian_arc(latitude: float) -> float:
    """Meters along a meridian from the equator, by quadrature of its radius of curvature."""
    radius = SEMI_MAJOR_AXIS * (1.0 - ECCENTRICITY**2)
    return quad(lambda angle: radius / (1.0 - (ECCENTRICITY * np.sin(angle)) ** 2) ** 1.5, 0.0, np.radians(latitude), epsabs=1e-8)[0]


def derivatives(longitude, latitude, step=1e-3):
    """Derivatives of easting and northing by longitude and latitude, meters per radian; central differences of fourth order."""
    projection = TransverseMercator(MERIDIAN)
    result = []
    for direction in ((step, 0.0), (0.0, step)):
        east, north = projection.project(longitude + np.arange(-2, 3) * direction[0], latitude + np.arange(-2, 3) * direction[1])
        weights = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / (12.0 * np.radians(step))
        result.append((weights @ east, weights @ north))
    return result


@settings(max_examples=30)
@given(st.floats(-40.0, 40.0), st.floats(-89.9, 89.9))
def test_round_trip(offset, latitude):
    projection = TransverseMercator(MERIDIAN, 0.9996)
    longitude, found = projection.unproject(*projection.project(MERIDIAN + offset, latitude))
    assert abs(found - latitude) < 1e-11
    assert abs(longitude - MERIDIAN - offset) * np.cos(np.radians(latitude)) < 1e-11  # degrees of 0.1 mm each 1e-9


@pytest.mark.parametrize("latitude", [-80.0, -33.0, 0.0, 10.0, 46.5, 60.0, 89.0, 90.0])
def test_the_central_meridian_is_as_long_as_on_the_ellipsoid(latitude):
    east, north = TransverseMercator(MERIDIAN).project(MERIDIAN, latitude)
    assert east == 0.0
    assert north == pytest.approx(meridian_arc(latitude), abs=1e-6)


@settings(max_examples=30)
@given(st.floats(-6.0, 6.0), st.floats(-84.0, 84.0))
def test_it_is_conformal(offset, latitude):
    """The derivatives along a parallel and a meridian, per meter on the ellipsoid, have equal lengths and are perpendicular."""
    by_longitude, by_latitude = derivatives(MERIDIAN + offset, latitude)
    root = 1.0 - (ECCENTRICITY * np.sin(np.radians(latitude))) ** 2
    parallel = SEMI_MAJOR_AXIS / root**0.5 * np.cos(np.radians(latitude))
    meridian = SEMI_MAJOR_AXIS * (1.0 - ECCENTRICITY**2) / root**1.5
    along = np.array(by_longitude) / parallel
    across = np.array(by_latitude) / meridian
    assert np.allclose(across, (-along[1], along[0]), atol=2e-8)  # the Cauchy-Riemann equations


def test_its_scale_grows_with_the_distance_from_the_central_meridian():
    """k = 1 + E^2 / (2 R^2) + E^4 / (24 R^4), R the mean radius of curvature (J. P. Snyder, USGS Professional Paper 1395)."""
    for latitude, offset in ((0.0, 2.0), (46.0, 3.0), (60.0, 1.0)):
        east, _ = TransverseMercator(MERIDIAN).project(MERIDIAN + offset, latitude)
        root = 1.0 - (ECCENTRICITY * np.sin(np.radians(latitude))) ** 2
        radius = SEMI_MAJOR_AXIS * (1.0 - ECCENTRICITY**2) ** 0.5 / root
        expected = 1.0 + east**2 / (2.0 * radius**2) + east**4 / (24.0 * radius**4)
        by_longitude, _ = derivatives(MERIDIAN + offset, latitude)
        scale = np.hypot(*by_longitude) * root**0.5 / (SEMI_MAJOR_AXIS * np.cos(np.radians(latitude)))
        assert scale == pytest.approx(expected, abs=1e-7)


def test_known_utm_coordinates():
    """Zone 32 at 8 degrees east and 47 degrees north, as PROJ gives them."""
    east, north = TransverseMercator(9.0, 0.9996).project(8.0, 47.0)
    assert (east + 500_000.0, north) == pytest.approx((423974.6879, 5205649.3477), abs=1e-4)


@settings(max_examples=30)
@given(st.floats(0.0, 30.0), st.floats(0.0, 89.0))
def test_symmetries(offset, latitude):
    projection = TransverseMercator(0.0)
    east, north = projection.project(offset, latitude)
    assert projection.project(-offset, latitude) == pytest.approx((-east, north), abs=1e-8)
    assert projection.project(offset, -latitude) == pytest.approx((east, -north), abs=1e-8)
    assert projection.project(offset + 360.0, latitude) == pytest.approx((east, north), abs=1e-6)
    assert TransverseMercator(0.0, 0.5).project(offset, latitude) == pytest.approx((east / 2.0, north / 2.0), abs=1e-8)


def test_every_position_has_a_finite_projection():
    longitudes, latitudes = np.meshgrid(np.linspace(-400.0, 400.0, 81), np.linspace(-120.0, 120.0, 49))
    for values in TransverseMercator(179.5).project(longitudes, latitudes):
        assert np.isfinite(values).all()


def test_a_grid_across_180_degrees_is_continuous():
    east, _ = TransverseMercator(180.0).project(np.array([179.5, 180.0, -179.5]), np.full(3, 10.0))
    assert east[1] == pytest.approx(0.0, abs=1e-8) and east[0] == pytest.approx(-east[2])
