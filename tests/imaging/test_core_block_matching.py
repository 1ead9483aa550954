"""Block matching: known displacements come back, and nothing is found where there is nothing to match."""

import itertools

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from farfield.addon.core.imaging.block_matching import match_blocks

SHAPE = (256, 320)
EVERYWHERE = np.ones(SHAPE, bool)


def details(deviation=2.0, seed=0):
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=SHAPE), deviation, mode="wrap")
    return (0.5 + 0.1 * noise / noise.std()).astype(np.float32)


def shifted(image, x, y):
    """The image whose content lies `x`, `y` pixels farther."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return map_coordinates(image, (rows - y, columns - x), np.float32, 3, "grid-wrap")


def shifts():
    """Details of each size and shifts of each length, each in one combination that always runs."""
    lengths, sizes = [(0.0, 0.0), (0.37, -0.81), (-7.3, 4.6), (19.5, -22.2)], [1.0, 3.0, 8.0]
    for (row, (x, y)), (column, deviation) in itertools.product(enumerate(lengths), enumerate(sizes)):
        yield pytest.param(x, y, deviation, marks=() if row % len(sizes) == column else pytest.mark.exhaustive)


@pytest.mark.slow
@pytest.mark.parametrize(("x", "y", "deviation"), list(shifts()))
def test_a_shift_is_found_to_a_fraction_of_a_pixel(x, y, deviation):
    image = details(deviation)
    found = match_blocks(image, shifted(image, x, y), EVERYWHERE, EVERYWHERE)
    errors = np.linalg.norm(found.displacements - (x, y), axis=1)
    assert len(errors) > 30 and errors.mean() < 0.05 and errors.max() < 0.3 and (found.confidences > 0.9).all()


def test_a_smooth_warp_is_found_at_each_block():
    image = details()
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    x, y = 4.0 * np.sin(rows / 80.0), 3.0 * np.cos(columns / 100.0)
    reference = map_coordinates(image, (rows + y, columns + x), np.float32, 3, "grid-wrap")
    found = match_blocks(reference, image, EVERYWHERE, EVERYWHERE)
    columns, rows = (found.centers - 0.5).astype(int).T
    inside = (rows < SHAPE[0]) & (columns < SHAPE[1])
    expected = np.stack([x, y], axis=-1)[rows[inside], columns[inside]]
    assert inside.sum() > 30 and np.linalg.norm(found.displacements[inside] - expected, axis=1).mean() < 0.1


def test_brightness_and_noise_do_not_matter():
    image, random = details(), np.random.default_rng(3)
    darker = 0.1 + 0.5 * shifted(image, 5.0, -3.0) + 0.01 * random.normal(size=SHAPE).astype(np.float32)
    found = match_blocks(image, darker, EVERYWHERE, EVERYWHERE)
    assert np.linalg.norm(found.displacements - (5.0, -3.0), axis=1).mean() < 0.1


@pytest.mark.parametrize("noise", [0.0, 0.004])
def test_nothing_is_found_in_uniform_images(noise):
    random = np.random.default_rng(1)
    first, second = (np.rint(255.0 * (0.5 + noise * random.normal(size=SHAPE))).astype(np.float32) / 255.0 for _ in range(2))
    assert not len(match_blocks(first, second, EVERYWHERE, EVERYWHERE).centers)


def test_stripes_have_no_certain_displacement():
    """A shift along them, or by their distance, changes nothing; only the corners of the image may seem to be certain."""
    columns = np.broadcast_to(np.arange(SHAPE[1]), SHAPE)
    stripes = (0.5 + 0.2 * np.sin(2.0 * np.pi * columns / 8.0)).astype(np.float32)
    assert len(match_blocks(stripes, stripes, EVERYWHERE, EVERYWHERE).centers) <= 4


def test_unknown_pixels_have_no_influence():
    image = details()
    moved, known = shifted(image, 6.0, 2.0), np.ones(SHAPE, bool)
    known[:, 150:] = False
    moved[:, 170:] = details(seed=9)[:, 170:]
    found = match_blocks(np.where(known, image, 0.0).astype(np.float32), moved, known, EVERYWHERE)
    assert len(found.centers) >= 20 and found.centers[:, 0].max() < 190
    assert np.linalg.norm(found.displacements - (6.0, 2.0), axis=1).mean() < 0.1
    assert not len(match_blocks(image, moved, np.zeros(SHAPE, bool), EVERYWHERE).centers)
