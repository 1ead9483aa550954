"""Every cut of nested tiles is a quadtree whose neighbors differ by one level at most."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.bdam.textures.build import list_tiles
from farfield.addon.core.bdam.textures.grid import TextureGrid
from farfield.addon.core.bdam.textures.tile_index import TileIndex

LEVELS = 5


def full_index(generator=None) -> TileIndex:
    """All tiles of a quadtree; with a `generator` only some of them, always with their ancestors."""
    levels, tiles = [], []
    keep = np.ones((1, 1), bool)
    for level in range(LEVELS):
        if level:
            keep = keep.repeat(2, 0).repeat(2, 1)
            if generator is not None:
                keep &= generator.random(keep.shape) < 0.85
        j, i = np.nonzero(keep)
        tiles.append(np.column_stack([i, j]))
        levels.append(np.full(len(i), level))
    return TileIndex(np.concatenate(levels).astype(np.int32), np.concatenate(tiles).astype(np.int32), LEVELS)


def largest_step(index: TileIndex, cut: np.ndarray) -> int:
    """The largest difference of levels of two tiles of a cut that share an edge, measured on the squares of the finest level."""
    side = 1 << LEVELS - 1
    level_at = np.full((side, side), -1)
    for number in cut:
        size = side >> index.levels[number]
        i, j = index.tiles[number] * size
        assert (level_at[j : j + size, i : i + size] == -1).all(), "the tiles of a cut overlap"
        level_at[j : j + size, i : i + size] = index.levels[number]
    steps = [0]
    for first, second in ((level_at[1:], level_at[:-1]), (level_at[:, 1:], level_at[:, :-1])):
        both = (first >= 0) & (second >= 0)
        steps.append(np.abs(first - second)[both].max(initial=0))
    return max(steps)


def random_tree(seed: int):
    generator = np.random.default_rng(seed)
    index = full_index(generator if seed % 2 else None)
    own = generator.exponential(1.0, len(index)) * 2.0**-index.levels * (generator.random(len(index)) < 0.8)
    return generator, index, own.astype(np.float32)


@given(seed=st.integers(0, 2**32 - 1))
def test_neighbors_in_a_cut_differ_by_one_level_at_most(seed):
    generator, index, own = random_tree(seed)
    errors = index.nest(own)
    for threshold in (0.0, 0.01, 0.1, 0.5, *generator.exponential(0.3, 5)):
        is_refined = errors > threshold
        assert largest_step(index, index.select_cut(is_refined)) <= 1
        assert (is_refined[index.parents()] | ~is_refined | (index.levels == 0)).all(), "a refined tile has refined ancestors"


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_errors_never_shrink_towards_the_root_nor_grow_without_need(seed):
    _, index, own = random_tree(seed)
    errors = index.nest(own)
    assert (errors >= own).all() and np.array_equal(index.nest(errors), errors)
    for level in range(LEVELS - 1):
        numbers, relatives = index.numbers(level), index.relatives[level]
        below = np.where(relatives >= 0, errors[relatives], 0.0).max(axis=1)
        assert np.array_equal(errors[numbers], np.maximum(own[numbers], below))


def test_errors_spread_to_the_neighbors_of_a_lone_feature_and_no_farther():
    index = full_index()
    own = np.zeros(len(index), np.float32)
    own[index.find(4, np.array([[7, 7]]))] = 1.0
    errors = index.nest(own)
    assert {tuple(tile) for tile in index.tiles[index.numbers(3)][errors[index.numbers(3)] > 0]} == {(3, 3), (4, 3), (3, 4)}
    assert errors.max() == 1.0 and (errors[index.numbers(4)] > 0).sum() == 1


def test_tiles_are_found_by_level_and_position():
    index = full_index(np.random.default_rng(5))
    assert np.array_equal(index.find(index.levels, index.tiles), np.arange(len(index)))
    assert index.find(2, np.array([[-1, 0], [4, 0], [0, 1 << 25]])).tolist() == [-1, -1, -1]
    assert index.find(-1, np.array([[0, 0]])).tolist() == [-1]
    stored = {(int(level), int(i), int(j)) for level, (i, j) in zip(index.levels, index.tiles, strict=True)}
    everything = np.array([(i, j) for i in range(16) for j in range(16)])
    assert [(4, i, j) in stored for i, j in everything.tolist()] == (index.find(4, everything) >= 0).tolist()
    assert len(TileIndex(np.zeros(0, np.int32), np.zeros((0, 2), np.int32), 3).find(0, np.array([[0, 0]]))) == 1


@pytest.mark.parametrize("level", [0, 1, 3])
def test_the_curve_visits_every_square_of_tiles_at_once(level):
    ordered = list_tiles(TextureGrid(257, 257, 256, (30.0, 20.0), LEVELS), level)
    assert len(ordered) == 4**level
    assert ordered[:4].tolist() == [[0, 0], [1, 0], [0, 1], [1, 1]][: len(ordered)]
    assert all(len({tuple(tile) for tile in (group // 2).tolist()}) == 1 for group in ordered.reshape(-1, 4, 2)) if level else True
