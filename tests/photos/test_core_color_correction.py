"""Gain, gamma and vignetting of photographs: known ones are found, and photographs that cannot be compared keep their colors."""

import numpy as np
import pytest

from farfield.addon.core.geometry.lenses import Lens
from farfield.addon.core.imaging.colors import decode_signed_srgb, encode_signed_srgb
from farfield.addon.core.photos.photographs.color_correction import ColorCorrection, estimate_corrections, radius_powers
from photo_scenes import observations

LENS = Lens("SIMPLE_PINHOLE", (300, 240), (300.0, 300.0), (140.0, 110.0))
OTHER = Lens("SIMPLE_PINHOLE", (300, 240), (250.0, 250.0), (150.0, 120.0))
POINTS = 3000


def observe(lenses, gains, gammas, vignetting, seed=0, outliers=0.0, noise=0.005):
    """Observations of random colors at random positions, and the true colors (P, 3)."""
    random, count = np.random.default_rng(seed), len(lenses)
    truth = np.exp(random.uniform(np.log(0.06), np.log(0.5), (POINTS, 3)))
    positions = random.uniform(0.0, 1.0, (count, POINTS, 2)) * LENS.size
    linear = np.empty((count, POINTS, 3))
    for index, lens in enumerate(lenses):
        falloff = np.exp(-radius_powers(lens, positions[index], len(vignetting[index])) @ np.array(vignetting[index]))
        linear[index] = (truth * falloff[:, None] / gains[index]) ** (1.0 / gammas[index])
    linear *= np.exp(random.normal(scale=noise, size=linear.shape))
    linear = np.where(random.random((count, POINTS, 1)) < outliers, random.random(linear.shape), linear)
    return observations(linear, random.random((count, POINTS)) < 0.7, positions), truth


def correct(observed, corrections):
    colors = np.empty_like(observed.colors)
    for index, correction in enumerate(corrections):
        own = observed.photographs == index
        colors[own] = correction.apply(observed.colors[own], observed.positions[own])
    return colors


def spread(observed, colors, truth):
    """The typical deviation of logarithms from the truth, after one power and gain per channel for all photographs."""
    usable = (observed.colors.max(axis=1) < 0.95) & (observed.colors.min(axis=1) > 0.2)
    found, expected = np.log(decode_signed_srgb(colors[usable])), np.log(truth[observed.points[usable]])
    differences = [np.abs(np.polyval(np.polyfit(a, b, 1), a) - b) for a, b in zip(found.T, expected.T, strict=True)]
    return float(np.median(differences))


@pytest.mark.parametrize("outliers", [0.0, 0.05])
def test_known_corrections_are_found(outliers):
    random = np.random.default_rng(3)
    lenses = [LENS, LENS, OTHER, OTHER, LENS]
    gains, gammas = np.exp(random.uniform(-0.3, 0.3, (5, 3))), np.array([0.9, 1.1, 1.0, 0.95, 1.05])
    by_lens = {LENS: (0.6, 0.2), OTHER: (0.3, 0.0)}
    observed, _ = observe(lenses, gains, gammas, [by_lens[lens] for lens in lenses], outliers=outliers)
    found = estimate_corrections(observed, lenses, has_gamma=True, has_vignetting=True)
    assert [each.gamma for each in found] == pytest.approx(gammas, abs=0.03)
    radii = radius_powers(LENS, np.array([[140.0, 130.0], [200.0, 200.0], [10.0, 230.0]]), 2)
    for each, lens in zip(found, lenses, strict=True):
        assert radii @ np.array(each.vignetting) == pytest.approx(radii @ np.array(by_lens[lens]), abs=0.06)


def test_photographs_agree_after_the_correction():
    random = np.random.default_rng(4)
    gains, gammas = np.exp(random.uniform(-0.3, 0.3, (5, 3))), random.uniform(0.88, 1.12, 5)
    observed, truth = observe([LENS] * 5, gains, gammas / gammas.mean(), [(0.5, 0.1)] * 5)
    both, only_gain = (estimate_corrections(observed, [LENS] * 5, has_gamma=used, has_vignetting=used) for used in (True, False))
    assert spread(observed, correct(observed, both), truth) < 0.02 < 0.04 < spread(observed, correct(observed, only_gain), truth)


@pytest.mark.parametrize(("has_gamma", "has_vignetting"), [(True, False), (False, True), (True, True)])
def test_photographs_without_gamma_and_vignetting_are_not_given_any(has_gamma, has_vignetting):
    gains = np.exp(np.random.default_rng(1).uniform(-0.3, 0.3, (4, 3)))
    observed, _ = observe([LENS] * 4, gains, np.ones(4), [(0.0, 0.0)] * 4)
    found = estimate_corrections(observed, [LENS] * 4, has_gamma=has_gamma, has_vignetting=has_vignetting)
    assert np.array([each.gamma for each in found]) == pytest.approx(1.0, abs=0.01)
    assert all(abs(sum(each.vignetting)) < 0.02 for each in found)
    product = np.array([each.gain for each in found]) / gains
    assert product == pytest.approx(np.broadcast_to(product.mean(axis=0), product.shape), rel=0.02)


def test_photographs_without_overlap_keep_their_colors():
    linear, visible = np.random.default_rng(0).uniform(0.1, 0.5, (2, 40, 3)), np.zeros((2, 40), bool)
    visible[0, :20], visible[1, 20:] = True, True
    positions = np.random.default_rng(1).uniform(0.0, 240.0, (2, 40, 2))
    observed = observations(linear, visible, positions)
    found = estimate_corrections(observed, [LENS, OTHER], has_gamma=True, has_vignetting=True)
    assert correct(observed, found) == pytest.approx(observed.colors, abs=1e-3)
    none = observations(linear, np.zeros((2, 40), bool), positions)
    for each in estimate_corrections(none, [LENS, OTHER], has_gamma=True, has_vignetting=True):
        assert each.gain == pytest.approx(1.0) and each.gamma == 1.0


def test_corrections_are_what_they_say():
    random = np.random.default_rng(2)
    encoded = random.uniform(-0.1, 1.2, (500, 3)).astype(np.float32)
    positions = random.uniform(0.0, 240.0, (500, 2)).astype(np.float32)
    correction = ColorCorrection(LENS, np.array([1.2, 0.9, 1.0]), 1.1, (0.3, 0.1))
    linear = decode_signed_srgb(encoded)
    radius = np.hypot(positions[:, 0] - 140.0, positions[:, 1] - (240.0 - 110.0)) / np.hypot(150.0, 120.0)
    factor = np.exp(0.3 * radius**2 + 0.1 * radius**4)[:, None]
    expected = encode_signed_srgb(np.copysign(np.abs(linear) ** 1.1, linear) * correction.gain * factor)
    assert correction.apply(encoded, positions) == pytest.approx(expected, abs=2e-3)
