"""Degrees, UTM and Web Mercator: published positions, round trips, and which codes are which."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.geometry.placements import Placement
from farfield.addon.core.geometry.reprojection import Degrees, Utm, WebMercator, find_projection, reproject


def degrees(number, minutes=0.0, seconds=0.0):
    return number + minutes / 60.0 + seconds / 3600.0


def test_published_positions():
    """The example of EPSG Guidance Note 7-2 for Web Mercator, and landmarks in UTM to whole meters."""
    position = WebMercator().project(-degrees(100, 20), degrees(24, 22, 54.433))
    assert position == pytest.approx((-11169055.58, 2800000.00), abs=0.01)
    toronto = Utm(17).project(-degrees(79, 23, 13.7), degrees(43, 38, 33.24))  # CN Tower
    assert toronto == pytest.approx((630084.0, 4833438.0), abs=1.0)
    assert Utm(31).project(3.0, 0.0) == pytest.approx((500_000.0, 0.0), abs=1e-9)
    assert Utm(31, is_south=True).project(3.0, -1e-9)[1] == pytest.approx(10_000_000.0, abs=1e-3)


@settings(max_examples=40)
@given(st.floats(-3.5, 3.5), st.floats(-80.0, 84.0), st.integers(1, 60))
def test_round_trips(offset, latitude, zone):
    longitude = 6.0 * zone - 183.0 + offset
    for projection in (Utm(zone), Utm(zone, True), WebMercator(), Degrees()):
        positions = np.array(projection.project(longitude, latitude))
        assert np.abs(projection.project(*projection.unproject(*positions)) - positions).max() < 1e-6, projection


@settings(max_examples=20)
@given(st.floats(-80.0, 80.0))
def test_both_zones_at_their_common_meridian_give_one_place(latitude):
    west, east = Utm(32), Utm(33)
    x, y = reproject(west.project(12.0, latitude), west, east, 15.0)
    assert (x, y) == pytest.approx(east.project(12.0, latitude), abs=1e-6)
    x, y = reproject((np.float64(x), np.float64(y)), east, WebMercator(), 0.0)
    assert (x, y) == pytest.approx(WebMercator().project(12.0, latitude), abs=1e-6)


def test_longitudes_are_near_the_center_of_the_other_map():
    zone = Utm(1)
    x, y = reproject(zone.project(-179.9, -18.0), zone, Degrees(), 179.5)
    assert (x, y) == pytest.approx((180.1, -18.0), abs=1e-11)
    assert reproject((np.float64(361.0), np.float64(2.0)), Degrees(), WebMercator(), 0.0) == pytest.approx(WebMercator().project(1.0, 2.0))


@pytest.mark.parametrize(
    ("code", "is_geographic", "expected"),
    [
        ("EPSG:4326", True, Degrees()),
        (None, True, Degrees()),
        ("EPSG:4267", True, None),
        ("EPSG:4807", True, None),
        ("EPSG:3857", False, WebMercator()),
        ("EPSG:3395", False, None),
        ("EPSG:32601", False, Utm(1)),
        ("EPSG:32760", False, Utm(60, True)),
        ("EPSG:25832", False, Utm(32)),
        ("EPSG:26910", False, Utm(10)),
        ("EPSG:2154", False, None),
        (None, False, None),
    ],
)
def test_codes(code, is_geographic, expected):
    assert find_projection(Placement((0.0, 0.0), (1.0, 1.0), is_geographic, code)) == expected
