"""Georeferences from GeoTIFF tags."""

import math

import pytest

from farfield.addon.core.files.geotiff import (
    GEO_DOUBLES,
    GEO_KEYS,
    GEOGRAPHIC,
    NO_DATA,
    PIXEL_SCALE,
    PROJECTED,
    TIEPOINT,
    TRANSFORMATION,
    GeoReference,
    read_georeference,
)

FEET = 1200.0 / 3937.0


def keys(*rows: tuple[int, int, int, int]) -> tuple[int, ...]:
    """The tag of geo keys with these rows."""
    return (1, 1, 0, len(rows), *(number for row in rows for number in row))


def scaled(*rows: tuple[int, int, int, int], tiepoint=(0.0, 0.0, 0.0, 500.0, 900.0, 0.0)) -> GeoReference:
    return read_georeference({PIXEL_SCALE: (10.0, 20.0, 0.0), TIEPOINT: tiepoint, GEO_KEYS: keys(*rows)})


def test_without_tags_nothing_is_known():
    assert read_georeference({}) == GeoReference()


def test_pixels_are_areas_unless_they_are_points():
    assert scaled().affine == (10.0, 0.0, 505.0, 0.0, -20.0, 890.0)
    assert scaled((1025, 0, 1, 1)).affine == (10.0, 0.0, 505.0, 0.0, -20.0, 890.0)
    assert scaled((1025, 0, 1, 2)).affine == (10.0, 0.0, 500.0, 0.0, -20.0, 900.0)


def test_the_tiepoint_may_be_any_pixel():
    assert scaled((1025, 0, 1, 2), tiepoint=(3.0, 4.0, 0.0, 530.0, 820.0, 0.0)).affine == scaled((1025, 0, 1, 2)).affine


def test_a_matrix_means_the_same_as_scale_and_tiepoint():
    matrix = (10.0, 0.0, 0.0, 500.0, 0.0, -20.0, 0.0, 900.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    reference = read_georeference({TRANSFORMATION: matrix})
    assert reference.affine == scaled().affine and not reference.is_rotated
    cosine, sine = 10.0 * math.cos(0.1), 10.0 * math.sin(0.1)
    rotated = (cosine, sine, 0.0, 500.0, sine, -cosine, 0.0, 900.0, *matrix[8:])
    reference = read_georeference({TRANSFORMATION: rotated})
    assert reference.is_rotated
    assert reference.affine[2] == pytest.approx(500.0 + 0.5 * (cosine + sine))


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([(1024, 0, 1, 1), (3072, 0, 1, 32632)], (PROJECTED, 32632, 1.0, 1.0)),
        ([(1024, 0, 1, 1), (3072, 0, 1, 32767), (3076, 0, 1, 9003)], (PROJECTED, None, FEET, 1.0)),
        ([(1024, 0, 1, 1), (3076, 0, 1, 9002), (4099, 0, 1, 9001)], (PROJECTED, None, 0.3048, 1.0)),
        ([(1024, 0, 1, 1), (3076, 0, 1, 32767), (3077, GEO_DOUBLES, 1, 1)], (PROJECTED, None, 0.9144, 1.0)),
        ([(1024, 0, 1, 1), (3076, 0, 1, 9999)], (PROJECTED, None, None, 1.0)),
        ([(1024, 0, 1, 2), (2048, 0, 1, 4326), (4099, 0, 1, 9003)], (GEOGRAPHIC, 4326, 1.0, FEET)),
        ([(1024, 0, 1, 2), (2054, 0, 1, 9101)], (GEOGRAPHIC, None, math.degrees(1.0), 1.0)),
        ([(1024, 0, 1, 1), (4096, 0, 1, 6360)], (PROJECTED, None, 1.0, FEET)),
        ([(3072, 0, 1, 2263)], (PROJECTED, 2263, FEET, 1.0)),
        ([(1024, 0, 1, 1), (3072, 0, 1, 2263), (3076, 0, 1, 9001)], (PROJECTED, 2263, 1.0, 1.0)),
        ([(2048, 0, 1, 4807)], (GEOGRAPHIC, 4807, 0.9, 1.0)),
        ([(1024, 0, 1, 1), (3072, 0, 1, 4326)], (GEOGRAPHIC, 4326, 1.0, 1.0)),
    ],
)
def test_systems_and_units(rows, expected):
    reference = read_georeference({GEO_KEYS: keys(*rows), GEO_DOUBLES: (1.0, 0.9144)})
    assert (reference.model_type, reference.epsg, reference.horizontal_unit, reference.vertical_unit) == expected


@pytest.mark.parametrize(
    ("text", "number"), [("-32767", -32767.0), ("-9999.5 \0", -9999.5), ("-9999,0", -9999.0), (-1, -1.0), ("none", None)]
)
def test_no_data(text, number):
    assert read_georeference({NO_DATA: text}).no_data == number


def test_damaged_tags_count_as_missing():
    for scale in ((), (0.0, 0.0), (float("nan"), 1.0), "text", 7, ("a", "b"), (1e300, 1e300)):
        assert read_georeference({PIXEL_SCALE: scale, TIEPOINT: (0.0,) * 6}).affine is None
    assert read_georeference({PIXEL_SCALE: (1.0, 1.0), TIEPOINT: (0.0, 0.0, 0.0, math.inf, 0.0, 0.0)}).affine is None
    for tag in ((), 1, "keys", (1, 1, 0, 9, 1024), (1, 1, 0, 1, 3077, GEO_DOUBLES, 1, 99)):
        assert read_georeference({GEO_KEYS: tag}).model_type is None
