"""Copies of regions: shifts that continue the surroundings, seams of least cost, and patches distributed as in the source."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.restore import guidance, regions, texture
from farfield.addon.core.restore.guidance import Guide, build_guide, describe_page
from farfield.addon.core.restore.labeling import Candidate, Labeling, measure_contrast
from farfield.addon.core.restore.levels import Page, build_levels
from farfield.addon.core.restore.regions import PatchStatistics
from farfield.addon.core.restore.settings import RestoreSettings
from farfield.addon.core.restore.shifts import Surroundings, find_shifts
from farfield.addon.core.restore.texture import fill_texture


def disk(shape, radius, center=None):
    y, x = np.mgrid[: shape[0], : shape[1]]
    row, column = center or (shape[0] // 2, shape[1] // 2)
    return np.hypot(y - row, x - column) < radius


def build_level(image, hole, wrap=(False, False)):
    page = Page(np.where(hole[..., None], np.float32(0.0), image), hole, ~hole, ~hole, wrap)
    return page, build_levels([page], 1)[0]


def neutral_guide(level):
    """A guide for which all copies cost nothing, without fills."""
    size = level.hole.size
    values = np.zeros(size, np.float32)
    return Guide(np.zeros((size, 1), np.float32), values, values, values, [[] for _ in level.tops], [False for _ in level.tops])


def seam_cost(level, pixels, sources):
    """The sum that labeling minimizes, written as loops over all pairs of neighbors."""
    source_of = dict(zip(pixels.tolist(), sources.tolist(), strict=True))
    total, width, contrast = 0.0, level.shape[1], measure_contrast(level)

    def difference(first, second):
        return float(np.linalg.norm(level.texture[first] - level.texture[second]))

    for pixel, source in source_of.items():
        for offset in (1, width, -1, -width):
            other = source_of.get(pixel + offset)
            if other is None:
                known = pixel + offset
                total += 2.0 * 2.0 * difference(source + offset, known) / (contrast[source + offset] + contrast[known])
            elif offset > 0:
                both = difference(source, other - offset) + difference(source + offset, other)
                total += 2.0 * both / (contrast[source] + contrast[other])
    return total


class TestShifts:
    """Candidates for what to copy."""

    def test_a_periodic_texture_is_shifted_by_its_periods(self):
        tile = np.random.default_rng(1).random((12, 15, 2), np.float32)
        image, hole = np.tile(tile, (9, 8, 1)), disk((108, 120), 16)
        _, level = build_level(image, hole)
        size = hole.shape
        valid = level.valid.reshape(level.shape)[: size[0], : size[1]]
        found = find_shifts(Surroundings(level.page(0), hole, ~hole, valid, (False, False)), 1, np.random.default_rng(0))[0]
        best = [shift.step for shift in found if all(step % period == 0 for step, period in zip(shift.step, (12, 15), strict=True))]
        assert len(best) >= 4

    def test_attempts_differ(self):
        image, hole = np.random.default_rng(2).random((90, 100, 1), np.float32), disk((90, 100), 12)
        _, level = build_level(image, hole)
        valid = level.valid.reshape(level.shape)[: hole.shape[0], : hole.shape[1]]
        first, second = find_shifts(Surroundings(level.page(0), hole, ~hole, valid, (False, False)), 2, np.random.default_rng(0))
        assert set(first) != set(second)

    def test_nothing_is_found_without_a_source(self):
        image, hole = np.zeros((40, 40, 1), np.float32), disk((40, 40), 8)
        none = np.zeros(hole.shape, bool)
        assert find_shifts(Surroundings(image, hole, ~hole, none, (False, False)), 2, np.random.default_rng(0)) == [[], []]


class TestLabeling:
    """Seams between regions."""

    def prepare(self, seed, radius=7):
        random = np.random.default_rng(seed)
        image = gaussian_filter(random.random((60, 70, 2)), (1.5, 1.5, 0)).astype(np.float32)
        hole = disk((60, 70), radius)
        _, level = build_level(image, hole)
        pixels = np.flatnonzero(level.hole)
        everything = np.arange(len(pixels))
        offsets = [level.offset(np.array(step)) for step in ((20, 5), (-19, 8), (4, 25), (-6, -22), (18, -20))]
        return level, pixels, [Candidate(everything, pixels + offset) for offset in offsets]

    @pytest.mark.parametrize("seed", range(4))
    def test_seams_cost_less_than_any_single_region_and_single_pixels_do_not_help(self, seed):
        level, pixels, candidates = self.prepare(seed)
        labeling = Labeling(level, measure_contrast(level), neutral_guide(level), pixels, candidates)
        labeling.optimize_blocks()
        in_blocks = seam_cost(level, pixels, labeling.sources)
        labeling.optimize_seams()
        cost = seam_cost(level, pixels, labeling.sources)
        assert cost <= in_blocks <= min(seam_cost(level, pixels, each.sources) for each in candidates)

    def test_one_candidate_is_taken(self):
        level, pixels, candidates = self.prepare(5)
        labeling = Labeling(level, measure_contrast(level), neutral_guide(level), pixels, candidates[:1])
        labeling.optimize_blocks()
        labeling.optimize_seams()
        assert (labeling.sources == candidates[0].sources).all()

    def test_the_region_that_continues_the_image_exactly_wins(self):
        tile = np.random.default_rng(3).random((20, 20, 1), np.float32)
        image, hole = np.tile(tile, (5, 5, 1)), disk((100, 100), 9)
        _, level = build_level(image, hole)
        pixels = np.flatnonzero(level.hole)
        everything = np.arange(len(pixels))
        candidates = [Candidate(everything, pixels + level.offset(np.array(step))) for step in ((31, 7), (-20, 20), (9, -33))]
        labeling = Labeling(level, measure_contrast(level), neutral_guide(level), pixels, candidates)
        labeling.optimize_blocks()
        assert (labeling.sources == candidates[1].sources).all()

    @pytest.mark.parametrize("seed", range(2))
    def test_the_cost_is_the_sum_of_all_seams(self, seed):
        level, pixels, candidates = self.prepare(seed)
        labeling = Labeling(level, measure_contrast(level), None, pixels, candidates)
        labeling.optimize_blocks()
        assert labeling.cost(neutral_guide(level)) == pytest.approx(seam_cost(level, pixels, labeling.sources), rel=1e-4)


@pytest.mark.parametrize(("ratio", "are_copies"), [(1.2, [False, True, False, True]), (1.5, [False, False, False, False])])
def test_copies_alone_are_attempts_where_they_cost_about_as_little_as_a_fill(ratio, are_copies):
    """A texture that repeats and a fill continue it exactly: copies cost `ratio` times as much by the guide."""
    tile = np.random.default_rng(3).random((20, 20, 1), np.float32)
    image, hole = np.tile(tile, (5, 5, 1)), disk((100, 100), 9)
    page, _ = build_level(image, hole)
    nothing = np.zeros_like(hole)
    level = build_levels([page, Page(image, nothing, ~nothing, nothing)], 1)[0]
    pixels, offset = np.flatnonzero(level.hole), int(level.tops[1]) * level.shape[1]
    everything, deviation = np.arange(len(pixels)), np.sqrt(level.texture[level.valid].var())
    fill, copy = Candidate(everything, pixels + offset), Candidate(everything, pixels + level.offset(np.array((-20, 20))))
    zeros = np.zeros(level.hole.size, np.float32)
    lacks = np.where(np.arange(len(zeros)) >= offset, guidance.COLOR_WEIGHT * deviation, zeros)
    colors = (guidance.COLOR_TOLERANCE + ratio) * level.valid[:, None].astype(np.float32)
    guide = Guide(colors, zeros, zeros + 1.0, lacks, [[offset], []], [False, False])
    attempts = list(regions.make_attempts(level, measure_contrast(level), guide, pixels, [[copy]] * 4, [fill]))
    assert [(each.sources == copy.sources).all() for each in attempts] == are_copies
    assert all((each.sources == fill.sources).all() != is_copy for each, is_copy in zip(attempts, are_copies, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(("half_width", "fill_count", "is_shallow"), [(9, 2, True), (9, 1, False), (14, 2, False)])
def test_a_shallow_hole_takes_its_fill_by_patches_and_others_may_copy(half_width, fill_count, is_shallow):
    image, hole = np.random.default_rng(2).random((96, 96, 1), np.float32), np.zeros((96, 96), bool)
    hole[48 - half_width : 48 + half_width, 8:88] = True
    page, _ = build_level(image, hole)
    nothing = np.zeros_like(hole)
    values = [0.0, 0.1][-fill_count:]
    pages = [page, *(Page(np.full_like(image, value), nothing, ~nothing, nothing) for value in values)]
    level = build_levels(pages, 1)[0]
    guide = build_guide(level, pages, [describe_page(page, nothing)], [list(range(1, fill_count + 1))])
    run_to_end(regions.copy_regions(level, guide, 0))
    filled = level.page(0)[hole]
    assert level.filled[level.hole].all()
    assert np.allclose(filled, 0.1) == is_shallow


def test_bricks_are_texture_and_objects_are_not():
    """Bricks with rough joints are uneven up close and even in a wide view; one rough object on flat ground is uneven in both views."""
    y, x = np.mgrid[:200, :200]
    is_joint = (y % 20 < 5) | ((x + 15 * (y // 20 % 2)) % 30 < 5)
    noise, hole = 0.3 * np.random.default_rng(9).standard_normal((200, 200, 1)).astype(np.float32), disk((200, 200), 10)
    evenness = []
    for is_rough in (is_joint, disk((200, 200), 30, (100, 70))):
        page, _ = build_level(noise * is_rough[..., None], hole)
        evenness.append(describe_page(page, np.zeros_like(hole)).evenness[hole].min())
    assert evenness[0] > 0.9 and evenness[1] < 0.5


def test_smooth_parts_do_not_fill_other_textures():
    """A texture next to a calm one, whose differences from anything are small. Without regard to contrast all copies come from there."""
    random = np.random.default_rng(3)
    image = gaussian_filter(random.random((90, 180, 1)), (1, 1, 0)).astype(np.float32)
    image[:, :90] = 0.5 + 0.15 * (image[:, :90] - 0.5)
    hole = disk((90, 180), 20, (45, 135))
    page, level = build_level(image, hole)
    run_to_end(fill_texture([page], [level], neutral_guide(level), RestoreSettings(pyramid_levels=1)))
    assert (level.source[level.hole] % level.shape[1] >= 90).mean() > 0.4


class TestStatistics:
    """Distances between distributions of patches."""

    def test_equal_patches_have_no_distance_and_other_contrast_has(self):
        image = np.random.default_rng(4).random((80, 160, 3), np.float32)
        image[:, 80:] = 0.5 + 0.2 * (image[:, 80:] - 0.5)
        _, level = build_level(image, disk((80, 160), 3, (5, 5)))
        random = np.random.default_rng(0)
        statistics = PatchStatistics(level, random)
        valid = level.valid.reshape(level.shape)[:80]
        column = np.arange(level.shape[1])[None]
        parts = [np.flatnonzero((valid & where).ravel()) for where in (column < 40, (column > 42) & (column < 78), column > 82)]
        first, second, other = (statistics.histograms(part, random) for part in parts)
        assert statistics.distance(first, first) == 0.0
        assert statistics.distance(first, other) > 5.0 * statistics.distance(first, second) > 0.0


class TestFilling:
    """Whole holes."""

    @pytest.mark.slow
    def test_a_deep_hole_is_filled_in_bands_without_a_gap(self, monkeypatch):
        monkeypatch.setattr(regions, "BAND", 12)
        random = np.random.default_rng(6)
        image, hole = gaussian_filter(random.random((140, 150, 1)), (1, 1, 0)).astype(np.float32), disk((140, 150), 30)
        page, level = build_level(image, hole)
        run_to_end(fill_texture([page], [level], neutral_guide(level), RestoreSettings(pyramid_levels=1)))
        sources = level.source[level.hole]
        assert (sources >= 0).all() and level.valid[sources].all() and not level.hole[sources].any()
        assert level.texture[level.hole].std() == pytest.approx(image[~hole].std(), rel=0.2)

    def test_pixels_fill_what_no_region_reaches(self, monkeypatch):
        """Only a strip may be copied, which is narrower than the hole."""
        random = np.random.default_rng(7)
        image, hole = random.random((70, 160, 2), np.float32), disk((70, 160), 24, (35, 50))
        usable = np.zeros(hole.shape, bool)
        usable[:, 140:152] = True
        page = Page(np.where(hole[..., None], np.float32(0.0), image), hole, ~hole, usable)
        levels = build_levels([page], 1)
        found = []
        original = texture.synthesize
        monkeypatch.setattr(
            texture, "synthesize", lambda *arguments: found.append(levels[0].hole & ~levels[0].filled) or original(*arguments)
        )
        run_to_end(fill_texture([page], levels, neutral_guide(levels[0]), RestoreSettings(pyramid_levels=1)))
        sources = levels[0].source[levels[0].hole]
        assert found and found[0].any() and levels[0].valid[sources].all()

    @pytest.mark.slow
    @pytest.mark.parametrize("count", [pytest.param(1, marks=pytest.mark.exhaustive), 12])
    def test_holes_of_a_texture_keep_its_distribution(self, count):
        random = np.random.default_rng(8)
        image = gaussian_filter(random.random((130, 140, 1)), (0.8, 2.5, 0)).astype(np.float32)
        hole = np.zeros(image.shape[:2], bool)
        for row, column in random.integers(20, 110, (count, 2)):
            hole |= disk(hole.shape, 25 if count == 1 else 5, (row, column))
        page, level = build_level(image, hole)
        run_to_end(fill_texture([page], [level], neutral_guide(level), RestoreSettings(pyramid_levels=1)))
        gradients = [np.diff(level.page(0)[..., 0], axis=axis) for axis in (0, 1)]
        expected = [np.diff(image[..., 0], axis=axis) for axis in (0, 1)]
        for found, true, inside in zip(gradients, expected, (hole[1:], hole[:, 1:]), strict=True):
            assert found[inside].std() == pytest.approx(true.std(), rel=0.3)
