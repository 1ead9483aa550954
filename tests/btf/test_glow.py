"""What shines by itself: found in materials, averaged over views."""

import numpy as np
import pytest

from farfield.addon.core.btf.glow import mean_glow


def test_it_is_the_mean_over_the_views_by_what_they_count():
    views = [(np.array([0, 2]), np.float32([[1, 2, 3], [4, 0, 0]])), (np.array([0]), np.float32([[3, 2, 1]]))]
    weights = np.array([[1.0, 1.0, 0.5], [3.0, 1.0, 1.0]])
    np.testing.assert_allclose(mean_glow(views, weights), [[2.5, 2.0, 1.5], [0, 0, 0], [4, 0, 0]])


@pytest.mark.parametrize("radiance", [0.0, 5e-4])
def test_where_nothing_shines_there_is_none(radiance):
    assert mean_glow([(np.arange(3), np.full((3, 3), radiance, np.float32))], np.ones((1, 3))) is None
    assert mean_glow([(np.zeros(0, int), np.zeros((0, 3), np.float32))], np.ones((1, 3))) is None
