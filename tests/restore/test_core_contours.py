"""Contours that continue in a hole, completion by patches, and the choice between copies and fills."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from farfield.addon.core.imaging.diffusion import diffuse
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.restore.contours import join_contours
from farfield.addon.core.restore.guidance import build_guide, describe_page
from farfield.addon.core.restore.levels import Page, build_levels
from farfield.addon.core.restore.restoration import restore
from farfield.addon.core.restore.settings import RestoreSettings
from farfield.addon.core.restore.voting import complete

SIZE = 120
Y, X = np.mgrid[:SIZE, :SIZE].astype(np.float32)
HOLE = np.hypot(Y - 60, X - 60) < 18
BLUE, ORANGE, GREEN = (np.array(color, np.float32) for color in ((0.2, 0.3, 0.7), (0.9, 0.6, 0.2), (0.3, 0.7, 0.3)))


def paint(distance, inner=ORANGE, outer=BLUE):
    """An image (SIZE, SIZE, 3) with two colors where a signed distance is negative and positive, antialiased."""
    weight = np.clip(0.5 - distance, 0.0, 1.0)[..., None]
    return (weight * inner + (1.0 - weight) * outer).astype(np.float32)


def make_page(image, hole=HOLE, wrap=(False, False)):
    """A page whose hole is filled smoothly."""
    return Page(diffuse(np.where(hole[..., None], np.float32(0.0), image), hole, None, wrap), hole, ~hole, ~hole, wrap)


OUTLINES = {
    "line": 0.4 * (X - 60) - 0.9 * (Y - 62),
    "circle": np.hypot(Y - 60, X - 20) - 41.0,
    "near the border of the hole": np.hypot(Y - 60, X - 110) - 40.0,
}


class TestContours:
    """Ends of edges at a hole, and the curves that join them."""

    @pytest.mark.slow
    @pytest.mark.parametrize("name", OUTLINES)
    def test_an_outline_continues(self, name):
        image = paint(OUTLINES[name])
        curve = join_contours(make_page(image).texture, HOLE, ~HOLE)
        crossing = (np.abs(OUTLINES[name]) < 0.5) & HOLE
        assert np.abs(OUTLINES[name][curve & HOLE]).max() < 3.0
        assert (curve & HOLE).sum() > 0.7 * crossing.sum()
        restored = run_to_end(restore(image, HOLE, RestoreSettings())).pixels
        wrong = np.linalg.norm(restored - image, axis=2)[HOLE] > 0.4
        assert wrong.mean() < 0.06, "the colors on both sides stay where they belong"

    def test_an_edge_that_fades_has_no_counterpart(self):
        fading = np.clip((X - 50.0) / 20.0, 0.0, 1.0)[..., None] * (ORANGE - BLUE) + BLUE
        image = np.where((Y < 60)[..., None], ORANGE, fading).astype(np.float32)
        assert not join_contours(make_page(image).texture, HOLE, ~HOLE).any()

    def test_texture_without_outlines_has_no_curves(self):
        image = gaussian_filter(np.random.default_rng(2).random((SIZE, SIZE, 3), np.float32), (1, 1, 0))
        assert not join_contours(make_page(image).texture, HOLE, ~HOLE).any()


class TestPatches:
    """Completion by overlapping patches."""

    @pytest.mark.parametrize("wrap", [pytest.param((False, False), marks=pytest.mark.exhaustive), (True, True)])
    def test_a_periodic_pattern_is_completed(self, wrap):
        image = np.tile(gaussian_filter(np.random.default_rng(1).random((12, 15, 3), np.float32), (1, 1, 0), mode="wrap"), (10, 8, 1))
        hole = np.roll(HOLE, (60, 60), (0, 1)) if wrap[0] else HOLE
        completed = run_to_end(complete(make_page(image, hole, wrap).texture, make_page(image, hole, wrap), 0))
        error = np.sqrt(np.square(completed - image)[hole].mean())
        assert error < 0.35 * image.std()
        assert np.array_equal(completed[np.hypot(Y - 60, X - 60) > 25], image[np.hypot(Y - 60, X - 60) > 25]) or wrap[0]

    def test_without_sources_the_estimate_stays(self):
        page = make_page(paint(OUTLINES["line"]))
        unusable = Page(page.texture, page.hole, page.known, np.zeros_like(HOLE))
        assert np.array_equal(run_to_end(complete(page.texture, unusable, 0)), page.texture)

    def test_equal_seeds_give_equal_values(self):
        page = make_page(np.random.default_rng(4).random((SIZE, SIZE, 1), np.float32))
        assert np.array_equal(run_to_end(complete(page.texture, page, 5)), run_to_end(complete(page.texture, page, 5)))


class TestGuide:
    """What copies and fills cost."""

    def build(self, image):
        page = make_page(image)
        nothing = np.zeros_like(HOLE)
        pages = [page, Page(page.texture, nothing, ~nothing, nothing)]
        level = build_levels(pages, 1)[0]
        return level, build_guide(level, pages, [describe_page(page, nothing)], [[1]]), np.flatnonzero(level.hole)

    def test_a_smooth_fill_costs_the_contrast_that_it_lacks_where_texture_is_even(self):
        random = np.random.default_rng(3)
        noise = random.random((SIZE, SIZE, 3), np.float32)
        blocks = np.kron(random.random((5, 5, 1)) < 0.4, np.ones((24, 24, 1)))
        uneven = (np.float32(0.5) + (noise - np.float32(0.5)) * blocks).astype(np.float32)
        costs = []
        for image in (noise, uneven, np.full_like(noise, 0.5)):
            _, guide, pixels = self.build(image)
            costs.append(float(guide.costs(pixels, pixels + guide.fills[0][0], 1.0).mean()))
        assert costs[0] > 4.0 * costs[1] and costs[2] == pytest.approx(0.0, abs=1e-4)

    def test_copies_of_another_color_cost_more(self):
        image = paint(X - 108)
        level, guide, pixels = self.build(image)
        same, other = (guide.costs(pixels, np.full(len(pixels), 20 * level.shape[1] + column), 1.0) for column in (20, 117))
        assert same.max() == pytest.approx(0.0, abs=1e-3) and other.min() > 0.1


@pytest.mark.slow
def test_progress_of_a_completion_grows():
    steps = []
    run_to_end(restore(paint(X - 60.0), HOLE, RestoreSettings(), source_mask=None), steps.append)
    fractions = [step.fraction for step in steps]
    assert fractions == sorted(fractions)
    assert len({step.fraction for step in steps if step.label == "Completing objects"}) > 10
