"""The contents of patches as bytes, alone: what was encoded comes back, and damaged bytes give FileError and never anything else."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from farfield.addon.core.bdam.store.leaf_grids import leaf_grid
from farfield.addon.core.bdam.store.patch_codec import (
    MAX_GRADIENT,
    Patch,
    StreamReader,
    decode_patch,
    encode_patch,
    find_boundary,
    write_signed,
    write_unsigned,
)
from farfield.addon.core.bdam.tree import Tree
from farfield.addon.core.errors import FileError

zstandard = pytest.importorskip("zstandard")
GRADIENT_STEP = 0.25
TREE = Tree(65, 65, 8)


def create_patch(x, y, triangles, corners, random, hole_fraction) -> Patch:
    """A patch of a mesh with random heights, gradients and holes."""
    boundary = find_boundary(x, y, corners)
    gradients = GRADIENT_STEP * random.integers(-300, 300, (len(boundary), 2))
    largest = random.choice([3, 500, 2**29])
    heights = random.integers(-largest, largest, len(x), endpoint=True)
    is_hole = random.random(len(triangles)) < hole_fraction
    return Patch(x, y, heights.astype(np.int32), boundary, gradients.astype(np.float32), triangles, is_hole)


def create_leaf(level_index: int, seed: int, hole_fraction: float, tree=TREE):
    """A leaf, its corners and its samples."""
    corners = tree.corners_of(tree.leaf_level, level_index)
    grid = leaf_grid(tree, corners)
    return create_patch(grid.x, grid.y, grid.triangles, corners, np.random.default_rng(seed), hole_fraction), corners, grid


def create_network(level: int, index: int, count: int, seed: int, hole_fraction: float):
    """A Delaunay network of random samples in a triangle of the bintree, and its corners."""
    random, corners = np.random.default_rng(seed), TREE.corners_of(level, index)
    weights = random.dirichlet((1.0, 1.0, 1.0), count)
    low, high = corners.min(axis=0), corners.max(axis=0)
    points = np.unique(np.concatenate([corners, np.clip(np.rint(weights @ corners).astype(np.int64), low, high)]), axis=0)
    triangles = Delaunay(points).simplices.astype(np.int32)
    first, second = (points[triangles[:, index]] - points[triangles[:, 0]] for index in (1, 2))
    areas = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    triangles = np.where((areas < 0)[:, None], triangles[:, ::-1], triangles)[areas != 0]
    x, y = points.T.astype(np.int32)
    return create_patch(x, y, triangles, corners, random, hole_fraction), corners


def decode(block: bytes, patch: Patch, corners, leaf=None) -> Patch:
    return decode_patch(block, corners, len(patch.x), len(patch.triangles), leaf, GRADIENT_STEP)


def contents(patch: Patch) -> list[tuple]:
    """The triangles of a patch in an order of their own: vertices from the smallest on, and whether they are holes."""
    turned = [np.roll(triangle, -int(triangle.argmin())).tolist() for triangle in patch.triangles]
    return sorted((*triangle, bool(is_hole)) for triangle, is_hole in zip(turned, patch.is_hole, strict=True))


def check_same(patch: Patch, expected: Patch) -> None:
    for name in ("x", "y", "z", "boundary"):
        assert getattr(patch, name).dtype == np.int32 and np.array_equal(getattr(patch, name), getattr(expected, name)), name
    assert patch.gradients.dtype == np.float32 and np.array_equal(patch.gradients, expected.gradients)
    assert contents(patch) == contents(expected)


def test_a_known_patch_has_the_documented_streams():
    corners = np.array([[8, 8], [0, 0], [8, 0]])
    points, triangles = np.array([(0, 0), (4, 2), (8, 0), (8, 8)]), np.array([[0, 2, 1], [1, 2, 3], [0, 1, 3]])
    boundary = find_boundary(*points.T, corners)
    assert boundary.tolist() == [0, 2, 3]
    heights, gradients = np.array([10, 7, 7, 20]), GRADIENT_STEP * np.array([[1, 0], [0, -2], [3, 0]])
    patch = Patch(*points.T.astype(np.int32), heights, boundary, gradients, triangles, np.array([False, True, False]))
    block = zstandard.ZstdDecompressor().decompress(encode_patch(patch, np.zeros(2, np.int64), False, GRADIENT_STEP))
    reader = StreamReader(block)
    assert reader.read_unsigned(4).tolist() == [0, 4, 4, 0], "steps along x"
    assert reader.read_unsigned(4).tolist() == [0, 2, 0, 7], "y from the corner, or to the previous vertex less one"
    assert reader.read_unsigned(4).tolist() == [0, 0, 1, 2], "triangles of each fan"
    assert reader.read_unsigned(2).tolist() == [2, 1], "v - l1: 2 - 0 and 3 - 2"
    assert reader.read_signed(3).tolist() == [1, -1, -1], "from the lower neighbor to the upper one"
    assert reader.read_signed(4).tolist() == [10, -3, 0, 13], "heights"
    assert reader.read_signed(6).tolist() == [1, 0, 3, 0, -2, 0], "derivatives along x, then along y"
    assert reader.read_bytes(2).tolist() == [1, 0b010], "triangles 0, 2, 1 of the sweep: the second one is a hole"
    with pytest.raises(FileError):
        reader.read_bytes(1)


@pytest.mark.parametrize(("level", "index"), [(0, 0), (0, 1), (1, 2), (3, 5), (4, 9)])
def test_the_boundary_is_that_of_the_triangle(level, index):
    corners = TREE.corners_of(level, index)
    y, x = (axis.ravel() for axis in np.mgrid[0:65, 0:65])
    sides = np.roll(corners, -1, axis=0) - corners
    edges = [side[0] * (y - start[1]) - side[1] * (x - start[0]) for side, start in zip(sides, corners, strict=True)]
    is_inside = np.min(edges, axis=0) >= 0
    found = find_boundary(x[is_inside], y[is_inside], corners)
    assert np.array_equal(found, np.flatnonzero(np.min(edges, axis=0)[is_inside] == 0))


SEEDS, HOLES = st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.3, 1.0])


@given(index=st.integers(0, (2 << TREE.leaf_level) - 1), seed=SEEDS, holes=HOLES)
def test_leaves_come_back(index, seed, holes):
    patch, corners, grid = create_leaf(index, seed, holes)
    block = encode_patch(patch, corners.min(axis=0), True, GRADIENT_STEP)
    check_same(decode(block, patch, corners, grid), patch)
    assert encode_patch(patch, corners.min(axis=0), True, GRADIENT_STEP) == block


@given(level=st.integers(0, 5), data=st.data(), count=st.integers(0, 300), seed=SEEDS, holes=HOLES)
def test_networks_come_back(level, data, count, seed, holes):
    patch, corners = create_network(level, data.draw(st.integers(0, (2 << level) - 1)), count, seed, holes)
    block = encode_patch(patch, corners.min(axis=0), False, GRADIENT_STEP)
    decoded = decode(block, patch, corners)
    check_same(decoded, patch)
    points = np.stack([decoded.x, decoded.y], axis=1)
    first, second = (points[decoded.triangles[:, index]] - points[decoded.triangles[:, 0]] for index in (1, 2))
    assert (first[:, 0] * second[:, 1] > first[:, 1] * second[:, 0]).all(), "triangles are counterclockwise"
    assert encode_patch(decoded, corners.min(axis=0), False, GRADIENT_STEP) == block


def test_gradients_steeper_than_can_be_stored_become_the_steepest():
    patch, corners, grid = create_leaf(0, 1, 0.0)
    steep = replace(patch, gradients=np.where(patch.gradients < 0, -1e30, 1e30).astype(np.float32))
    decoded = decode(encode_patch(steep, corners.min(axis=0), True, GRADIENT_STEP), patch, corners, grid)
    assert np.array_equal(decoded.gradients, np.sign(steep.gradients) * np.float32(MAX_GRADIENT * GRADIENT_STEP))


@given(values=st.lists(st.integers(0, 2**32 - 1) | st.integers(0, 300), max_size=40))
def test_unsigned_streams_come_back(values):
    block = write_unsigned(np.array(values, np.int64))
    assert StreamReader(block).read_unsigned(len(values)).tolist() == values
    assert len(block) == 1 + len(values) * next(width for width in (0, 1, 2, 4) if max(values, default=0) < 256**width)


@given(values=st.lists(st.integers(-(2**31), 2**31 - 1) | st.integers(-100, 100), max_size=40))
def test_signed_streams_come_back(values):
    assert StreamReader(write_signed(np.array(values, np.int64))).read_signed(len(values)).tolist() == values


def test_small_values_take_one_byte_and_zeros_none():
    assert write_signed(np.array([-128, 127])) == bytes([1, 255, 254])
    assert write_unsigned(np.zeros(1000, np.int64)) == bytes(1)


def decode_damaged(block: bytes, decode_block) -> None:
    """Decode a damaged block: it gives a patch that could be one, or FileError."""
    try:
        patch = decode_block(block)
    except FileError:
        return
    assert not len(patch.triangles) or 0 <= patch.triangles.min() <= patch.triangles.max() < len(patch.x)
    assert len(patch.x) == len(patch.y) == len(patch.z) and len(patch.gradients) == len(patch.boundary)
    assert len(patch.is_hole) == len(patch.triangles) and np.isfinite(patch.gradients).all()
    for axis in (patch.x, patch.y):
        assert not len(axis) or 0 <= axis.min() <= axis.max() <= TREE.side


@pytest.fixture(scope="module")
def blocks():
    """A leaf and a network with holes: their streams, and functions that decode blocks as them."""
    leaf, leaf_corners, grid = create_leaf(3, 1, 0.3)
    network, corners = create_network(2, 5, 120, 1, 0.3)
    decompress = zstandard.ZstdDecompressor().decompress
    return [
        (
            decompress(encode_patch(leaf, leaf_corners.min(axis=0), True, GRADIENT_STEP)),
            partial(decode, patch=leaf, corners=leaf_corners, leaf=grid),
        ),
        (decompress(encode_patch(network, corners.min(axis=0), False, GRADIENT_STEP)), partial(decode, patch=network, corners=corners)),
    ]


@settings(max_examples=400)
@given(data=st.data())
def test_damaged_streams_give_a_patch_or_a_file_error(blocks, data):
    streams, decode_block = data.draw(st.sampled_from(blocks))
    changed = bytearray(streams)
    for _ in range(data.draw(st.integers(0, 4))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    changed = changed[: data.draw(st.integers(0, len(changed)) | st.just(len(changed)))]
    decode_damaged(zstandard.ZstdCompressor().compress(bytes(changed)), decode_block)


@settings(max_examples=300)
@given(data=st.data())
def test_damaged_blocks_give_a_patch_or_a_file_error(blocks, data):
    streams, decode_block = data.draw(st.sampled_from(blocks))
    changed = bytearray(zstandard.ZstdCompressor().compress(streams))
    for _ in range(data.draw(st.integers(1, 4))):
        changed[data.draw(st.integers(0, len(changed) - 1))] ^= data.draw(st.integers(1, 255))
    decode_damaged(bytes(changed[: data.draw(st.integers(0, len(changed)) | st.just(len(changed)))]), decode_block)


@given(block=st.binary(max_size=200))
def test_any_other_bytes_give_a_patch_or_a_file_error(blocks, block):
    for _, decode_block in blocks:
        decode_damaged(block, decode_block)
        decode_damaged(zstandard.ZstdCompressor().compress(block), decode_block)


def test_a_block_that_claims_to_be_huge_is_refused_before_memory_is_taken(blocks):
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 24))
    for _, decode_block in blocks:
        with pytest.raises(FileError, match="longer than its patch"):
            decode_block(bomb)
        with pytest.raises(FileError):  # without a size in the header
            decode_block(zstandard.ZstdCompressor(write_content_size=False).compress(bytes(1 << 24)))


def test_truncated_streams_are_refused(blocks):
    for streams, decode_block in blocks:
        for size in range(len(streams)):
            with pytest.raises(FileError):
                decode_block(zstandard.ZstdCompressor().compress(streams[:size]))
