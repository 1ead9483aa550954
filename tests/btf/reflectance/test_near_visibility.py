"""Near visibility: ratios of the irradiance of the source to that of the cloud."""

import numpy as np
import pytest

from farfield.addon.core.btf.refinement.fragments import Fragments
from farfield.addon.core.btf.reflectance.near_visibility import fit_near_visibility, receive_light
from farfield.addon.core.jobs.progress import run_to_end


def constant(value: float, weight: float = 1.0):
    """A reader that returns the same irradiance for both sides of three texels from all views."""
    return lambda _view: (np.full((2, 3), value * weight), np.full((2, 3), weight))


def test_leaves_that_the_source_shades_twice_as_much_are_half_as_bright():
    visibility = run_to_end(fit_near_visibility(4, constant(0.4), constant(0.8)))
    assert visibility.shape == (2, 3) and visibility.dtype == np.float32
    np.testing.assert_allclose(visibility, 0.5, rtol=1e-5)


def test_equal_irradiance_changes_nothing_and_colors_do_not_grow():
    assert run_to_end(fit_near_visibility(3, constant(0.3), constant(0.3))) == pytest.approx(1.0)
    assert run_to_end(fit_near_visibility(3, constant(0.9), constant(0.3))).max() <= 1.0


def test_noise_does_not_darken_the_level():
    random = np.random.default_rng(1)
    cloud = random.uniform(0.2, 0.8, (2, 4000))
    source = 0.8 * cloud * random.uniform(0.2, 1.8, cloud.shape)
    weights = np.ones_like(cloud)
    visibility = run_to_end(fit_near_visibility(2, lambda _view: (source, weights), lambda _view: (cloud, weights)))
    assert (visibility * cloud).sum() == pytest.approx(source.sum(), rel=0.01) and visibility.max() <= 1.0
    assert np.corrcoef(visibility.ravel(), (source / cloud).ravel())[0, 1] > 0.9


def test_texels_that_nothing_sees_stay_as_they_are():
    np.testing.assert_array_equal(run_to_end(fit_near_visibility(2, constant(0.1, 0.0), constant(0.9))), 1.0)


def test_quads_receive_what_those_in_front_of_them_let_through():
    taps = np.array([[0, 0, 0, 0], [1, 0, 0, 0], [2, 0, 0, 0]], np.int32)
    weights = np.array([[1.0, 0.0, 0.0, 0.0]] * 3, np.float32)
    fragments = Fragments(1, np.zeros(3, np.int32), taps, weights)
    light, weight = receive_light(fragments, np.array([0.25, 0.5, 1.0]))
    np.testing.assert_allclose(light / weight, [1.0, 0.75, 0.375], rtol=1e-5)
