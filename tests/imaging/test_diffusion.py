"""Diffusion solves the Laplace equation: harmonic functions are reproduced, values stay within range, barriers separate."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from farfield.addon.core.imaging import grid_solver
from farfield.addon.core.imaging.diffusion import diffuse

SIZE = 40


def disk(radius=12.0, size=SIZE):
    y, x = np.mgrid[:size, :size] - 0.5 * (size - 1)
    return np.hypot(x, y) < radius


def harmonic_images(size=SIZE):
    y, x = np.mgrid[:size, :size].astype(np.float32) / size
    return np.stack([x, y, x * x - y * y, x * y, np.ones_like(x)], axis=2)


@pytest.mark.parametrize("is_direct", [True, False])
def test_harmonic_functions_are_reproduced(monkeypatch, is_direct):
    if not is_direct:
        monkeypatch.setattr(grid_solver, "MAX_DIRECT_UNKNOWNS", 10)
    image, mask = harmonic_images(100), disk(40.0, 100)
    damaged = np.where(mask[..., None], np.float32(1e6), image)
    assert np.abs(diffuse(damaged, mask) - image).max() < 1e-5


def test_known_pixels_do_not_change():
    image = np.random.default_rng(1).random((SIZE, SIZE, 3), np.float32)
    mask = disk()
    assert (diffuse(image, mask)[~mask] == image[~mask]).all()


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.floats(0.05, 0.9))
def test_missing_pixels_are_within_the_range_of_known_ones(seed, fraction):
    random = np.random.default_rng(seed)
    image, mask = random.normal(size=(12, 17, 1)).astype(np.float32), random.random((12, 17)) < fraction
    mask[0, 0] = False
    result, known = diffuse(image, mask), image[~mask]
    assert result.min() >= known.min() - 1e-5 and result.max() <= known.max() + 1e-5


def test_everything_missing_stays_as_it_is():
    image = np.random.default_rng(2).random((6, 6, 1), np.float32)
    assert (diffuse(image, np.ones((6, 6), bool)) == image).all()


def test_values_do_not_cross_barriers():
    image = np.zeros((SIZE, SIZE, 1), np.float32)
    image[:, SIZE // 2 :] = 1.0
    barriers = np.zeros((SIZE, SIZE), bool)
    barriers[:, SIZE // 2] = True
    result = diffuse(image, disk(), barriers)
    assert result[:, : SIZE // 2].max() == pytest.approx(0.0, abs=1e-6)
    assert result[:, SIZE // 2 + 1 :].min() == pytest.approx(1.0, abs=1e-6)
    on_barrier = result[:, SIZE // 2][disk()[:, SIZE // 2]]
    assert ((on_barrier > 0.4) & (on_barrier <= 1.0)).all()
    assert 0.01 < diffuse(image, disk())[SIZE // 2, SIZE // 2 - 4, 0] < 0.5  # without the barrier they do


def test_a_region_enclosed_by_barriers_is_filled_from_outside():
    mask = disk()
    barriers = mask & ~disk(10.0)
    result = diffuse(np.where(mask[..., None], np.float32(9.0), np.float32(0.25)), mask, barriers)
    assert np.allclose(result, 0.25, atol=1e-5)


@settings(max_examples=50)
@example(51, 0.9375, 0.25, True)  # a region that barriers enclose touches another one across the border
@given(st.integers(0, 2**31), st.floats(0.05, 0.95), st.floats(0.05, 0.95), st.booleans())
def test_any_barriers_leave_values_within_range(seed, missing, blocked, wraps):
    random = np.random.default_rng(seed)
    image = random.random((9, 11, 1), np.float32)
    mask, barriers = random.random((9, 11)) < missing, random.random((9, 11)) < blocked
    mask[0, 0] = False
    result, known = diffuse(image, mask, barriers, (wraps, wraps)), image[~mask]
    assert np.isfinite(result).all() and (result[~mask] == known).all()
    assert result.min() >= known.min() - 1e-5 and result.max() <= known.max() + 1e-5


@pytest.mark.parametrize("axis", [0, 1])
def test_wrapped_borders_are_neighbors(axis):
    random = np.random.default_rng(3)
    image, mask = random.random((20, 24, 2), np.float32), np.zeros((20, 24), bool)
    mask[5:12, 7:15] = True
    wrap = (axis == 0, axis == 1)
    half = image.shape[axis] // 2
    moved = diffuse(np.roll(image, half, axis), np.roll(mask, half, axis), wrap=wrap)
    assert np.allclose(np.roll(moved, -half, axis), diffuse(image, mask, wrap=wrap), atol=1e-5)
