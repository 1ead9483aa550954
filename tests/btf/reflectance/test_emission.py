"""Emission is the weighted mean over the views."""

import numpy as np
import pytest

from farfield.addon.core.btf.reflectance.mean_colors import mean_emission


def test_emission_is_the_weighted_mean_over_the_views():
    views = [(np.array([0, 2]), np.float32([[1, 2, 3], [4, 0, 0]])), (np.array([0]), np.float32([[3, 2, 1]]))]
    weights = np.array([[1.0, 1.0, 0.5], [3.0, 1.0, 1.0]])
    np.testing.assert_allclose(mean_emission(views, weights), [[2.5, 2.0, 1.5], [0, 0, 0], [4, 0, 0]])


@pytest.mark.parametrize("radiance", [0.0, 5e-4])
def test_negligible_emission_is_none(radiance):
    assert mean_emission([(np.arange(3), np.full((3, 3), radiance, np.float32))], np.ones((1, 3))) is None
    assert mean_emission([(np.zeros(0, int), np.zeros((0, 3), np.float32))], np.ones((1, 3))) is None
