"""Positions relative to an origin keep their accuracy in single precision."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.geometry.transforms import choose_origin

COORDINATES = st.lists(st.floats(-1e9, 1e9), min_size=3, max_size=3).map(np.array)


@given(viewer=COORDINATES)
def test_the_viewer_is_near_the_origin(viewer):
    origin = choose_origin(viewer, 64.0, 1e4)
    assert (np.abs(viewer - origin) <= 1e4).all() and not (origin % 64.0).any()


@given(viewer=COORDINATES)
def test_it_is_zero_near_zero(viewer):
    assert choose_origin(viewer / 1e6, 64.0, 1e4).tolist() == [0.0, 0.0, 0.0]
