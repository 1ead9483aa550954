"""The outline of a mask surrounds exactly its pixels."""

import numpy as np
import pytest

from farfield.addon.bridge.restore import outline
from farfield.addon.bridge.restore.outline import find_segments


def rasterize_outline(segments, height, width):
    """Fill by the even-odd rule: a pixel is inside if a ray from its center to the left crosses an odd number of vertical segments."""
    mask = np.zeros((height, width), bool)
    for (x0, y0), (x1, y1) in segments * [width, height]:
        if x0 == x1:
            rows = slice(*sorted((round(y0), round(y1))))
            mask[rows, round(x0) :] ^= True
    return mask


@pytest.mark.parametrize("size", [(1, 1), (5, 9), (40, 23)])
def test_the_outline_encloses_the_mask(size):
    random = np.random.default_rng(1)
    for fraction in (0.0, 0.1, 0.5, 0.9, 1.0):
        mask = random.random(size) < fraction
        segments = find_segments(mask)
        assert np.array_equal(rasterize_outline(segments, *size), mask)
        lengths = np.abs((segments[:, 1] - segments[:, 0]) * size[::-1]).sum()
        edges = sum(np.abs(np.diff(np.pad(mask, 1).astype(int), axis=axis)).sum() for axis in (0, 1))
        assert lengths == pytest.approx(edges, rel=1e-5), "every edge once"


def test_straight_edges_are_one_segment():
    mask = np.zeros((10, 20), bool)
    mask[2:5, 3:9] = True
    corners = {(3 / 20, 2 / 10), (9 / 20, 2 / 10), (3 / 20, 5 / 10), (9 / 20, 5 / 10)}
    segments = find_segments(mask)
    assert len(segments) == 4
    assert {tuple(np.round(end, 6)) for end in segments.reshape(-1, 2).astype(float)} == {tuple(np.round(end, 6)) for end in corners}


def test_noise_is_drawn_more_coarsely(monkeypatch):
    monkeypatch.setattr(outline, "MAX_EDGES", 500)
    mask = np.random.default_rng(2).random((101, 67)) < 0.5
    segments = find_segments(mask)
    assert 0 < len(segments) <= 500 and segments.min() >= 0.0 and segments.max() <= 1.0
