"""At the switch distance an error covers one pixel; levels are chosen by their switch distances."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.geometry.cameras import Camera, choose_level, distance_to_box, pixel_size_at, switch_distance

ANGLES = st.floats(0.01, 3.0)
PIXELS = st.integers(1, 10_000)
LENGTHS = st.floats(1e-6, 1e6)


def test_a_right_angle_spans_twice_the_distance():
    assert pixel_size_at(10.0, math.pi / 2, 20) == pytest.approx(1.0)


@settings(max_examples=30)
@given(error=LENGTHS, angle=ANGLES, pixels=PIXELS)
def test_switch_distance_is_where_the_error_is_one_pixel(error, angle, pixels):
    assert pixel_size_at(switch_distance(error, angle, pixels), angle, pixels) == pytest.approx(error)


@pytest.mark.parametrize(("angle", "pixels"), [(0.0, 10), (math.pi, 10), (1.0, 0)])
def test_invalid_cameras_are_rejected(angle, pixels):
    with pytest.raises(SettingsError):
        pixel_size_at(1.0, angle, pixels)


def test_orthographic_pixels_have_the_same_size_at_any_distance():
    camera = Camera(np.zeros(3), pixels=100, field_of_view=0.0, orthographic_scale=10.0)
    assert camera.pixel_size(1.0) == camera.pixel_size(1000.0) == pytest.approx(0.1)
    assert camera.switch_distance(0.05) == 0.0
    assert camera.switch_distance(0.5) == math.inf


@settings(max_examples=30)
@given(distance=st.floats(0.0, 1e5))
def test_levels_change_exactly_at_their_switch_distances(distance):
    camera = Camera(np.zeros(3), pixels=1920, field_of_view=0.7)
    errors = [0.01, 0.02, 0.04]
    expected = [index for index, error in enumerate(errors) if camera.switch_distance(error) <= distance]
    assert choose_level(errors, distance, camera) == (max(expected) if expected else None)


@settings(max_examples=30)
@given(
    position=st.lists(st.floats(-10, 10), min_size=3, max_size=3),
    low=st.lists(st.floats(-5, 0), min_size=3, max_size=3),
    high=st.lists(st.floats(0, 5), min_size=3, max_size=3),
)
def test_distance_to_a_box_is_the_distance_to_its_nearest_point(position, low, high):
    position, low, high = map(np.array, (position, low, high))
    nearest = np.clip(position, low, high)
    assert distance_to_box(position, low, high) == pytest.approx(np.linalg.norm(position - nearest))
