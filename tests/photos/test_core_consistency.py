"""Outliers: connected parts of photographs that disagree with the others lose their weight, and nothing else does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.imaging.colors import decode_signed_srgb
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.merging import merge
from farfield.addon.core.photos.photographs.consistency import count_cells, rate_photographs
from farfield.addon.core.photos.photographs.photograph import Photograph
from farfield.addon.core.photos.settings import PhotosSettings
from photo_scenes import SIZE, grid, observations, photograph, ring, smooth_texture

FRAME = (320, 240)
POINTS = 20_000

pytestmark = pytest.mark.usefixtures("quick_merges")


def rate(change=None, count=5, visible=None, noise=0.01, seed=0):
    """The trust of photographs that all show the same plane at the same positions, after `change` has painted into them."""
    random = np.random.default_rng(seed)
    positions = random.uniform(0.0, 1.0, (POINTS, 2)) * FRAME
    x, y = positions.T
    truth = 0.5 + 0.2 * np.stack([np.sin(x / 20.0), np.cos(y / 30.0), np.sin((x + y) / 40.0)], axis=1)
    colors = np.clip(truth + random.normal(scale=noise, size=(count, POINTS, 3)), 0.0, 1.0)
    if change is not None:
        change(x, y, colors)
    shown = np.ones((count, POINTS), bool) if visible is None else visible(x, y)
    observed = observations(decode_signed_srgb(colors), shown, np.broadcast_to(positions, (count, POINTS, 2)))
    return run_to_end(rate_photographs(observed, observed.colors, [FRAME] * count))


def cells(condition):
    """Which cells' centers fulfill a condition on x and y."""
    columns, rows = count_cells(FRAME)
    y, x = (np.mgrid[:rows, :columns] + 0.5) / np.array([[[rows]], [[columns]]]) * np.array(FRAME[::-1])[:, None, None]
    return condition(x, y)


def disk(x, y, radius):
    return np.hypot(x - 160.0, y - 120.0) < radius


def paint_disk(x, y, colors):
    colors[2, disk(x, y, 40.0)] = [0.9, 0.1, 0.8]


@settings(max_examples=8)
@given(count=st.integers(1, 6), noise=st.floats(0.0, 0.03), seed=st.integers(0, 2**31))
def test_photographs_that_agree_are_trusted(count, noise, seed):
    assert min(trust.min() for trust in rate(count=count, noise=noise, seed=seed)) > 0.7


@pytest.mark.parametrize("count", [3, *(pytest.param(count, marks=pytest.mark.exhaustive) for count in (5, 8))])
def test_what_one_photograph_shows_loses_its_weight(count):
    trust = rate(paint_disk, count)
    assert (trust[2][cells(lambda x, y: disk(x, y, 38.0))] < 0.1).all()
    assert trust[2][cells(lambda x, y: ~disk(x, y, 55.0))].min() > 0.7
    assert min(each.min() for index, each in enumerate(trust) if index != 2) > 0.7


def test_where_only_two_photographs_overlap_the_surroundings_decide():
    def visible(x, y):
        return np.stack([np.ones(len(x), bool), x < 150.0, np.ones(len(x), bool)])

    trust = rate(paint_disk, 3, visible)
    assert (trust[2][cells(lambda x, y: disk(x, y, 35.0))] < 0.1).all()
    assert trust[0].min() > 0.5


def test_where_only_the_outlier_is_shown_its_surroundings_decide():
    def visible(x, y):
        return np.stack([x < 165.0, x < 165.0, np.ones(len(x), bool)])

    trust = rate(paint_disk, 3, visible)
    assert (trust[2][cells(lambda x, y: disk(x, y, 35.0) & (x < 172.0))] < 0.1).all()
    assert trust[2][cells(lambda x, y: x + 0.0 * y > 240.0)].min() > 0.7


def test_two_photographs_never_reject_each_other():
    def invert(_x, _y, colors):
        colors[1] = 1.0 - colors[1]

    trust = rate(invert, 2)
    assert min(each.min() for each in trust) > 0.3


def test_specks_stay():
    def paint(x, y, colors):
        colors[1, disk(x, y, 3.0)] = 1.0

    assert min(each.min() for each in rate(paint)) > 0.7


def test_without_observations_everything_is_trusted():
    trust = rate(visible=lambda x, _: np.zeros((5, len(x)), bool))
    assert [each.shape for each in trust] == [count_cells(FRAME)[::-1]] * 5 and all((each == 1.0).all() for each in trust)


@pytest.mark.parametrize(
    "method", ["average", pytest.param("best", marks=pytest.mark.exhaustive), pytest.param("paper", marks=pytest.mark.exhaustive)]
)
def test_a_passer_by_does_not_appear_in_the_texture(method):
    mesh, uvs = grid(12)
    texture = smooth_texture(3)
    photographs = [photograph(mesh, uvs, texture, camera) for camera in ring(4)]
    pixels = photographs[1].pixels.copy()
    height, width = pixels.shape[:2]
    pixels[height // 2 - 30 : height // 2 + 30, width // 2 - 10 : width // 2 + 10] = [255, 0, 255]
    photographs[1] = Photograph(photographs[1].camera, pixels)
    result = run_to_end(merge(mesh, uvs, photographs, PhotosSettings(size=SIZE, method=method)))
    assert np.abs(result.colors - texture)[result.source >= 0].max() < 0.06
