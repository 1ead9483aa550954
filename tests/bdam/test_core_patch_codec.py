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
    HEADER,
    MAX_GRADIENT,
    Patch,
    find_boundaries,
)
from farfield.addon.core.bdam.store.patch_decoding import CodedPatch, decode_patches
from farfield.addon.core.bdam.store.patch_encoding import encode_patches
from farfield.addon.core.bdam.store.rice_codes import RiceReader, to_signed
from farfield.addon.core.bdam.tree import Tree
from farfield.addon.core.errors import FileError

GRADIENT_STEP = 0.25
TREE = Tree(65, 65, 8)


def find_boundary(x, y, corners) -> np.ndarray:
    """The vertices on the edges of one triangle."""
    boundary, starts = find_boundaries(x, y, corners[None], np.array([len(x)]))
    assert starts.tolist() == [0, len(boundary)]
    return boundary.astype(np.int32)


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


def encode_patch(patch: Patch, corners, is_leaf: bool, gradient_step: float) -> bytes:
    """The block of one patch."""
    (block,) = encode_patches([patch], corners[None], is_leaf, gradient_step)
    return block


def decode(block: bytes, patch: Patch, corners, leaf=None) -> Patch:
    return decode_patches([CodedPatch(block, corners, len(patch.x), len(patch.triangles), leaf)], GRADIENT_STEP)[0]


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
    block = encode_patch(patch, corners, False, GRADIENT_STEP)
    assert HEADER.unpack_from(block) == (3, 10), "columns, and the first height"
    reader = RiceReader([block], HEADER.size)
    mesh = reader.read(np.array([[3, 3, 4, 3, 3]]))
    steps, sizes, offsets = mesh[:3]
    assert steps.tolist() == [0, 3, 3], "steps to columns, less one but for the first"
    assert sizes.tolist() == [0, 0, 1], "vertices of columns less one"
    assert offsets.tolist() == [0, 2, 0, 7], "y from the corner, or to the previous vertex less one"
    assert to_signed(mesh[3]).tolist() == [0, -1, 0], "l1 is 0 in the front 0, 0 in the front 0, 1, 0, and 2 in the front 0, 2, 1, 0"
    assert to_signed(mesh[4]).tolist() == [-2, -1, 0], "triangles of each fan, less two"
    differences, derivatives = reader.read(np.array([[3, 6]]))
    assert to_signed(differences).tolist() == [-3, -1, 12], "heights 7, 7, 20 from (10 + 10) / 2, (10 + 7) / 2, (7 + 10) / 2, rounded down"
    assert to_signed(derivatives).tolist() == [7, -2, 5, -6, -5, -10], "1, 0, 3 from -6, 2, -2 along x; 0, -2, 0 from 6, 3, 10 along y"
    assert block[reader.find_bytes()[0] :] == bytes([1, 0b010]), "triangles 0, 2, 1 of the sweep: the second one is a hole"


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
    block = encode_patch(patch, corners, True, GRADIENT_STEP)
    check_same(decode(block, patch, corners, grid), patch)
    assert encode_patch(patch, corners, True, GRADIENT_STEP) == block


@given(level=st.integers(0, 5), data=st.data(), count=st.integers(0, 300), seed=SEEDS, holes=HOLES)
def test_networks_come_back(level, data, count, seed, holes):
    patch, corners = create_network(level, data.draw(st.integers(0, (2 << level) - 1)), count, seed, holes)
    block = encode_patch(patch, corners, False, GRADIENT_STEP)
    decoded = decode(block, patch, corners)
    check_same(decoded, patch)
    points = np.stack([decoded.x, decoded.y], axis=1)
    first, second = (points[decoded.triangles[:, index]] - points[decoded.triangles[:, 0]] for index in (1, 2))
    assert (first[:, 0] * second[:, 1] > first[:, 1] * second[:, 0]).all(), "triangles are counterclockwise"
    assert encode_patch(decoded, corners, False, GRADIENT_STEP) == block


@given(seeds=st.lists(SEEDS, min_size=1, max_size=9))
def test_many_patches_at_once_are_those_alone(seeds):
    coded = []
    for seed in seeds:
        if seed % 3:
            level = seed % 6
            (patch, corners), leaf = create_network(level, seed % (2 << level), seed % 200, seed, 0.3 * (seed % 2)), None
        else:
            tree = TREE if seed % 2 else Tree(61, 59, 8)
            patch, corners, leaf = create_leaf(int(tree.existing_triangles(tree.leaf_level)[seed % 90]), seed, 0.3 * (seed % 2), tree)
        block = encode_patch(patch, corners, leaf is not None, GRADIENT_STEP)
        coded.append(CodedPatch(block, corners, len(patch.x), len(patch.triangles), leaf))
    for is_leaf in (False, True):
        alike = [patch for patch in coded if (patch.leaf is not None) == is_leaf]
        if alike:
            patches, corners = decode_patches(alike, GRADIENT_STEP), np.array([patch.corners for patch in alike])
            assert encode_patches(patches, corners, is_leaf, GRADIENT_STEP) == [patch.content for patch in alike]
    for patch, found in zip(coded, decode_patches(coded, GRADIENT_STEP), strict=True):
        (alone,) = decode_patches([patch], GRADIENT_STEP)
        for name in ("x", "y", "z", "boundary", "gradients", "triangles", "is_hole"):
            assert np.array_equal(getattr(found, name), getattr(alone, name)) and getattr(found, name).dtype == getattr(alone, name).dtype


def test_gradients_steeper_than_can_be_stored_become_the_steepest():
    patch, corners, grid = create_leaf(0, 1, 0.0)
    steep = replace(patch, gradients=np.where(patch.gradients < 0, -1e30, 1e30).astype(np.float32))
    decoded = decode(encode_patch(steep, corners, True, GRADIENT_STEP), patch, corners, grid)
    assert np.array_equal(decoded.gradients, np.sign(steep.gradients) * np.float32(MAX_GRADIENT * GRADIENT_STEP))


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
    """A leaf and a network with holes: their blocks, and functions that decode blocks as them."""
    leaf, leaf_corners, grid = create_leaf(3, 1, 0.3)
    network, corners = create_network(2, 5, 120, 1, 0.3)
    return [
        (encode_patch(leaf, leaf_corners, True, GRADIENT_STEP), partial(decode, patch=leaf, corners=leaf_corners, leaf=grid)),
        (encode_patch(network, corners, False, GRADIENT_STEP), partial(decode, patch=network, corners=corners)),
    ]


@settings(max_examples=600)
@given(data=st.data())
def test_damaged_blocks_give_a_patch_or_a_file_error(blocks, data):
    block, decode_block = data.draw(st.sampled_from(blocks))
    changed = bytearray(block)
    for _ in range(data.draw(st.integers(1, 4))):
        changed[data.draw(st.integers(0, len(changed) - 1))] ^= data.draw(st.integers(1, 255))
    decode_damaged(bytes(changed[: data.draw(st.integers(0, len(changed)) | st.just(len(changed)))]), decode_block)


@given(block=st.binary(max_size=200))
def test_any_other_bytes_give_a_patch_or_a_file_error(blocks, block):
    for _, decode_block in blocks:
        decode_damaged(block, decode_block)


def test_a_block_that_is_longer_than_its_patch_is_refused(blocks):
    for block, decode_block in blocks:
        with pytest.raises(FileError, match="longer than its patch"):
            decode_block(bytes(1 << 24))
        with pytest.raises(FileError, match="another length"):
            decode_block(block + b"\0")


def test_truncated_blocks_are_refused(blocks):
    for block, decode_block in blocks:
        for size in range(len(block)):
            with pytest.raises(FileError):
                decode_block(block[:size])
