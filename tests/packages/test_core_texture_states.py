"""States of textures with tiles of given sizes and errors: gaps between the best ones are filled, and there are not too many."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.packages.manifest import MAX_STATES, PackageTexture
from farfield.addon.core.packages.textures.best_state import measure_error, measure_size
from farfield.addon.core.packages.textures.coding import COMPLETE, VARIANTS, CodedTexture
from farfield.addon.core.packages.textures.texture_errors import SMALLER_SIZES
from farfield.addon.core.packages.textures.tile_states import choose_states
from farfield.addon.core.packages.tile_pyramid import TilePyramid


def make_coded(shapes, sizes, errors):
    """A coded texture whose tiles of a level have the same sizes (L, V) and errors (L, V), those of level 0 for a tile of level 0."""
    grid = shapes[0]
    texture = PackageTexture("base_color", grid[1] * 64, grid[0] * 64, 64, ())
    pyramid = TilePyramid(texture.width, texture.height, 64)
    assert pyramid.shapes[: len(shapes)] == tuple(shapes)
    levels = len(pyramid.shapes)
    all_sizes, all_errors = np.zeros((levels, len(VARIANTS)), int), np.full((levels, len(VARIANTS)), np.inf)
    all_sizes[: len(shapes)], all_errors[: len(shapes)] = sizes, errors
    return CodedTexture(
        texture,
        pyramid,
        np.ones(grid, bool),
        {},
        [np.broadcast_to(row[:, None, None], (len(row), *shape)) for row, shape in zip(all_sizes, pyramid.shapes, strict=True)],
        np.broadcast_to(all_errors[..., None, None] / (grid[0] * grid[1]), (*all_errors.shape, *grid)),
        np.zeros((SMALLER_SIZES, *all_errors.shape, *grid)),
    )


def test_gaps_between_best_states_are_filled():
    """The hull goes from 100 bytes of one tile to four tiles of 1000 bytes; other variants of the tile, or of the four, are between."""
    sizes, errors = np.zeros((2, len(VARIANTS)), int), np.full((2, len(VARIANTS)), np.inf)
    sizes[:, :4] = [[400, 0, 0, 1000], [100, 300, 1200, 1900]]
    errors[:, :4] = [[0.26, np.inf, np.inf, 0.01], [0.4, 0.37, 0.35, 0.36]]
    coded = make_coded([(2, 2), (1, 1)], sizes, errors)
    first, *between, last = choose_states([coded])
    assert [choice.level for choice in first] == [1] and {choice.variant for choice in last} == {COMPLETE}
    found = [(measure_size([coded], state), round(measure_error([coded], state), 6)) for state in between]
    assert found == [(300, 0.37), (1200, 0.35), (1600, 0.26)]


@settings(max_examples=8)
@given(st.integers(0, 10**6))
def test_states_are_few_and_each_has_a_smaller_error(seed):
    rng = np.random.default_rng(seed)
    shapes = [(4, 4), (2, 2), (1, 1)]
    sizes = np.cumsum(rng.lognormal(3.0, 3.0, (3, len(VARIANTS))), axis=1).astype(int) + 1
    errors = np.sort(rng.uniform(0.0, 1.0, (3, len(VARIANTS))), axis=1)[:, ::-1]
    coded = make_coded(shapes, sizes, errors)
    states = choose_states([coded])
    measured = [(measure_size([coded], state), measure_error([coded], state)) for state in states]
    assert len(states) <= MAX_STATES
    assert all(size < next_size for (size, _), (next_size, _) in pairwise(measured))
    assert all(error > next_error for (_, error), (_, next_error) in pairwise(measured[:-1]))  # the last one is complete in any case
